"""Frames fitted once more to a finished map, on a small world whose poses are known."""

from dataclasses import replace

import numpy as np
import pytest
from building import parts
from small_world import CAMERA, SmallMap, SmallWorld, pose

from stillroom.data.motion import Motion
from stillroom.data.result import FrameSummary, Tracked, TrackingState
from stillroom.dynamics.chain import KeepAllMatches
from stillroom.geometry import se3
from stillroom.geometry.align import align
from stillroom.geometry.camera import Camera
from stillroom.optimize.trajectory_prior import TrajectoryPriorConfig
from stillroom.tracking.last_look import LastLook, LastLookConfig, NoLastLook
from stillroom.tracking.shutter import ROLLING
from stillroom.tracking.tracker import TrackerConfig

WORLD = SmallWorld.of(0, 500)
ROLLING_CAMERA = replace(CAMERA, readout_s=0.03)
STEP_S = 1 / 30
SPEED = np.array([0.2, -0.1, 0.15, 0.3, -0.4, 0.2])
"""Of the camera, T_cam_world: it moves by exp(t · SPEED)."""


def at(time_s: float) -> np.ndarray:
    """T_world_cam of a camera that moves steadily."""
    return se3.inverse(se3.exp(time_s * SPEED))


class Run:
    """A run of a few frames over a map with three keyframes, in which every pose went wrong by a centimetre."""

    def __init__(
        self, n: int = 8, camera: Camera = CAMERA, noise_px: float = 0.0, prior: bool = False, **config: int
    ) -> None:
        self.small = SmallMap.of(WORLD, [at(time_s) for time_s in (0.0, 0.4, 0.8)])
        given = parts(camera, self.small.map)
        tracker = TrackerConfig(shutter=ROLLING).build(given, KeepAllMatches())
        self.look = LastLookConfig(enabled=True, **config).build(given, tracker, TrajectoryPriorConfig(enabled=prior))
        assert isinstance(self.look, LastLook)
        self.camera, self.noise_px = camera, noise_px
        self.results: list[FrameSummary] = []
        for k in range(n):
            self.add(k)

    def add(self, k: int, p_static: np.ndarray | None = None, n_matches: int | None = None) -> None:
        tracked = self.tracked(k)
        ids = tracked.point_ids.copy()
        ids[len(ids) if n_matches is None else n_matches :] = -1
        self.look.keep(replace(tracked, point_ids=ids, motion=replace(tracked.motion, p_static=p_static)))
        wrong = tracked.T_world_cam @ pose(0.01 * (-1) ** k, 0.005)
        in_first = se3.inverse(self.small.map.keyframe_pose(0)) @ wrong
        self.results.append(
            FrameSummary(k, k * STEP_S, TrackingState.OK, wrong, 500, 500, 400, 2, False, 0, in_first, n_agreeing=400)
        )

    def tracked(self, k: int) -> Tracked:
        T_world_cam = at(k * STEP_S)
        frame, seen = WORLD.look(T_world_cam, seed=50 + k, noise_px=self.noise_px, index=k)
        kp = frame.keypoints
        if self.camera.readout_s:
            px = kp.px.astype(np.float64)
            for _ in range(5):
                after_s = self.camera.rows_after_s(px[:, 1])
                T = [se3.exp(t * SPEED) @ se3.inverse(T_world_cam) for t in after_s]
                x = [se3.transform(p, m[None])[0] for p, m in zip(T, WORLD.points_m[seen], strict=True)]
                px = CAMERA.project(np.array(x))
            raw_px = px.astype(np.float32)
            kp = replace(kp, raw_px=raw_px)  # `px` are where tracking has moved them
        frame = replace(frame, camera=self.camera, keypoints=kp)
        motion = Motion.none(len(frame), CAMERA.height, CAMERA.width)
        return Tracked(frame, TrackingState.OK, T_world_cam, self.small.id_of[seen].astype(np.int32), motion, 0)

    def again(self) -> list[FrameSummary]:
        return self.look.again(self.results)

    def errors_m(self, results: list[FrameSummary]) -> np.ndarray:
        world = self.small.map
        poses = [world.keyframe_pose(r.reference_keyframe) @ r.T_reference_cam for r in results]
        return np.array(
            [np.linalg.norm(T[:3, 3] - at(r.timestamp_s)[:3, 3]) for T, r in zip(poses, results, strict=True)]
        )


@pytest.mark.parametrize("camera", [CAMERA, ROLLING_CAMERA], ids=["global", "rolling"])
def test_every_frame_comes_to_its_place_in_the_finished_map(camera: Camera) -> None:
    run = Run(camera=camera)
    assert run.errors_m(run.results).min() > 0.009
    looked = run.again()
    assert run.errors_m(looked).max() < 1e-3
    assert run.look.n_improved == len(looked) == 8
    assert [r.T_world_cam for r in looked] == [r.T_world_cam for r in run.results]  # what was known then
    assert all(after.n_agreeing_finally == after.n_looked > 150 for after in looked)
    # The lagged trajectory weighs poses by what was known then.
    assert [r.n_agreeing for r in looked] == [r.n_agreeing for r in run.results]


