"""Points followed from one image to another."""

import cv2
import numpy as np

from stillroom.features.optical_flow import OpticalFlow

RNG = np.random.default_rng(4)
FIRST = cv2.GaussianBlur(RNG.integers(0, 256, (120, 160), dtype=np.uint8), (0, 0), 2.0)
POINTS_PX = np.stack(np.meshgrid([40, 70, 100], [40, 60, 80]), axis=-1).reshape(-1, 2).astype(np.float32)
FLOW = OpticalFlow(window_px=15, levels=2)


def shifted(by_px: tuple[float, float]) -> np.ndarray:
    return cv2.warpAffine(FIRST, np.float64([[1, 0, by_px[0]], [0, 1, by_px[1]]]), (160, 120))


def test_points_are_found_where_the_image_went() -> None:
    second_px, is_found = FLOW.follow(FIRST, shifted((3.0, -2.0)), POINTS_PX)
    assert is_found.all()
    np.testing.assert_allclose(second_px, POINTS_PX + np.float32([3.0, -2.0]), atol=0.1)


def test_a_guess_leads_farther_than_the_pyramid_reaches_and_is_not_written_to() -> None:
    second, moved_px = shifted((34.0, 21.0)), POINTS_PX + np.float32([34.0, 21.0])
    guess_px = moved_px + np.float32(1.5)
    given = guess_px.copy()
    led, _ = FLOW.follow(FIRST, second, POINTS_PX, guess_px)
    np.testing.assert_allclose(led, moved_px, atol=0.1)
    np.testing.assert_array_equal(guess_px, given)
    alone, _ = FLOW.follow(FIRST, second, POINTS_PX)
    assert (np.linalg.norm(alone - moved_px, axis=1) > 3.0).any()


def test_no_points_are_fine() -> None:
    second_px, is_found = FLOW.follow(FIRST, FIRST, np.zeros((0, 2), np.float32))
    assert second_px.shape == (0, 2)
    assert len(is_found) == 0
