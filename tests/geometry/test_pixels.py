"""The size of pixels, values of images at points, and dilation of masks."""

import cv2
import numpy as np
import pytest

from stillroom.geometry.pixels import WIDE_PX, Shape, element, grown, in_pixels, pixel_scale, values_at

IMAGE = np.arange(12, dtype=np.int16).reshape(3, 4)


def test_a_point_has_the_value_of_the_pixel_whose_centre_is_nearest_column_first() -> None:
    px = np.array([[0.0, 0.0], [2.4, 0.6], [2.6, 1.4], [3.0, 2.0]], dtype=np.float32)
    found = values_at(IMAGE, px)
    assert found.tolist() == [0, 6, 7, 11]
    assert found.dtype == np.int16


def test_between_two_pixels_it_is_the_even_one() -> None:
    assert values_at(IMAGE, np.array([[0.5, 0.5], [1.5, 1.5]])).tolist() == [0, 10]


def test_outside_it_is_the_nearest_of_the_edge() -> None:
    px = np.array([[-3.0, -0.6], [9.0, -2.0], [-1.0, 7.0], [4.2, 2.6]])
    assert values_at(IMAGE, px).tolist() == [0, 3, 8, 11]
    assert len(values_at(IMAGE, np.zeros((0, 2)))) == 0


@pytest.mark.parametrize("shape", [(37, 53), (64, 64), (5, 80)])
@pytest.mark.parametrize("reach_px", [1, WIDE_PX - 1, WIDE_PX, 15, 40])
@pytest.mark.parametrize("kind", list(Shape))
def test_masks_grow_as_opencv_dilates_them(shape: tuple[int, int], reach_px: int, kind: Shape) -> None:
    rng = np.random.default_rng(reach_px)
    mask = cv2.GaussianBlur(rng.random(shape), (0, 0), 3.0) > 0.55
    mask[0, 0] = mask[-1, -1] = True
    dilated = cv2.dilate(mask.astype(np.uint8), element(reach_px, kind))
    np.testing.assert_array_equal(grown(mask, reach_px, kind), dilated > 0)


@pytest.mark.parametrize(
    ("size", "expected"),
    [
        ((640, 480), 1.0),
        ((480, 640), 1.0),
        ((640, 360), 1.0),
        ((1920, 1440), 3.0),
        ((960, 1280), 2.0),
        ((160, 120), 0.25),
    ],
)
def test_pixels_are_counted_along_the_longer_side(size: tuple[int, int], expected: float) -> None:
    assert pixel_scale(*size) == expected


def test_whole_lengths_stay_whole_and_do_not_vanish() -> None:
    assert [in_pixels(length, 1.0) for length in range(100)] == list(range(100))
    assert [in_pixels(5, scale) for scale in (3.0, 0.6625, 0.25, 0.01)] == [15, 3, 1, 1]
    assert in_pixels(0, 3.0) == 0
