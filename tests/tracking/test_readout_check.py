"""What the rows of frames say of the readout in a camera file, on a small world whose true readout is known."""

from dataclasses import replace

import numpy as np
import pytest
from small_world import CAMERA, SmallMap, SmallWorld, pose

from stillroom.data.frame import Frame
from stillroom.data.map import submaps
from stillroom.data.matches import Matches
from stillroom.data.motion import Motion
from stillroom.data.result import Tracked, TrackingState
from stillroom.geometry import se3, twists
from stillroom.optimize.depth_terms import RightCoordinate
from stillroom.optimize.pose import PoseOptimizerConfig
from stillroom.session.plausibility import ShutterDoubts
from stillroom.tracking.readout_check import LONGEST_GAP_S, ReadoutCheck, Rows, RowsFound
from stillroom.tracking.shutter import Before, GlobalShutter, RollingShutter, RollingShutterConfig

WORLD = SmallWorld.of(0, 600)
FILE_S = 0.03
DEPTH = RightCoordinate()
N_FRAMES = 26


def where(t_s: float) -> np.ndarray:
    """The pose of a camera in a hand."""
    turns = 0.08 * np.sin(4.0 * t_s), 0.1 * np.sin(3.0 * t_s + 1.0), 0.06 * np.sin(5.0 * t_s + 2.0)
    return pose(0.03 * np.sin(3.0 * t_s), 0.02 * np.sin(4.0 * t_s), 0.0, turns)


def look(k: int, true_s: float) -> tuple[Frame, np.ndarray]:
    """Frame k, each keypoint seen at its row's true time; its camera file says 30 ms."""
    t_s = k / 30.0
    frame, seen = WORLD.look(where(t_s), seed=k, index=k)
    kp, T = frame.keypoints, se3.inverse(where(t_s))
    velocity = twists.log((se3.inverse(where(t_s + 1e-4)) @ where(t_s - 1e-4))[None])[0] / 2e-4
    seen_px, x = kp.px.astype(np.float64), np.empty((len(kp), 3))
    for _ in range(5):  # where a point is seen decides when, which decides where
        after_s = ((seen_px[:, 1] + 0.5) / CAMERA.height - 0.5) * true_s
        away = twists.exp(after_s[:, None] * velocity)
        x = np.einsum("nij,nj->ni", away[:, :3, :3], se3.transform(T, WORLD.points_m[seen])) + away[:, :3, 3]
        seen_px = CAMERA.project(x)
    px = (seen_px + np.random.default_rng(k).normal(0.0, 0.4, seen_px.shape)).astype(np.float32)
    depth_m = x[:, 2].astype(np.float32)
    kp = replace(kp, px=px, raw_px=px, depth_m=depth_m, right_px=CAMERA.right_coordinate(px[:, 0], depth_m))
    return replace(frame, camera=replace(CAMERA, readout_s=FILE_S), keypoints=kp), seen


class Tracking:
    """Tracks frames against a map whose first keyframe was taken while the camera stood still."""

    def __init__(self, true_s: float, check: bool = True) -> None:
        self.true_s, self.small = true_s, SmallMap.of(WORLD, [where(0.0)])
        self.shutter = RollingShutter(RollingShutterConfig(check=check), PoseOptimizerConfig(), FILE_S)
        self.before = where(0.0)

    def track(self, k: int) -> Tracked:
        frame, seen = look(k, self.true_s)
        ids, guess = self.small.id_of[seen], se3.inverse(where(k / 30.0))
        frame = self.shutter.at_mid_frame(frame, self.shutter.expected(guess, Before(self.before, 1 / 30.0)))
        fitted = self.shutter.fit(frame, guess, Matches.of(ids), self.small.map.points.position_m, None, DEPTH)
        frame = self.shutter.at_mid_frame(frame, fitted.velocity)
        matches = Matches.of(ids)
        inliers = np.full(len(ids), -1, dtype=np.int32)
        inliers[matches.keypoint[fitted.is_inlier]] = matches.point_id[fitted.is_inlier]
        self.before = se3.inverse(fitted.T_cam_world)
        motion = Motion.none(len(frame), CAMERA.height, CAMERA.width)
        return self.shutter.learn(Tracked(frame, TrackingState.OK, self.before, inliers, motion, 0), self.small.map)

    def run(self) -> RowsFound:
        for k in range(1, N_FRAMES):
            self.track(k)
        found = self.shutter.found
        assert found is not None
        # Once rows speak for the file every second frame is asked; where they speak against it, all are.
        assert found.n_frames == N_FRAMES - 3 if found.as_one else (N_FRAMES - 3) // 2 < found.n_frames < N_FRAMES - 3
        return found


