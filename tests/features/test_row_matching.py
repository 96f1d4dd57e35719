"""The search along rows of a rectified pair, and its refinement by patches, against plain searches and known shifts."""

import cv2
import numpy as np
import pytest

from stillroom.features.row_matching import RowKeypoints, agreeing, refine, search_rows, slide
from stillroom.geometry.hamming import words

HEIGHT, WIDTH = 120, 200
FACTORS = 1.2 ** np.arange(8)


def textured(seed: int, height: int = HEIGHT, width: int = WIDTH) -> np.ndarray:
    noise = np.random.default_rng(seed).integers(0, 256, (height, width), dtype=np.uint8)
    return cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 2.0), None, 0, 255, cv2.NORM_MINMAX)


def shifted(image: np.ndarray, disparity_px: np.ndarray | float) -> np.ndarray:
    """The right image of a left one: what is at x in the left is at x − disparity."""
    x, y = np.meshgrid(np.arange(image.shape[1]), np.arange(image.shape[0]))
    from_x = (x + disparity_px).astype(np.float32)
    return cv2.remap(image, from_x, y.astype(np.float32), cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)


def keypoints(seed: int, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    px = rng.uniform([0, -0.4], [WIDTH - 1, HEIGHT - 0.6], (n, 2)).astype(np.float32)
    return px, rng.integers(0, 8, n).astype(np.int32), rng.integers(0, 256, (n, 32), dtype=np.uint8)


def searched_plainly(left: tuple, right: tuple, max_disparity_px: float, max_bits: int) -> np.ndarray:
    """All pairs; the description of ORB-SLAM2's rows, written down."""
    (px, octave, descriptors), (right_px, right_octave, right_descriptors) = left, right
    found = np.full(len(px), -1)
    for i in range(len(px)):
        best = max_bits
        for j in range(len(right_px)):
            band = 2.0 * FACTORS[right_octave[j]]
            row = np.floor(px[i, 1])
            if not np.floor(right_px[j, 1] - band) <= max(row, 0) <= np.ceil(right_px[j, 1] + band):
                continue
            if abs(int(octave[i]) - int(right_octave[j])) > 1 or not (
                px[i, 0] - max_disparity_px <= right_px[j, 0] <= px[i, 0]
            ):
                continue
            bits = int(np.unpackbits(descriptors[i] ^ right_descriptors[j]).sum())
            if bits < best:
                best, found[i] = bits, j
    return found


@pytest.mark.parametrize(("max_disparity_px", "max_bits"), [(200.0, 257), (30.0, 257), (200.0, 120), (200.0, 75)])
def test_the_search_along_rows_is_the_plain_one(max_disparity_px: float, max_bits: int) -> None:
    right = keypoints(1, 400)
    px, octave, descriptors = keypoints(2, 300)
    # Half of them are like one on the right, with some bits turned over: those are found at the tighter limits.
    like = np.random.default_rng(3).integers(0, 400, 150)
    px[:150] = right[0][like] + np.array([12.0, 0.7], np.float32)
    px[:150, 0] = np.minimum(px[:150, 0], WIDTH - 1)
    octave[:150] = right[1][like]
    bits = np.unpackbits(right[2][like], axis=1) ^ (np.random.default_rng(4).random((150, 256)) < 0.2)
    descriptors[:150] = np.packbits(bits, axis=1)
    left = px, octave, descriptors
    expected = searched_plainly(left, right, max_disparity_px, max_bits)
    assert (expected >= 0).sum() > 80
    found = search_rows(
        RowKeypoints(px, octave, words(descriptors)),
        RowKeypoints(right[0], right[1], words(right[2])),
        FACTORS, HEIGHT, max_disparity_px, max_bits,
    )  # fmt: skip
    np.testing.assert_array_equal(found, expected)


def test_no_keypoints_match_nothing() -> None:
    none = RowKeypoints(np.zeros((0, 2), np.float32), np.zeros(0, np.int32), np.zeros((0, 4), np.uint64))
    px, octave, descriptors = keypoints(0, 5)
    some = RowKeypoints(px, octave, words(descriptors))
    assert search_rows(none, some, FACTORS, HEIGHT, 100.0, 75).shape == (0,)
    np.testing.assert_array_equal(search_rows(some, none, FACTORS, HEIGHT, 100.0, 75), np.full(5, -1))


def test_the_best_column_is_that_of_a_plain_search() -> None:
    left, right = textured(0), textured(0) // 2 + textured(1) // 2
    rng = np.random.default_rng(5)
    at = rng.integers([30, 6], [WIDTH - 30, HEIGHT - 6], (200, 2)).astype(np.int32)
    about = (at[:, 0] + rng.integers(-3, 4, 200)).astype(np.int32)
    found = slide(left, right, at, about)
    n_inside = 0
    for (x, y), middle, x_px, distance in zip(at, about, *found, strict=True):
        patch = left[y - 5 : y + 6, x - 5 : x + 6].astype(float)
        sums = []
        for column in range(middle - 5, middle + 6):
            other = right[y - 5 : y + 6, column - 5 : column + 6].astype(float)
            sums.append(np.abs((patch - patch.mean()) - (other - other.mean())).sum())
        best = int(np.argmin(sums))
        if best in (0, 10):
            assert np.isnan(x_px)
            assert distance == np.inf
            continue
        n_inside += 1
        assert distance == pytest.approx(sums[best])
        # Lines of slopes s and −s, through the neighbours: the one with the larger distance passes the best too.
        before, least, after = sums[best - 1 : best + 2]
        slope = max(before, after) - least
        meet = (before - after) / (2.0 * slope)
        assert x_px == pytest.approx(middle - 5 + best + meet)
    assert n_inside > 100


@pytest.mark.parametrize("disparity_px", [0.0, 7.0, 7.25, 12.5, 20.8])
def test_a_known_shift_is_found_within_a_twentieth_of_a_pixel(disparity_px: float) -> None:
    left = textured(7)
    right = shifted(left, disparity_px)
    x, y = np.meshgrid(np.arange(45, WIDTH - 20, 6), np.arange(20, HEIGHT - 20, 6))
    at = np.stack((x.ravel(), y.ravel()), axis=1).astype(np.int32)
    found = slide(left, right, at, np.rint(at[:, 0] - disparity_px + 2).astype(np.int32))
    error_px = found.x_px - (at[:, 0] - disparity_px)
    assert np.isfinite(error_px).all()
    assert np.abs(error_px).max() < 0.15
    assert np.abs(error_px).mean() < 0.05


def test_noise_and_brightness_of_the_right_image_do_little() -> None:
    rng = np.random.default_rng(11)
    left = textured(7) // 2 + 40
    right = np.clip(shifted(left, 12.4) + 9 + rng.normal(0, 2.2, left.shape), 0, 255).astype(np.uint8)
    left = np.clip(left + rng.normal(0, 2.2, left.shape), 0, 255).astype(np.uint8)
    x, y = np.meshgrid(np.arange(45, WIDTH - 20, 6), np.arange(20, HEIGHT - 20, 6))
    at = np.stack((x.ravel(), y.ravel()), axis=1).astype(np.int32)
    error_px = slide(left, right, at, np.rint(at[:, 0] - 12.4).astype(np.int32)).x_px - (at[:, 0] - 12.4)
    assert np.isfinite(error_px).all()
    assert np.median(np.abs(error_px)) < 0.06


def test_patches_that_would_leave_the_right_image_find_nothing() -> None:
    left = textured(8)
    at = np.array([[100, 60], [100, 60], [100, 60], [100, 60]], np.int32)
    found = slide(left, left, at, np.array([9, 10, WIDTH - 11, WIDTH - 10], np.int32))
    assert np.isnan(found.x_px[[0, 3]]).all()
    assert np.isinf(found.distance[[0, 3]]).all()
    for turned, outermost in ((-90, 10), (WIDTH - 11 - 100, WIDTH - 11)):
        there = slide(left, np.roll(left, turned, axis=1), at[:1], np.array([outermost], np.int32))
        assert np.rint(there.x_px[0]) == outermost
        assert there.distance[0] == 0.0


def test_a_flat_patch_is_not_certain() -> None:
    flat = np.full((HEIGHT, WIDTH), 90, np.uint8)
    found = slide(flat, flat, np.array([[100, 60]], np.int32), np.array([95], np.int32))
    assert np.isnan(found.x_px[0])


def test_refined_columns_are_those_of_the_image_on_every_level() -> None:
    left = textured(9, 300, 400)
    left = cv2.GaussianBlur(left, (0, 0), 2.0)
    right = shifted(left, 9.3)
    sizes = [(round(400 / f), round(300 / f)) for f in FACTORS]
    levels = [[cv2.resize(image, size, interpolation=cv2.INTER_AREA) for size in sizes] for image in (left, right)]
    rng = np.random.default_rng(0)
    octave = np.repeat(np.arange(8), 20).astype(np.int32)
    own = np.stack([rng.integers([40, 20], [w - 30, h - 20], (20, 2)) for w, h in np.array(sizes)]).reshape(-1, 2)
    ratio = np.array([[400 / w, 300 / h] for w, h in sizes])[octave]
    px = ((own + 0.5) * ratio - 0.5).astype(np.float32)
    found = refine(
        *levels, px, octave, px[:, 0] - np.float32(9.3) + rng.uniform(-2, 2, 160).astype(np.float32), (400, 300)
    )
    error_px = found.x_px - (px[:, 0] - 9.3)
    assert np.isfinite(error_px).mean() > 0.97
    for level in range(8):
        here = error_px[octave == level]
        assert np.nanmean(np.abs(here)) < 0.06 * FACTORS[level], f"level {level}"


def test_the_median_rule_leaves_out_what_is_far_off() -> None:
    distance = np.array([100.0, 110.0, 90.0, 209.9, 210.1, np.inf, 1000.0, 80.0, 100.0])
    assert np.median(distance[np.isfinite(distance)]) == 105.0
    expected = [True, True, True, True, True, False, False, True, True]
    np.testing.assert_array_equal(agreeing(distance, 2.1), expected)
    np.testing.assert_array_equal(agreeing(distance, 2.0), [True] * 3 + [True, False] + [False] * 2 + [True] * 2)
    assert not agreeing(np.full(3, np.inf), 2.1).any()
    assert agreeing(np.zeros(0), 2.1).shape == (0,)
