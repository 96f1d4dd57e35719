"""Growing a mask, against every pixel's distance to it."""

import numpy as np
import pytest

from stillroom.geometry.pixels import Shape, element, grown

MASK = np.zeros((40, 50), dtype=np.bool_)
MASK[10:13, 20] = MASK[30, 48] = True


def distances_px() -> np.ndarray:
    """Offsets (H, W, M, 2) of all pixels from those of the mask."""
    at = np.stack(np.indices(MASK.shape), axis=-1)
    return np.abs(at[:, :, None] - np.argwhere(MASK))


def test_a_square_reaches_as_far_along_the_diagonal() -> None:
    np.testing.assert_array_equal(grown(MASK, 4, Shape.SQUARE), (distances_px().max(axis=-1) <= 4).any(axis=-1))


def test_an_ellipse_is_round_to_half_a_pixel() -> None:
    found, distance_px = grown(MASK, 6, Shape.ELLIPSE), np.hypot(*np.moveaxis(distances_px(), -1, 0)).min(axis=-1)
    assert found[distance_px <= 5.5].all()
    assert not found[distance_px > 6.5].any()


@pytest.mark.parametrize("shape", Shape)
def test_nothing_grows_where_nothing_is_to_and_what_is_given_stays_as_it_is(shape: Shape) -> None:
    before, nothing = MASK.copy(), np.zeros_like(MASK)
    assert grown(MASK, 0, shape) is MASK
    assert grown(nothing, 3, shape) is nothing
    grown(MASK, 3, shape)
    np.testing.assert_array_equal(MASK, before)
    assert grown(MASK[:, ::2], 2, shape).sum() > MASK[:, ::2].sum()


def test_an_element_is_made_once_and_cannot_be_spoilt() -> None:
    assert element(3, Shape.SQUARE) is element(3, Shape.SQUARE)
    with pytest.raises(ValueError, match="read-only"):
        element(3, Shape.SQUARE)[0, 0] = 0
