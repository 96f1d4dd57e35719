"""Poses reported at once and later: on a map whose keyframes move, and in runs of rendered rooms."""

from dataclasses import replace

import numpy as np
import pytest
from small_world import SmallMap, SmallWorld

from stillroom.data.map import Map
from stillroom.data.result import FrameSummary, Recovery, TrackingState
from stillroom.geometry import se3
from stillroom.optimize.trajectory_prior import TrajectoryPriorConfig, smoothed
from stillroom.tracking.reported_poses import OwnPoses, ReportedPoses, reported_poses

PRIOR = TrajectoryPriorConfig(enabled=True)
STEP_S = 1 / 30
SPEED = np.array([0.2, -0.1, 0.15, 0.3, -0.4, 0.2])
WORLD = SmallWorld.of(0, 200)


def at(time_s: float) -> np.ndarray:
    """T_world_cam of a camera that moves steadily."""
    return se3.inverse(se3.exp(time_s * SPEED))


class Run:
    """Frames in a map with three keyframes; their own poses are off by millimetres."""

    def __init__(self) -> None:
        self.map: Map = SmallMap.of(WORLD, [at(time_s) for time_s in (0.0, 0.4, 0.8)]).map
        self.reported = ReportedPoses(PRIOR, self.map)
        self.results: list[FrameSummary] = []
        self.own: list[np.ndarray] = []
        self._rng = np.random.default_rng(0)

    def add(self, time_s: float, T_now_then: np.ndarray | None = None, keyframe: int = 0, **changed: object) -> None:
        """Add a frame, in a map that has moved since."""
        spread = np.repeat((PRIOR.position_m, PRIOR.rotation_rad), 3)
        own = at(time_s) @ se3.exp(spread * self._rng.normal(size=6))
        own = own if T_now_then is None else T_now_then @ own
        noted, k = self.map.noted_in(keyframe, own), len(self.results)
        result = FrameSummary(
            k, time_s, TrackingState.OK, own, 500, 500, 300, 3, False, keyframe, noted, n_agreeing=300
        )
        self.own.append(own)
        self.results.append(self.reported.at_once(replace(result, **changed), self.results))

    def lose(self, time_s: float) -> None:
        lost = FrameSummary(len(self.results), time_s, TrackingState.LOST, None, 500, 500, 0, 3, False, -1, None)
        self.results.append(self.reported.at_once(lost, self.results))

    def many(self, n: int, start: int = 0) -> "Run":
        for k in range(start, start + n):
            self.add(k * STEP_S, keyframe=k // 12 % 3)
        return self

    def errors_m(self, poses: np.ndarray) -> np.ndarray:
        truth = np.array([at(r.timestamp_s)[:3, 3] for r in self.results if r.T_world_cam is not None])
        return np.linalg.norm(poses[:, :3, 3] - truth, axis=1)


def test_the_result_has_the_pose_that_the_frames_so_far_say_and_keeps_its_own_for_the_map() -> None:
    run = Run().many(40)
    for k in (3, 10, 25, 39):
        result, before = run.results[k], slice(max(0, k - 25), k + 1)
        times_s = np.array([r.timestamp_s for r in run.results[before]])
        expected = smoothed(times_s, np.array(run.own[before]), np.full(len(times_s), 300.0), PRIOR)[-1]
        np.testing.assert_allclose(result.T_world_cam, expected, atol=1e-4)
        assert np.abs(expected - run.own[k]).max() > 2e-4
        own = run.map.placed_by(result.reference_keyframe, result.T_reference_cam)
        np.testing.assert_allclose(own, run.own[k], atol=1e-12)


def test_later_poses_are_better_than_those_reported_at_once_and_these_better_than_the_own() -> None:
    run = Run().many(200)
    at_once = np.array([r.T_world_cam for r in run.results])
    lagged = run.reported.lagged(0)
    np.testing.assert_array_equal(lagged.timestamps_s, [r.timestamp_s for r in run.results])
    own, now, later = (
        np.sqrt(np.mean(run.errors_m(poses)[20:] ** 2)) for poses in (np.array(run.own), at_once, lagged.T_world_cam)
    )
    assert now < 0.9 * own
    assert later < 0.8 * now
    np.testing.assert_array_equal(lagged.T_world_cam[-1], at_once[-1])  # nothing came after it


def test_a_map_that_is_corrected_is_no_motion_of_the_camera() -> None:
    still, moved, jump = Run().many(60), Run().many(40), se3.exp(np.array([0.4, 0.1, -0.2, 0.1, 0.2, 0.3]))
    moved.map.keyframes.T_world_cam[:] = jump @ moved.map.keyframes.T_world_cam
    for k in range(40, 60):
        moved.add(k * STEP_S, jump, k // 12 % 3)
    for one, other in zip(still.results[40:], moved.results[40:], strict=True):
        np.testing.assert_allclose(other.T_world_cam, jump @ one.T_world_cam, atol=1e-9)
    later, after = still.reported.lagged(0).T_world_cam, moved.reported.lagged(0).T_world_cam
    np.testing.assert_allclose(after[:35], later[:35], atol=1e-9)  # reported before it
    np.testing.assert_allclose(after[35:], jump @ later[35:], atol=1e-9)


def test_frames_that_were_found_again_count_as_they_are_now() -> None:
    run, other = Run().many(20), Run().many(20)
    for k in range(10, 20):
        wrong = run.results[k].T_reference_cam.copy()
        wrong[:3, 3] += (0.02, 0.0, 0.0)
        run.results[k] = replace(run.results[k], T_reference_cam=wrong)
    for each in (run, other):
        each.add(20 * STEP_S)
    off = run.results[20].T_world_cam[:3, 3] - other.results[20].T_world_cam[:3, 3]
    assert 0.001 < np.linalg.norm(off) < 0.02


@pytest.mark.parametrize("event", ["lost for long", "relocalized", "another sub-map"])
def test_over_a_break_nothing_is_known(event: str) -> None:
    run, k = Run().many(30), 30
    if event == "lost for long":
        while k < 45:
            run.lose(k * STEP_S)
            k += 1
        run.add(k * STEP_S)
    elif event == "relocalized":
        run.lose(k * STEP_S)
        k += 1
        run.add(k * STEP_S, recovery=Recovery.PLACE)
    else:
        run.map.keyframes.submap[0] = 1
        run.add(k * STEP_S, keyframe=0)
    assert run.results[29].T_world_cam is not run.own[29]
    first = len(run.own) - 1
    for number in range(1, 8):
        run.add((k + number) * STEP_S, keyframe=run.results[-1].reference_keyframe)
    reported = [r.T_world_cam for r in run.results if r.T_world_cam is not None][first:]
    for n in range(3):
        np.testing.assert_allclose(reported[n], run.own[first + n], atol=1e-12)
    assert np.abs(reported[3] - run.own[first + 3]).max() > 1e-4
    submaps = {r.reference_keyframe: run.map.keyframes.submap[r.reference_keyframe] for r in run.results[-8:]}
    assert len(run.reported.lagged(int(next(iter(submaps.values()))))) > 0


def test_what_is_lagged_is_what_was_in_the_sub_map_then() -> None:
    run = Run().many(12)
    run.map.keyframes.submap[1:] = 1
    run.many(12, start=12)
    assert [len(run.reported.lagged(submap)) for submap in (0, 1, 2)] == [12, 12, 0]
    run.map.keyframes.submap[1:] = 0  # merged, which the frames after it can tell of those shortly before
    run.add(24 * STEP_S, keyframe=1)
    assert [len(run.reported.lagged(submap)) for submap in (0, 1)] == [12 + 1 + PRIOR.lag, 12 - PRIOR.lag]


def test_an_image_that_repeats_the_one_before_counts_for_next_to_nothing() -> None:
    run, without = Run().many(20), Run().many(20)
    last = run.results[-1]
    repeated = replace(last, index=20, timestamp_s=20 * STEP_S, n_agreeing=0)
    run.reported.repeat(repeated, run.results)
    run.results.append(repeated)
    for each in (run, without):
        each.add(21 * STEP_S)
    apart_m = np.linalg.norm(run.results[-1].T_world_cam[:3, 3] - without.results[-1].T_world_cam[:3, 3])
    assert apart_m < 5e-4
    assert len(run.reported.lagged(0)) == 22


def test_without_a_prior_results_are_what_they_were() -> None:
    run, reported = Run().many(5), reported_poses(TrajectoryPriorConfig(), Run().map)
    assert isinstance(reported, OwnPoses)
    assert reported.at_once(run.results[4], run.results[:4]) is run.results[4]
    assert reported.lagged(0) is None
    reported.repeat(run.results[4], run.results)
