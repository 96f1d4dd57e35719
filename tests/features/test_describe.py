"""Orientation and descriptor kernels against the same written plainly, and orientation against OpenCV."""

import cv2
import numpy as np
import pytest

from stillroom.features.orb import BORDER_PX
from stillroom.features.patches import (
    N_TURNS,
    PATCH_RADIUS_PX,
    ROW,
    TURNED_REACH_PX,
    blur,
    describe,
    orientations,
    patch_half_widths,
    turned_places,
)

RNG = np.random.default_rng(5)
IMAGE = cv2.GaussianBlur(RNG.integers(0, 256, (121, 160), dtype=np.uint8), (0, 0), 1.5)
PX = np.stack((RNG.integers(BORDER_PX, 160 - BORDER_PX, 80), RNG.integers(BORDER_PX, 121 - BORDER_PX, 80)), axis=1)
PX[:4] = [[19, 19], [140, 19], [19, 101], [140, 101]]  # as near to the edges as a corner may be
PATTERN = RNG.integers(-13, 14, (256, 4)).astype(np.int32)


def disc_by_numpy() -> np.ndarray:
    """Which places (31, 31) belong to the disc."""
    widths, rows = patch_half_widths(), np.abs(np.arange(-PATCH_RADIUS_PX, PATCH_RADIUS_PX + 1))
    return rows[None, :] <= widths[rows][:, None]


def angles_by_numpy(image: np.ndarray, px: np.ndarray) -> np.ndarray:
    dy, dx = np.mgrid[-PATCH_RADIUS_PX : PATCH_RADIUS_PX + 1, -PATCH_RADIUS_PX : PATCH_RADIUS_PX + 1]
    angles = []
    for x, y in px:
        patch = image[y - PATCH_RADIUS_PX : y + PATCH_RADIUS_PX + 1, x - PATCH_RADIUS_PX : x + PATCH_RADIUS_PX + 1]
        weight = patch.astype(np.int64) * disc_by_numpy()
        angles.append(np.arctan2((dy * weight).sum(), (dx * weight).sum()))
    return np.array(angles)


def own_angles(image: np.ndarray, px: np.ndarray) -> np.ndarray:
    angle_rad = np.zeros(len(px), np.float32)
    orientations(image, px.astype(np.float32), angle_rad)
    return angle_rad


@pytest.mark.parametrize("darkest", [0, 255, 128])
def test_an_orientation_is_exact_where_the_image_is_brightest(darkest: int) -> None:
    # One half of the disc black and the other white, both ways and askew: the largest sums that there can be.
    y, x = np.mgrid[:60, :70]
    middle = np.array([[35, 30]])
    for cut in (x - 35, y - 30, x - y - 5, x + y - 65):
        for image in (cut > 0, cut < 0):
            image = np.where(image, 255, darkest).astype(np.uint8)
            np.testing.assert_array_equal(own_angles(image, middle), angles_by_numpy(image, middle).astype(np.float32))


@pytest.mark.parametrize("size", [(121, 160), (39, 39), (50, 79), (5, 5)])
def test_the_blur_is_opencvs_box_twice(size: tuple[int, int]) -> None:
    for image in (RNG.integers(0, 256, size, dtype=np.uint8), np.full(size, 255, np.uint8)):
        once, twice = np.empty_like(image), np.empty_like(image)
        blur(image, once, twice)
        np.testing.assert_array_equal(once, cv2.blur(image, (5, 5)))
        np.testing.assert_array_equal(twice, cv2.blur(cv2.blur(image, (5, 5)), (5, 5)))


def test_every_sum_of_a_box_is_divided_as_opencv_does() -> None:
    # Tiles of all sums from 0 to 25 · 255, as many pixels white as the sum has room for.
    sums = np.minimum(np.arange(64 * 100), 25 * 255)
    pixels = np.clip(sums[:, None] - 255 * np.arange(25), 0, 255).astype(np.uint8)
    image = pixels.reshape(64, 100, 5, 5).swapaxes(1, 2).reshape(320, 500)
    once, twice = np.empty_like(image), np.empty_like(image)
    blur(image, once, twice)
    np.testing.assert_array_equal(once[2::5, 2::5].ravel(), np.rint(sums / 25))
    np.testing.assert_array_equal(once, cv2.blur(image, (5, 5)))


