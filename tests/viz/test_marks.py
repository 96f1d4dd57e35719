"""Tints and outlines lie where their mask does, however small it is and wherever it lies."""

import cv2
import numpy as np
import pytest

from stillroom.viz.marks import draw_outline, mix, tint

RED = (255, 0, 0)


def whole_outline(picture: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """The same edge without looking at a part only."""
    size = picture.shape[1::-1]
    soft = cv2.GaussianBlur(cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_LINEAR), (0, 0), 1.5)
    outlines, _ = cv2.findContours((soft > 0.5).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return cv2.drawContours(picture.copy(), outlines, -1, RED, 1, cv2.LINE_AA)


@pytest.mark.parametrize("scale", [1, 2, 3])
@pytest.mark.parametrize("place", [(0, 0, 12, 9), (30, 20, 41, 50), (60, 40, 80, 60), (0, 0, 80, 60), (7, 30, 8, 60)])
def test_an_edge_is_the_same_as_if_the_whole_picture_had_been_looked_at(scale: int, place: tuple[int, ...]) -> None:
    x0, y0, x1, y1 = place
    mask = np.zeros((60, 80), bool)
    mask[y0:y1, x0:x1] = True
    mask[y0 + (y1 - y0) // 2 :, x0 : x0 + (x1 - x0) // 3] = False
    picture = np.full((60 * scale, 80 * scale, 3), 90, np.uint8)
    expected = whole_outline(picture, mask)
    draw_outline(picture, mask, RED)
    np.testing.assert_array_equal(picture, expected)


def test_an_empty_mask_has_no_edge_and_no_tint() -> None:
    picture = np.full((60, 80, 3), 90, np.uint8)
    draw_outline(picture, np.zeros((60, 80), bool), RED)
    tint(picture, np.zeros((60, 80), bool), RED)
    assert np.all(picture == 90)


def test_colours_are_mixed_by_their_shares() -> None:
    picture = np.full((120, 160, 3), 100, np.uint8)
    colors = np.zeros((60, 80, 4), np.float32)
    colors[:, :40] = [0.5 * 200, 0.0, 0.5 * 40, 0.5]
    colors[:, 40:] = [0.0, 0.25 * 200, 0.0, 0.25]
    mix(picture, colors)
    np.testing.assert_array_equal(picture[60, 20], [150, 50, 70])
    np.testing.assert_array_equal(picture[60, 140], [75, 125, 75])
