"""Depth at the time of colour: of a room of tilted planes, whose depth is known in closed form at every moment."""

from dataclasses import replace

import numpy as np
import pytest
from small_world import CAMERA, SCALES

from stillroom.data.frame import Frame, Keypoints
from stillroom.data.image import RgbdImage
from stillroom.geometry import se3
from stillroom.geometry.camera import Camera
from stillroom.tracking.depth_clock import with_depth_in_time
from stillroom.tracking.shutter import DepthNoiseConfig

LENS = replace(CAMERA, distortion=(0.1, -0.2, 0.001, 0.002, 0.0))
WALL, DISTANCE_M = np.array([0.4, -0.25, 1.0]), 2.5
VELOCITY = np.array([0.4, -0.3, 0.8, 0.5, -0.9, 0.3])
RAW = np.stack(np.meshgrid(np.arange(640.0), np.arange(480.0)), axis=2).reshape(-1, 2).astype(np.float32)


def depth_of(T_cam_world: np.ndarray, px: np.ndarray, camera: Camera) -> np.ndarray:
    """Depth (N,) of the wall n·x = d of the world at undistorted pixels (N, 2)."""
    n = WALL @ T_cam_world[:3, :3].T
    d = DISTANCE_M + n @ T_cam_world[:3, 3]
    rays = np.column_stack(((px - (camera.cx, camera.cy)) / (camera.fx, camera.fy), np.ones(len(px))))
    return np.asarray(d / (rays @ n))


def frame_of(after_s: float, camera: Camera) -> Frame:
    """A frame at the origin; its depth image is from where the camera is `after_s` later."""
    then = se3.exp(after_s * VELOCITY)
    image_m = depth_of(then, camera.undistort(RAW).astype(np.float64), camera).reshape(480, 640).astype(np.float32)
    px = np.random.default_rng(0).uniform((60, 60), (580, 420), (400, 2)).astype(np.float32)
    raw = camera.distort(px).astype(np.float32)
    places = np.rint(raw).astype(int)
    depth_m = image_m[places[:, 1], places[:, 0]]
    nothing, n = np.zeros((480, 640, 3), np.uint8), len(px)
    kp = Keypoints(
        px, raw, np.zeros(n, np.int32), np.zeros(n, np.float32), np.zeros((n, 32), np.uint8), depth_m,
        camera.right_coordinate(px[:, 0], depth_m),
    )  # fmt: skip
    return Frame(RgbdImage(0.0, nothing, image_m, depth_after_s=after_s), camera, SCALES, kp, np.ones(n, np.bool_))


@pytest.mark.parametrize("after_s", [-0.02, 0.015])
@pytest.mark.parametrize("camera", [CAMERA, LENS])
def test_depth_is_what_it_was_when_colour_was_taken(after_s: float, camera: Camera) -> None:
    frame = frame_of(after_s, camera)
    kp = frame.keypoints
    true_m = depth_of(np.eye(4), kp.px.astype(np.float64), camera)
    moved = with_depth_in_time(frame, after_s, VELOCITY).keypoints
    # The nearest pixel is half a pixel away, which is 2 mm on this wall.
    assert np.abs(moved.depth_m - true_m).max() < 0.004
    assert np.abs(kp.depth_m - true_m).max() > 0.02
    np.testing.assert_allclose(moved.right_px, camera.right_coordinate(kp.px[:, 0], moved.depth_m))
    np.testing.assert_array_equal(moved.px, kp.px)


def test_what_has_no_depth_then_has_none_and_unknown_stays_unknown() -> None:
    frame = frame_of(0.015, CAMERA)
    image_m = frame.image.depth_m.copy()
    image_m[:, 320:] = 0.0
    depth_m = frame.keypoints.depth_m.copy()
    depth_m[:50] = 0.0
    kp = replace(frame.keypoints, depth_m=depth_m)
    lost = replace(frame, image=replace(frame.image, depth_m=image_m), keypoints=kp)
    moved = with_depth_in_time(lost, 0.015, VELOCITY).keypoints
    assert (moved.depth_m[kp.px[:, 0] > 340] == 0.0).all()
    assert (moved.depth_m[:50] == 0.0).all()
    assert (moved.right_px[moved.depth_m == 0.0] == -1.0).all()
    assert (moved.depth_m[50:][kp.px[50:, 0] < 300] > 0.0).all()


def test_nothing_is_done_where_there_is_nothing_to_correct() -> None:
    frame = frame_of(0.015, CAMERA)
    assert with_depth_in_time(frame, 0.0, VELOCITY) is frame
    assert with_depth_in_time(frame, 0.015, np.zeros(6)) is frame


def test_stamps_count_where_the_method_or_the_camera_says_so() -> None:
    frame = frame_of(0.015, CAMERA)
    assert DepthNoiseConfig().after_s(frame) == 0.0
    assert DepthNoiseConfig(in_time=True).after_s(frame) == 0.015
    assert DepthNoiseConfig().after_s(replace(frame, camera=replace(CAMERA, depth_offset_s=-0.01))) == 0.015
