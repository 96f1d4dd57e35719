"""How poses are found under either shutter, on a small world whose rows are read while the camera moves."""

from dataclasses import replace

import numpy as np
import pytest
from building import parts
from small_world import CAMERA, SmallMap, SmallWorld, pose

from stillroom.data.frame import Frame
from stillroom.data.matches import Matches
from stillroom.data.motion import Motion
from stillroom.geometry import se3
from stillroom.optimize.depth_terms import MeasuredDepth, RightCoordinate
from stillroom.optimize.pose import PoseOptimizerConfig
from stillroom.tracking.shutter import (
    FASTEST_TURN_RAD_S,
    Before,
    DepthNoiseConfig,
    GlobalShutter,
    RollingShutter,
    RollingShutterConfig,
    expected_velocity,
    turn_rad_s,
)
from stillroom.tracking.tracker import TrackerConfig

WORLD = SmallWorld.of(0, 600)
ROLLING_CAMERA = replace(CAMERA, readout_s=0.03)
VELOCITY = np.array([0.2, -0.1, 0.15, 0.5, -0.7, 0.4])


def look(T_world_cam: np.ndarray, velocity: np.ndarray = VELOCITY, noise_px: float = 0.3) -> tuple[Frame, np.ndarray]:
    """A frame whose keypoints are seen each at its row's time, and which point each one is."""
    frame, seen = WORLD.look(T_world_cam, seed=7, noise_px=0.0, index=2)
    kp = frame.keypoints
    seen_px = kp.px.astype(np.float64)
    for _ in range(5):  # where a point is seen decides when, which decides where
        after_s = ROLLING_CAMERA.rows_after_s(seen_px[:, 1])
        T = [se3.exp(t * velocity) @ se3.inverse(T_world_cam) for t in after_s]
        x = np.array([se3.transform(pose, p[None])[0] for pose, p in zip(T, WORLD.points_m[seen], strict=True)])
        seen_px = CAMERA.project(x)
    px = seen_px + noise_px * np.random.default_rng(1).normal(size=(len(x), 2))
    px = px.astype(np.float32)
    depth_m = x[:, 2].astype(np.float32)
    kp = replace(kp, px=px, raw_px=px, depth_m=depth_m, right_px=CAMERA.right_coordinate(px[:, 0], depth_m))
    return replace(frame, camera=ROLLING_CAMERA, keypoints=kp), seen


def rolling(**deviations: float) -> RollingShutter:
    loose = {"turn_rad_s": 0.5, "speed_m_s": 0.05}
    return RollingShutter(RollingShutterConfig(**(loose | deviations)), PoseOptimizerConfig(), 0.03)


def matches_of(small: SmallMap, seen: np.ndarray) -> Matches:
    return Matches.of(small.id_of[seen].astype(np.int32))


def pose_error(found: np.ndarray, T_world_cam: np.ndarray) -> float:
    between = found @ T_world_cam
    return float(np.linalg.norm(between[:3, 3]) + se3.angle_rad(between))


def test_pose_and_velocity_are_found_where_one_for_all_rows_is_wrong() -> None:
    small = SmallMap.of(WORLD, [np.eye(4), pose(0.02)])
    position_m = small.map.points.position_m
    frame, seen = look(pose(0.04))
    matches, guess = matches_of(small, seen), se3.inverse(pose(0.04))
    moving = rolling(turn_rad_s=1.0, speed_m_s=0.3).fit(frame, guess, matches, position_m, None, RightCoordinate())
    still = GlobalShutter(PoseOptimizerConfig()).fit(frame, guess, matches, position_m, None, RightCoordinate())
    assert moving.velocity is not None
    np.testing.assert_allclose(moving.velocity[3:], VELOCITY[3:], atol=0.15)
    assert pose_error(moving.T_cam_world, pose(0.04)) < 0.4 * pose_error(still.T_cam_world, pose(0.04))
    assert moving.is_inlier.mean() > 0.97
    assert still.velocity is None


def test_a_frame_moved_by_the_right_velocity_has_nothing_left_to_find() -> None:
    small = SmallMap.of(WORLD, [np.eye(4), pose(0.02)])
    position_m = small.map.points.position_m
    frame, seen = look(pose(0.04), noise_px=0.0)
    moved = rolling().at_mid_frame(frame, VELOCITY)
    middle, _ = WORLD.look(pose(0.04), seed=7, index=2)
    assert np.abs(moved.keypoints.px - middle.keypoints.px).max() < 0.1
    assert np.abs(frame.keypoints.px - middle.keypoints.px).max() > 3.0
    np.testing.assert_array_equal(moved.keypoints.raw_px, frame.keypoints.raw_px)
    np.testing.assert_allclose(
        moved.keypoints.right_px, CAMERA.right_coordinate(moved.keypoints.px[:, 0], frame.keypoints.depth_m)
    )
    fitted = rolling().fit(moved, se3.inverse(pose(0.04)), matches_of(small, seen), position_m, None, RightCoordinate())
    assert fitted.velocity is not None
    assert np.abs(fitted.velocity).max() < 0.05