def test_the_disc_is_round_and_the_same_when_turned_by_a_quarter() -> None:
    disc = disc_by_numpy()
    np.testing.assert_array_equal(disc, disc.T)
    area = np.pi * (PATCH_RADIUS_PX + 0.5) ** 2
    assert abs(disc.sum() - area) < 0.05 * area


def test_orientation_is_the_direction_of_the_centroid() -> None:
    np.testing.assert_allclose(own_angles(IMAGE, PX), angles_by_numpy(IMAGE, PX), atol=1e-6)


def test_orientation_is_opencvs() -> None:
    image = cv2.GaussianBlur(np.random.default_rng(1).integers(0, 256, (480, 640), dtype=np.uint8), (0, 0), 1.2)
    keypoints = cv2.ORB.create(500, nlevels=1).detect(image)
    px = np.asarray(cv2.KeyPoint.convert(keypoints)).astype(int)
    theirs_rad = np.deg2rad([keypoint.angle for keypoint in keypoints])
    assert len(px) > 300
    difference = np.angle(np.exp(1j * (own_angles(image, px) - theirs_rad)))
    assert np.abs(difference).max() < np.deg2rad(0.05)  # OpenCV's arctangent is an approximation


def test_orientation_turns_with_the_image() -> None:
    middle = np.array([[60, 60]])
    square = np.ascontiguousarray(IMAGE[:, :121])
    upright, turned = own_angles(square, middle)[0], own_angles(np.ascontiguousarray(np.rot90(square, -1)), middle)[0]
    # np.rot90(…, -1) turns clockwise as seen, which is +90° where y points down.
    assert np.angle(np.exp(1j * (turned - upright))) == pytest.approx(np.pi / 2, abs=1e-5)


def test_descriptor_bits_are_the_comparisons_in_order() -> None:
    steps = RNG.integers(0, N_TURNS, len(PX))
    angle_rad = (2 * np.pi * steps / N_TURNS).astype(np.float32)
    found = np.zeros((len(PX), 32), np.uint8)
    describe(IMAGE, PX.astype(np.float32), angle_rad, turned_places(PATTERN), found)
    for i, (x, y) in enumerate(PX):
        c, s = np.cos(2 * np.pi * steps[i] / N_TURNS), np.sin(2 * np.pi * steps[i] / N_TURNS)
        for k, (x0, y0, x1, y1) in enumerate(PATTERN.astype(float)):
            first = IMAGE[y + round(x0 * s + y0 * c), x + round(x0 * c - y0 * s)]
            second = IMAGE[y + round(x1 * s + y1 * c), x + round(x1 * c - y1 * s)]
            assert (found[i, k // 8] >> (k % 8)) & 1 == (first < second)


@pytest.mark.parametrize("turn_rad", [-np.pi, -3.0, -0.01, 0.0, 0.01, 1.0, np.pi, 6.2])
def test_the_nearest_turn_of_the_table_is_used(turn_rad: float) -> None:
    # The first place is the keypoint itself, the second tells the turn by where it is: sixteen in a row.
    places = np.full((N_TURNS, 512), ROW * TURNED_REACH_PX + TURNED_REACH_PX, dtype=np.uint16)
    turns = np.arange(N_TURNS)
    places[:, 1::2] = (ROW * (turns // 16) + turns % 16)[:, None]
    nearest = round(turn_rad / (2 * np.pi) * N_TURNS) % N_TURNS
    for bright, expected in ((nearest, 255), ((nearest + 1) % N_TURNS, 0)):
        image = np.zeros((60, 70), np.uint8)
        image[5 + bright // 16, 9 + bright % 16] = 1
        found = np.full((1, 32), 77, np.uint8)
        px = np.array([[9 + TURNED_REACH_PX, 5 + TURNED_REACH_PX]], np.float32)
        describe(image, px, np.array([turn_rad], np.float32), places, found)
        assert np.all(found == expected)


def test_the_turned_pattern_stays_within_the_border() -> None:
    places = turned_places(np.array([[13, 13, -13, 13]] * 256, dtype=np.int32)).astype(int)
    assert places.min() >= 0
    for along in (places // ROW, places % ROW):
        assert along.min() == 0
        assert along.max() == 2 * TURNED_REACH_PX
    assert TURNED_REACH_PX < BORDER_PX