@pytest.mark.parametrize(("true_s", "as_one"), [(0.0, True), (0.015, False), (0.03, False)])
def test_the_readout_is_found_and_one_that_is_not_there_is_left_out(true_s: float, as_one: bool) -> None:
    found = Tracking(true_s).run()
    assert abs(found.readout_s - true_s) < min(3.0 * found.sigma_s, 0.004)
    assert found.sigma_s < 0.004
    assert found.as_one == as_one
    assert (found.n_as_one > 10) == as_one


def test_without_the_check_nothing_is_asked() -> None:
    tracking = Tracking(0.0, check=False)
    for k in range(1, 4):
        assert tracking.track(k).frame.velocity is not None
    assert tracking.shutter.found is None


def test_rows_read_as_one_are_a_global_shutter_to_the_byte() -> None:
    tracking = Tracking(0.0)
    tracking.run()
    frame, seen = look(N_FRAMES, 0.0)
    guess = se3.inverse(where(N_FRAMES / 30.0))
    asked = guess, Matches.of(tracking.small.id_of[seen]), tracking.small.map.points.position_m, None, DEPTH
    assert tracking.shutter.expected(guess, Before(tracking.before, 1 / 30.0)) is None
    ours, other = tracking.shutter.fit(frame, *asked), GlobalShutter(PoseOptimizerConfig()).fit(frame, *asked)
    assert ours.velocity is None
    assert ours.T_cam_world.tobytes() == other.T_cam_world.tobytes()


def test_what_was_found_before_the_verdict_is_found_again() -> None:
    """Keyframes, the points that they made of their depth, and frames: as with a camera file that says 0."""
    tracking = Tracking(0.0)
    world = tracking.small.map
    tracked = tracking.track(1)
    assert tracked.frame.velocity is not None
    askew = se3.exp(np.full(6, 0.002)) @ tracking.before
    keyframe = world.add_keyframe(tracked.frame, askew, tracked.point_ids, tracked.frame.is_static, 0)
    rows, (taken, seen) = world.rows(keyframe), look(1, 0.0)
    free = np.flatnonzero(world.points_of(keyframe) < 0)
    new = world.add_points(np.zeros((len(free), 3)), rows.start + free)
    tracking.shutter.remember(replace(tracked, T_world_cam=askew, reference_keyframe=keyframe), world)
    assert np.abs(world.keypoints.px[rows] - taken.keypoints.px).max() > 0.2

    again: dict[int, np.ndarray] = {}
    decided = 1
    while not again:
        decided += 1
        tracked = tracking.track(decided)
        assert tracking.shutter.put_back() in ([], [keyframe])
        again = tracking.shutter.found_again(world)
    assert sorted(again) == list(range(1, decided + 1))
    assert not tracking.shutter.found_again(world), "each is given once"
    assert tracked.frame.velocity is None, "the frame of the verdict is found again at once"
    np.testing.assert_array_equal(tracked.frame.keypoints.px, look(decided, 0.0)[0].keypoints.px)
    np.testing.assert_array_equal(world.keypoints.px[rows], taken.keypoints.px)
    np.testing.assert_array_equal(world.keypoints.right_px[rows], taken.keypoints.right_px)
    np.testing.assert_allclose(world.keyframes.T_world_cam[keyframe], again[1], atol=1e-3)
    assert len(new) > 5
    assert np.abs(world.points.position_m[new] - WORLD.points_m[seen[free]]).max() < 0.02
    other = GlobalShutter(PoseOptimizerConfig())
    for k, T_world_cam in again.items():
        frame, seen = look(k, 0.0)
        matches = Matches.of(tracking.small.id_of[seen])
        T = other.fit(frame, se3.inverse(where(k / 30.0)), matches, world.points.position_m, None, DEPTH).T_cam_world
        assert np.abs(T @ T_world_cam - np.eye(4)).max() < 5e-4


def test_a_keyframe_that_an_earlier_run_made_of_the_same_image_stays_as_it_is() -> None:
    """As where a recording is localized in the map that was made of it."""
    tracking = Tracking(0.0)
    world, (frame, seen) = tracking.small.map, look(1, 0.0)
    keyframe = world.add_keyframe(frame, where(1 / 30.0), tracking.small.id_of[seen], frame.is_static, 0)
    px, T_world_cam = world.keypoints.px + 1.0, world.keyframes.T_world_cam.copy()
    world.keypoints.px[:] = px
    tracking.shutter.remember(replace(tracking.track(1), reference_keyframe=keyframe), world)
    for k in range(2, N_FRAMES):
        tracking.track(k)
    assert tracking.shutter.found is not None
    assert tracking.shutter.found.as_one
    assert tracking.shutter.put_back() == []
    np.testing.assert_array_equal(world.keypoints.px, px)
    np.testing.assert_array_equal(world.keyframes.T_world_cam, T_world_cam)