def test_without_a_velocity_a_frame_stays_as_it_is() -> None:
    frame, _ = look(pose(0.04))
    shutter = rolling()
    assert shutter.at_mid_frame(frame, None) is frame
    assert shutter.at_mid_frame(frame, np.zeros(6)) is frame
    assert GlobalShutter(PoseOptimizerConfig()).at_mid_frame(frame, VELOCITY) is frame


def test_keypoints_without_depth_are_moved_as_if_at_the_usual_one() -> None:
    frame, _ = look(pose(0.04))
    kp = frame.keypoints
    depth_m = kp.depth_m.copy()
    depth_m[::2] = 0.0
    usual_m = np.median(depth_m[1::2])
    moved = rolling().at_mid_frame(replace(frame, keypoints=replace(kp, depth_m=depth_m)), VELOCITY).keypoints
    filled = np.where(depth_m > 0, depth_m, usual_m).astype(np.float32)
    known = rolling().at_mid_frame(replace(frame, keypoints=replace(kp, depth_m=filled)), VELOCITY).keypoints
    np.testing.assert_allclose(moved.px, known.px, atol=1e-3)
    assert (moved.right_px[::2] == -1.0).all()


def test_the_velocity_expected_leads_from_the_frame_before_to_the_guess() -> None:
    T_before = pose(0.02)
    guess = se3.exp(0.04 * VELOCITY) @ se3.inverse(T_before)
    np.testing.assert_allclose(expected_velocity(guess, Before(T_before, 0.04)), VELOCITY, atol=1e-9)
    assert not expected_velocity(guess, None).any()
    assert not expected_velocity(guess, Before(T_before, 0.0)).any()
    wild = se3.exp(np.array([0, 0, 0, 0, 0.04 * (FASTEST_TURN_RAD_S + 1.0), 0])) @ se3.inverse(T_before)
    assert not expected_velocity(wild, Before(T_before, 0.04)).any()


class KeepAll:
    def judge(self, question: object) -> Motion:
        return Motion.none(1000, 480, 640)


@pytest.mark.parametrize("readout_s", [0.0, 0.03])
def test_a_rolling_shutter_is_modelled_where_the_camera_has_one(readout_s: float) -> None:
    built = TrackerConfig(shutter="rolling").build(parts(replace(CAMERA, readout_s=readout_s)), KeepAll())
    assert isinstance(built.pose, RollingShutter if readout_s else GlobalShutter)
    assert isinstance(TrackerConfig().build(parts(ROLLING_CAMERA), KeepAll()).pose, GlobalShutter)


def test_rows_have_the_times_of_the_image_as_taken() -> None:
    after_s = ROLLING_CAMERA.rows_after_s(np.array([-0.5, 239.5, 479.5]))
    np.testing.assert_allclose(after_s, [-0.015, 0.0, 0.015])
    assert not CAMERA.rows_after_s(np.array([0.0, 479.0])).any()


def test_depth_counts_as_in_orb_slam2_while_the_camera_turns_or_nobody_knows_how_fast() -> None:
    kinect = replace(CAMERA, depth_noise="structured-light")
    config = DepthNoiseConfig(right_sigma=0.5, model="sensor")
    observed, weights = np.array([[300.0, 200.0, 280.0]]), np.ones((1, 3))
    slow, fast, unknown = (config.terms(turn, kinect) for turn in (0.4, 0.6, turn_rad_s(np.eye(4), None)))
    assert isinstance(slow, MeasuredDepth)
    for terms in (fast, unknown):
        np.testing.assert_array_equal(terms(observed, weights, kinect).weights, weights)
        assert terms(observed, weights, kinect).intrinsics[5] == 1.0
    assert isinstance(config.terms(0.4, CAMERA), RightCoordinate), "nothing is known of that sensor"
    assert config.terms(0.4, CAMERA)(observed, weights, CAMERA).weights[0, 2] == 4.0
    assert turn_rad_s(np.eye(4), Before(np.eye(4), 0.0)) == np.inf
    assert turn_rad_s(np.eye(4), Before(se3.exp(np.array([0, 0, 0, 0, 0.02, 0])), 0.1)) == pytest.approx(0.2)
