"""The extractor as a whole: positions on all levels, depth, counts, bad input."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from building import parts

from stillroom.data.image import RgbdImage
from stillroom.datasets.open import open_dataset
from stillroom.features.orb import BORDER_PX, OrbConfig
from stillroom.geometry.camera import Camera

CAMERA = Camera(640, 480, 517.3, 516.5, 318.6, 255.3, (0.26, -0.95, -0.005, 0.0026, 1.16))
IDEAL = Camera(640, 480, 535.4, 539.2, 320.1, 247.6)


def image_of(gray: np.ndarray, depth_m: np.ndarray | float = 2.0) -> RgbdImage:
    depth = np.broadcast_to(np.asarray(depth_m, np.float32), gray.shape)
    return RgbdImage(0.0, np.repeat(gray[..., None], 3, axis=2), np.ascontiguousarray(depth), 0)


def textured(seed: int = 0) -> np.ndarray:
    noise = np.random.default_rng(seed).integers(0, 256, (480, 640), dtype=np.uint8)
    return cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 2.0), None, 0, 255, cv2.NORM_MINMAX)


def spots_at(places: np.ndarray, sigma_px: float) -> np.ndarray:
    """Bright round spots with their middles at subpixel places (M, 2)."""
    x, y = np.arange(640.0), np.arange(480.0)
    along_x = np.exp(-0.5 * ((x - places[:, :1]) / sigma_px) ** 2)
    along_y = np.exp(-0.5 * ((y - places[:, 1:]) / sigma_px) ** 2)
    return np.rint(40 + 200 * np.einsum("my,mx->yx", along_y, along_x)).astype(np.uint8)


def test_a_spot_is_found_where_it_was_drawn_on_every_level() -> None:
    # FAST answers at the pixel nearest to the middle of a spot that is small on its level.
    rng = np.random.default_rng(3)
    grid = np.stack(np.meshgrid(np.arange(90, 560, 45), np.arange(90, 400, 45)), axis=-1).reshape(-1, 2)
    extractor = OrbConfig(n_features=4000).build(parts(IDEAL))
    for octave in range(8):
        scale = 1.2**octave
        places = grid + rng.uniform(-4, 4, grid.shape)
        frame = extractor.extract(image_of(spots_at(places, 1.3 * scale)))
        px = frame.keypoints.raw_px[frame.keypoints.octave == octave]
        away = px[None] - places[:, None]
        offset = away[np.arange(len(places)), np.abs(away).max(axis=2).argmin(axis=1)]
        # Of two pixels with the same score suppression leaves neither.
        found = offset[np.abs(offset).max(axis=1) < 5 * scale]
        assert len(found) > 0.8 * len(places), f"level {octave}"
        # Each is off by the rounding to a pixel of its level, the mean of many hardly.
        assert np.abs(found).max() < 0.65 * scale, f"level {octave}"
        assert np.abs(found.mean(axis=0)).max() < 0.2 * scale, f"level {octave}"


def test_positions_are_where_a_resize_puts_pixel_centres() -> None:
    frame = OrbConfig().build(parts(IDEAL)).extract(image_of(textured()))
    for octave in range(8):
        width, height = round(640 / 1.2**octave), round(480 / 1.2**octave)
        raw = frame.keypoints.raw_px[frame.keypoints.octave == octave].astype(float)
        own = (raw + 0.5) * [width / 640, height / 480] - 0.5
        np.testing.assert_allclose(own, np.rint(own), atol=2e-4)
        assert np.all((np.rint(own) >= BORDER_PX) & (np.rint(own) < np.array([width, height]) - BORDER_PX))


@pytest.mark.parametrize("n_features", [300, 1000, 2000])
def test_a_textured_image_gives_what_was_asked_for_on_all_levels(n_features: int) -> None:
    frame = OrbConfig(n_features=n_features).build(parts(IDEAL)).extract(image_of(textured()))
    assert abs(len(frame) - n_features) <= 8
    counts = np.bincount(frame.keypoints.octave, minlength=8)
    np.testing.assert_allclose(counts[1:] / counts[:-1], 1 / 1.2, atol=0.04)
    assert frame.is_static.all()
    assert frame.keypoints.descriptors.shape == (len(frame), 32)
    assert np.all(np.abs(frame.keypoints.angle_rad) <= np.float32(np.pi))


@pytest.mark.parametrize("gray", [np.zeros((480, 640), np.uint8), np.full((480, 640), 200, np.uint8)])
def test_an_image_without_texture_has_no_keypoints(gray: np.ndarray) -> None:
    frame = OrbConfig().build(parts(CAMERA)).extract(image_of(gray))
    assert len(frame) == 0
    kp = frame.keypoints
    assert kp.px.shape == kp.raw_px.shape == (0, 2)
    assert kp.descriptors.shape == (0, 32)
    assert len(kp.octave) == len(kp.angle_rad) == len(kp.depth_m) == len(kp.right_px) == 0


def test_weak_corners_serve_where_there_are_few_strong_ones() -> None:
    faint = (100 + 0.12 * textured().astype(float)).astype(np.uint8)
    few = OrbConfig(weak_score=12).build(parts(IDEAL)).extract(image_of(faint))
    more = OrbConfig().build(parts(IDEAL)).extract(image_of(faint))
    assert len(more) > 2 * len(few)


def test_depth_and_right_coordinate_come_from_the_pixel_as_taken() -> None:
    rng = np.random.default_rng(1)
    depth_m = rng.uniform(0.5, 5.0, (480, 640)).astype(np.float32)
    depth_m[rng.random((480, 640)) < 0.3] = 0.0
    frame = OrbConfig().build(parts(CAMERA)).extract(image_of(textured(), depth_m))
    kp = frame.keypoints
    column, row = np.rint(kp.raw_px).astype(int).T
    np.testing.assert_array_equal(kp.depth_m, depth_m[row, column])
    known = kp.depth_m > 0
    assert 0.5 < known.mean() < 0.9
    np.testing.assert_array_equal(kp.right_px[~known], -1)
    np.testing.assert_allclose(kp.right_px[known], kp.px[known, 0] - CAMERA.bf / kp.depth_m[known], atol=1e-3)
    expected_px = cv2.undistortPoints(
        kp.raw_px.reshape(-1, 1, 2).astype(float), CAMERA.K, np.array(CAMERA.distortion), P=CAMERA.K
    )
    assert np.abs(kp.px - kp.raw_px).max() > 5
    np.testing.assert_allclose(kp.px, expected_px.reshape(-1, 2), atol=0.5)


@pytest.mark.parametrize("depth_m", [0.0, 0.05, 25.0, np.nan, np.inf, -1.0])
def test_unusable_depth_is_unknown_depth(depth_m: float) -> None:
    keypoints = OrbConfig().build(parts(IDEAL)).extract(image_of(textured(), depth_m)).keypoints
    assert len(keypoints) > 900
    np.testing.assert_array_equal(keypoints.depth_m, 0)
    np.testing.assert_array_equal(keypoints.right_px, -1)


def test_the_same_image_and_seed_give_the_same_frame_to_the_bit() -> None:
    image = image_of((textured() // 8) * 8)
    first, again = (OrbConfig().build(parts(IDEAL, seed=4)).extract(image).keypoints for _ in range(2))
    for name in first.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
    other = OrbConfig().build(parts(IDEAL, seed=5)).extract(image).keypoints
    assert not np.array_equal(first.raw_px, other.raw_px)


def test_a_turned_real_image_is_matched_with_itself(freiburg1: Path) -> None:
    # What descriptors are for: a half turn of the image leaves the nearest neighbours what they were.
    gray = open_dataset(str(freiburg1)).load(0).gray
    extractor = OrbConfig().build(parts(IDEAL))
    upright = extractor.extract(image_of(gray)).keypoints
    turned = extractor.extract(image_of(np.ascontiguousarray(gray[::-1, ::-1]))).keypoints
    matches = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(upright.descriptors, turned.descriptors)
    error = [upright.raw_px[m.queryIdx] - ([639, 479] - turned.raw_px[m.trainIdx]) for m in matches if m.distance < 50]
    assert len(error) > 600
    assert np.mean(np.abs(error).max(axis=1) < 3) > 0.95


def test_in_an_image_of_twice_the_size_the_same_keypoints_are_found_at_twice_the_pixels() -> None:
    gray = textured()
    large = Camera(1280, 960, 2 * IDEAL.fx, 2 * IDEAL.fy, 2 * IDEAL.cx + 0.5, 2 * IDEAL.cy + 0.5, bf=2 * IDEAL.bf)
    ours = OrbConfig().build(parts(IDEAL)).extract(image_of(gray))
    theirs = OrbConfig().build(parts(large)).extract(image_of(np.repeat(np.repeat(gray, 2, axis=0), 2, axis=1)))
    assert np.array_equal(theirs.keypoints.descriptors, ours.keypoints.descriptors)
    assert np.array_equal(theirs.keypoints.octave, ours.keypoints.octave)
    np.testing.assert_allclose(theirs.keypoints.raw_px + 0.5, 2.0 * (ours.keypoints.raw_px + 0.5), atol=1e-3)
    # Windows and tolerances are in pixels of levels, and a keypoint's noise is one of them.
    np.testing.assert_array_equal(theirs.scales.factors, 2.0 * ours.scales.factors)
    np.testing.assert_allclose(theirs.scales.inverse_variances, ours.scales.inverse_variances / 4.0)
