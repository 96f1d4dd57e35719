"""The homography of the last two frames, and the image that it makes: against scipy, OpenCV and a flat wall."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from flat_wall import points_on_the_wall
from scipy.optimize import least_squares
from small_world import CAMERA, SCALES, pose

from stillroom.data.frame import Frame
from stillroom.data.image import RgbdImage
from stillroom.dynamics.projected.compensation_frame import (
    CompensationFrame,
    CompensationFrameConfig,
    PreviousFrame,
    compensate,
    matched,
    origins,
)
from stillroom.geometry import homography, se3
from stillroom.geometry.camera import Camera

CONFIG = CompensationFrameConfig()
WALL = points_on_the_wall(n=900)
THEN, NOW = pose(), pose(0.06, 0.02, 0.04, turn=(0.01, -0.03, 0.02))


def true_homography(camera: Camera) -> np.ndarray:
    """Of the plane z = 3 m of the world, which is the first camera's: K (R + t nᵀ / d) K⁻¹."""
    T_now_then = se3.inverse(NOW) @ THEN
    H = camera.K @ (T_now_then[:3, :3] + np.outer(T_now_then[:3, 3], (0, 0, 1)) / 3.0) @ np.linalg.inv(camera.K)
    return H / H[2, 2]


def frames(noise_px: float = 0.0, flips: int = 0) -> tuple[Frame, np.ndarray, Frame, np.ndarray]:
    earlier, who_then = WALL.look(THEN, seed=1, noise_px=noise_px, flips=flips, index=0)
    frame, who_now = WALL.look(NOW, seed=2, noise_px=noise_px, flips=flips, index=1)
    return earlier, who_then, frame, who_now


def previous(frame: Frame, is_masked: np.ndarray | None = None) -> PreviousFrame:
    masked = np.zeros(len(frame), bool) if is_masked is None else is_masked
    return PreviousFrame(frame, masked, se3.inverse(THEN))


def compensated(noise_px: float = 0.0, seed: int = 0) -> tuple[CompensationFrame, Frame, Frame]:
    earlier, _, frame, _ = frames(noise_px)
    moved = compensate(previous(earlier), frame, np.zeros(len(frame), bool), CONFIG, seed)
    assert moved is not None
    return moved, earlier, frame


def test_features_are_matched_by_what_they_look_like() -> None:
    earlier, who_then, frame, who_now = frames(noise_px=0.5, flips=10)
    every = np.ones(len(earlier), bool), np.ones(len(frame), bool)
    then, now = matched(earlier, frame, *every, CONFIG)
    assert len(then) > 0.9 * len(np.intersect1d(who_then, who_now))
    np.testing.assert_array_equal(who_then[then], who_now[now])
    some = np.arange(len(earlier)) % 3 == 0
    then, now = matched(earlier, frame, some, np.arange(len(frame)) % 2 == 0, CONFIG)
    assert len(then) > 50
    assert some[then].all()
    assert np.all(now % 2 == 0)


def test_masked_features_of_either_frame_do_not_count() -> None:
    earlier, _, frame, _ = frames()
    left_then, left_now = (f.keypoints.px[:, 0] < 320 for f in (earlier, frame))
    moved = compensate(previous(earlier, left_then), frame, left_now, CONFIG, 0)
    assert moved is not None
    assert not left_then[moved.previous].any()
    assert not left_now[moved.present].any()


def test_on_a_wall_it_is_the_walls() -> None:
    moved, _, _ = compensated()
    np.testing.assert_allclose(
        moved.fit.H_second_first / moved.fit.H_second_first[2, 2], true_homography(CAMERA), atol=2e-3
    )
    assert moved.fit.is_inlier.all()


