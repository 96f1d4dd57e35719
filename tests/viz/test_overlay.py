"""The picture of a verdict: each colour stands where it should, and only there."""

import numpy as np
import pytest

from stillroom.data.semantics import Box, Semantics
from stillroom.viz.marks import MOVING, STATIC, TINT
from stillroom.viz.recorder import draw_verdict

GRAY = np.full((120, 160, 3), 128, dtype=np.uint8)
NO_POINTS = (np.zeros((0, 2), np.float32), np.zeros(0, bool), np.zeros(0, bool))
STILL = np.zeros((120, 160), bool)
NOTHING = Semantics(120, 160)


def close_to(picture: np.ndarray, color: tuple[int, int, int]) -> np.ndarray:
    return np.abs(picture.astype(int) - color).max(axis=2) < 30


@pytest.mark.parametrize("scale", [1.0, 1.5, 2.0])
def test_each_keypoint_is_drawn_where_it_lies_in_the_colour_of_its_verdict(scale: float) -> None:
    points = np.array([[30.25, 20.5], [100, 40], [60, 80], [120, 70]], np.float32)
    is_static, is_matched = np.array([True, True, False, False]), np.array([True, False, False, True])
    picture = draw_verdict(GRAY, points, is_static, is_matched, NOTHING, STILL, scale)
    assert picture.shape == (120 * scale, 160 * scale, 3)
    assert picture.dtype == np.uint8
    above = picture[: round(100 * scale)]  # the legend lies below
    for color, expected in ((STATIC, points[:2]), (MOVING, points[2:])):
        rows, columns = np.nonzero(close_to(above, color))
        found = np.stack((columns, rows), axis=1)
        distance = np.linalg.norm(found[:, None] - ((expected + 0.5) * scale - 0.5)[None], axis=2)
        assert distance.min(axis=1).max() < 3 * scale  # nothing of this colour elsewhere
        assert distance.min(axis=0).max() < 3 * scale  # and something at each point
    filled = close_to(picture, STATIC)[round(20.5 * scale), round(30.25 * scale)]
    hollow = close_to(picture, STATIC)[round(40 * scale), round(100 * scale)]
    assert filled
    assert not hollow or scale == 1.0


def test_what_moves_is_tinted_and_the_rest_is_left_as_it_was() -> None:
    moving = STILL.copy()
    moving[20:60, 30:90] = True
    picture = draw_verdict(GRAY, *NO_POINTS, NOTHING, moving, 2.0)
    np.testing.assert_allclose(picture[80, 120], 128 * (1 - TINT) + TINT * np.array(MOVING), atol=1)
    np.testing.assert_array_equal(picture[10, 10], [128, 128, 128])


def test_boxes_are_edged_and_labelled_even_at_the_border() -> None:
    box = Box(40, 30, 80, 90, "person", 0.93)
    picture = draw_verdict(GRAY, *NO_POINTS, Semantics(120, 160, (box,)), STILL, 2.0)
    white = close_to(picture, (255, 255, 255))
    assert white[120, 78:84].any()
    assert white[120, 158:164].any()
    assert not white[100:140, 90:150].any()
    assert white[45:60, 82:110].mean() > 0.3  # the label's ground
    outside = Box(-20, -5, 300, 119.5, "person", 1.0, carried=3)
    assert draw_verdict(GRAY, *NO_POINTS, Semantics(120, 160, (outside,)), STILL, 2.0).shape == (240, 320, 3)


def test_the_image_itself_is_not_touched() -> None:
    image = GRAY.copy()
    moving = ~STILL
    draw_verdict(image, np.array([[5, 5]], np.float32), np.array([True]), np.array([True]), NOTHING, moving, 1.0)
    np.testing.assert_array_equal(image, GRAY)


def test_a_point_outside_the_image_is_no_error() -> None:
    points = np.array([[-50, 400], [159.9, 119.9]], np.float32)
    draw_verdict(GRAY, points, np.array([True, False]), np.array([True, True]), NOTHING, STILL)