def rows_at(time_s: float, T_world_cam: np.ndarray, n_jumps: int = 0, submap: int = 0) -> Rows:
    return Rows(time_s, T_world_cam, n_jumps, submap, np.eye(12), np.zeros(12), np.zeros(6))


def test_frames_that_do_not_follow_each_other_say_nothing() -> None:
    check = ReadoutCheck(FILE_S)
    for k in range(6):
        check.add(rows_at(k * (LONGEST_GAP_S + 0.05), where(0.1 * k)))
        check.add(rows_at(k * (LONGEST_GAP_S + 0.05) + 0.03, where(0.1 * k + 0.03)))
    assert check.found is None
    for k in range(6):
        check.add(rows_at(10.0 + k / 30.0, where(k / 30.0), n_jumps=k))
    assert check.found is None


def test_a_pose_in_a_map_that_was_dropped_is_not_compared_with_those_of_the_next() -> None:
    """Another origin, and with a single camera another unit: between the two maps the camera has no velocity."""
    check = ReadoutCheck(FILE_S)
    for k in range(2):
        check.add(rows_at(k / 30.0, where(k / 30.0)))
    for k in range(2, 4):
        check.add(rows_at(k / 30.0, submaps.origin(1) @ where(k / 30.0), submap=1))
    assert check.found is None
    check.add(rows_at(4 / 30.0, submaps.origin(1) @ where(4 / 30.0), submap=1))
    assert check.found is not None
    assert check.found.n_frames == 1


def test_a_frame_that_is_found_twice_counts_once() -> None:
    check = ReadoutCheck(FILE_S)
    for k in range(12):
        check.add(rows_at(k / 60.0, where(k // 2 * 2 / 60.0)) if k % 2 == 0 else rows_at((k - 1) / 60.0, where(0.5)))
    assert check.found is not None
    assert check.found.n_frames == 4


def test_a_camera_at_rest_is_taken_to_have_what_its_file_says() -> None:
    check = ReadoutCheck(FILE_S)
    for k in range(50):
        assert not check.add(rows_at(k / 30.0, np.eye(4)))
    assert check.found is not None
    assert check.found.sigma_s > 1.0
    assert not check.as_one
    assert not check.is_settled


def test_each_doubt_is_said_once() -> None:
    doubts = ShutterDoubts()
    other = RowsFound(FILE_S, 0.0152, 0.0021, 40, as_one=False, n_as_one=0)
    said = [str(doubt) for found in (None, other, other) for doubt in doubts.add(found)]
    assert said == [
        "this recording's readout looks like 15 ± 2 ms, its camera file says 30 ms; 'stillroom calibrate shutter' "
        "estimates it [see troubleshooting: shutter]"
    ]
    as_one = RowsFound(FILE_S, 0.0004, 0.0019, 40, as_one=True, n_as_one=30)
    said = [str(doubt) for _ in range(2) for doubt in doubts.add(as_one)]
    assert said == [
        "this recording's readout looks like 0 ± 2 ms, its camera file says 30 ms: rows are read as one; if the "
        "shutter is a global one, leave out readout_s [see troubleshooting: shutter]"
    ]
    near = RowsFound(FILE_S, 0.0255, 0.0011, 40, as_one=False, n_as_one=0)
    assert not list(ShutterDoubts().add(near)), "some milliseconds are nothing to warn of"
    assert not list(ShutterDoubts().add(replace(other, n_frames=10))), "nor is a guess"


def test_once_rows_speak_for_the_file_every_second_frame_is_asked() -> None:
    tracking, n_found = Tracking(FILE_S), []
    for k in range(2 * N_FRAMES):
        tracking.track(k)
        found = tracking.shutter.found
        n_found.append(0 if found is None else found.n_frames)
    steps = np.diff(n_found[2:])
    assert set(steps[:2]) == {1}, "every frame, until then"
    assert list(steps[-4:]) in ([1, 0, 1, 0], [0, 1, 0, 1])
    found = tracking.shutter.found
    assert found is not None
    assert abs(found.readout_s - FILE_S) < 4.0 * found.sigma_s