@pytest.mark.parametrize("seed", range(3))
def test_the_refined_one_is_the_one_sided_least_squares_of_its_pairs(seed: int) -> None:
    moved, earlier, frame = compensated(noise_px=0.7, seed=seed)
    agrees = moved.fit.is_inlier
    first = earlier.keypoints.px[moved.previous][agrees].astype(np.float64)
    second = frame.keypoints.px[moved.present][agrees].astype(np.float64)

    def one_sided(h: np.ndarray) -> np.ndarray:
        """ε of Eq. 11: the error in the present image alone."""
        x = np.column_stack((first, np.ones(len(first)))) @ np.append(h, 1.0).reshape(3, 3).T
        return (second - x[:, :2] / x[:, 2:]).ravel()

    found = moved.fit.H_second_first / moved.fit.H_second_first[2, 2]
    best = least_squares(one_sided, true_homography(CAMERA).ravel()[:8], method="lm", x_scale=np.abs(found.ravel()[:8]))
    ours = np.sum(one_sided(found.ravel()[:8]) ** 2)
    assert ours == pytest.approx(2.0 * best.cost, rel=1e-5)
    by_scipy = np.append(best.x, 1.0).reshape(3, 3)
    np.testing.assert_allclose(
        homography.apply(by_scipy, first), homography.apply(moved.fit.H_second_first, first), atol=0.01
    )
    symmetric = homography.refine(
        homography.HomographyFit(found, agrees.copy(), 0.0),
        earlier.keypoints.px[moved.previous],
        frame.keypoints.px[moved.present],
        symmetric=True,
    )
    assert not np.allclose(symmetric.H_second_first, moved.fit.H_second_first, atol=1e-9), "two sides would differ"


def test_too_few_pairs_make_no_homography() -> None:
    earlier, _, frame, _ = frames()
    few = np.ones(len(frame), bool)
    few[:15] = False
    assert compensate(previous(earlier), frame, few, CONFIG, 0) is None
    none = np.ones(len(frame), bool)
    assert compensate(previous(earlier), frame, none, CONFIG, 0) is None


def test_the_frame_is_opencvs_where_there_is_no_distortion() -> None:
    rng = np.random.default_rng(0)
    gray = cv2.GaussianBlur(rng.integers(0, 256, (480, 640)).astype(np.uint8), (9, 9), 0)
    depth_m = rng.uniform(1.0, 4.0, (480, 640)).astype(np.float32)
    depth_m[100:140, 200:260] = 0.0
    earlier, _, frame, _ = frames()
    image = RgbdImage(0.0, np.repeat(gray[..., None], 3, axis=2), depth_m, 0)
    moved = compensate(previous(replace(earlier, image=image)), frame, np.zeros(len(frame), bool), CONFIG, 0)
    assert moved is not None
    H = moved.fit.H_second_first
    by_opencv = homography.compensate_image(image.gray, H)
    assert np.mean(np.abs(moved.gray.astype(int) - by_opencv) > 2) < 0.002
    inside = moved.depth_m[moved.depth_m > 0]
    assert len(inside) > 0.8 * depth_m.size
    assert np.isin(inside, depth_m).all(), "depth is moved, not interpolated"


def test_pixels_of_a_distorting_lens_come_from_where_the_homography_says() -> None:
    bonn = Camera(640, 480, 542.8, 542.6, 315.6, 237.8, (0.04, -0.1, -0.004, -0.001, 0.14))
    H = true_homography(bonn)
    x_px, y_px = origins(bonn, H)
    raw_px = np.array([[30.0, 20.0], [600.0, 50.0], [320.0, 240.0], [100.0, 440.0], [610.0, 455.0]])
    ideal = cv2.undistortPoints(raw_px[:, None], bonn.K, np.array(bonn.distortion), P=bonn.K)[:, 0]
    then = cv2.perspectiveTransform(ideal[:, None], np.linalg.inv(H))[:, 0]
    rays = np.column_stack(((then - (bonn.cx, bonn.cy)) / (bonn.fx, bonn.fy), np.ones(len(then))))
    expected = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), bonn.K, np.array(bonn.distortion))[0][:, 0]
    column, row = raw_px.astype(int).T
    np.testing.assert_allclose(np.stack((x_px[row, column], y_px[row, column]), axis=1), expected, atol=0.01)
    assert SCALES.finest_px == 1.0