def test_points_are_followed_to_where_they_are_now() -> None:
    run = Run()
    world = run.small.map
    first, second = (np.flatnonzero(world.points.is_alive)[k : k + 60 : 2] for k in (0, 1))
    world.points.position_m[first] += 1.0  # nonsense, which joining the points ends
    world.replace_points(first, second)
    world.remove_points(np.flatnonzero(world.points.is_alive)[100:120])
    world.points.position_m[~world.points.is_alive] = np.nan
    looked = run.again()
    assert run.errors_m(looked).max() < 2e-3
    assert run.errors_m(looked).max() < 0.2 * run.errors_m(run.results).min()


def test_a_frame_that_too_few_points_place_keeps_its_pose() -> None:
    run = Run(n=3)
    run.add(3, n_matches=20)
    looked = run.again()
    assert looked[3] is run.results[3]
    assert run.look.n_improved == 3


def test_lost_frames_are_left_alone_and_frames_after_them_are_not_mixed_up() -> None:
    run = Run(n=3)
    lost = replace(run.tracked(3), state=TrackingState.LOST, T_world_cam=None)
    run.look.keep(lost)
    run.results.append(
        replace(run.results[2], index=3, state=TrackingState.LOST, T_world_cam=None, T_reference_cam=None)
    )
    run.add(4)
    looked = run.again()
    assert looked[3] is run.results[3]
    assert run.errors_m([*looked[:3], looked[4]]).max() < 5e-4


def test_an_image_that_repeats_the_one_before_gets_its_pose() -> None:
    run = Run(n=4)
    run.look.repeat()
    run.results.append(replace(run.results[3], index=4, timestamp_s=run.results[3].timestamp_s + 0.01, n_agreeing=0))
    looked = run.again()
    np.testing.assert_array_equal(looked[4].T_reference_cam, looked[3].T_reference_cam)
    assert looked[4].n_agreeing_finally == 0
    assert not np.allclose(looked[3].T_reference_cam, run.results[3].T_reference_cam, atol=1e-3)


def test_of_a_long_run_the_newest_frames_are_looked_at() -> None:
    run = Run(n=8, most_frames=5)
    looked = run.again()
    assert (run.look.n_forgotten, run.look.n_improved) == (3, 5)
    assert all(looked[k] is run.results[k] for k in range(3))
    assert run.errors_m(looked[3:]).max() < 5e-4
    kept = run.look._sights
    assert len(kept) == 5
    assert sum(column.nbytes for column in kept[0] if column is not None) <= 20 * len(kept[0].px)


def test_what_is_improbably_static_counts_less() -> None:
    """A third of the points have moved; the sieve says of each how sure it is."""
    errors = []
    for told in (False, True):
        run = Run(n=0, looks=1)
        moved = np.arange(0, len(WORLD.points_m), 3)
        run.small.map.points.position_m[run.small.id_of[moved][run.small.id_of[moved] >= 0]] += [0.004, 0.0, 0.0]
        for k in range(4):
            ids = run.tracked(k).point_ids
            p_static = np.where(np.isin(ids, run.small.id_of[moved]), 0.02, 1.0).astype(np.float32)
            run.add(k, p_static=p_static if told else None)
        errors.append(run.errors_m(run.again()).max())
    assert errors[1] < 0.2 * errors[0]


def test_points_that_all_frames_place_are_better_than_those_of_a_few_keyframes() -> None:
    """Noise on the map's points bends the path; thirty frames that see them bend it back."""
    errors = []
    for looks in (1, 2):
        run = Run(n=30, noise_px=0.3, prior=True, looks=looks)
        alive = np.flatnonzero(run.small.map.points.is_alive)
        run.small.map.points.position_m[alive] += np.random.default_rng(0).normal(0, 0.02, (len(alive), 3))
        before_m = run.small.map.points.position_m.copy()
        found_m = np.array([result.T_reference_cam[:3, 3] for result in run.again()])
        true_m = np.array([at(result.timestamp_s)[:3, 3] for result in run.results])
        off_m = align(found_m, true_m, with_scale=False).points(found_m) - true_m
        errors.append(np.sqrt((off_m**2).sum(axis=1).mean()))
        np.testing.assert_array_equal(run.small.map.points.position_m, before_m)  # the map keeps its own
    assert errors[1] < 0.6 * errors[0]


def test_without_it_nothing_is_kept_or_changed() -> None:
    run = Run(n=2)
    given = parts(CAMERA, run.small.map)
    off = LastLookConfig().build(given, TrackerConfig().build(given, KeepAllMatches()), TrajectoryPriorConfig())
    assert isinstance(off, NoLastLook)
    off.keep(run.tracked(0))
    off.repeat()
    assert all(a is b for a, b in zip(off.again(run.results), run.results, strict=True))
