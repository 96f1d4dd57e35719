"""The tracker's stages on a small world, and what the sieve is asked at each."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from building import parts
from small_world import SCALES, SmallMap, SmallWorld, no_semantics, pose

from stillroom.data.frame import Frame
from stillroom.data.map import Map
from stillroom.data.matches import Matches
from stillroom.data.motion import Motion, Stage
from stillroom.data.question import Question
from stillroom.data.result import Recovery, Tracked, TrackingState
from stillroom.geometry import se3
from stillroom.tracking.tracker import Tracker, TrackerConfig

WORLD = SmallWorld.of(0, 600)
NOBODY = no_semantics()


@dataclass
class Sieve:
    """Judges by a rule on keypoint numbers, and remembers what it was asked."""

    moves: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    asked: list[tuple[Stage, Matches]] = field(default_factory=list)

    def judge(self, question: Question) -> Motion:
        matches = question.matches
        assert len(np.unique(matches.point_id)) == len(np.unique(matches.keypoint)) == len(matches)
        self.asked.append((question.stage, matches))
        return Motion(~np.isin(np.arange(len(question.frame)), self.moves), Motion.none(0, 480, 640).moving)

    @property
    def stages(self) -> list[Stage]:
        return [stage for stage, _ in self.asked]


def started(sieve: Sieve | None = None, velocity: bool = True, **config: float) -> tuple[Tracker, SmallMap, Sieve]:
    """A tracker that has followed the camera through two keyframes (one without velocity)."""
    sieve = sieve or Sieve()
    small = SmallMap.of(WORLD, [np.eye(4), pose(0.02)] if velocity else [np.eye(4)])
    tracker = TrackerConfig(**config).build(parts(), sieve)
    for k in range(len(small.frames)):
        tracker.remember(small.tracked(k), small.map)
    return tracker, small, sieve


def look(T_world_cam: np.ndarray, **rest: float) -> tuple[Frame, np.ndarray]:
    return WORLD.look(T_world_cam, seed=77, index=5, **{"noise_px": 0.5, "flips": 20, **rest})


def check_pose(tracked: Tracked, T_world_cam: np.ndarray, within_m: float = 0.004) -> None:
    assert tracked.state is TrackingState.OK
    T_true_found = np.linalg.inv(T_world_cam) @ tracked.T_world_cam
    assert np.linalg.norm(T_true_found[:3, 3]) < within_m
    assert se3.angle_rad(T_true_found) < within_m / 2


def check_points(tracked: Tracked, small: SmallMap, seen: np.ndarray) -> None:
    matched = np.flatnonzero(tracked.is_matched)
    np.testing.assert_array_equal(small.number_of()[tracked.point_ids[matched]], seen[matched])


def test_the_motion_model_leads_and_the_local_map_follows() -> None:
    tracker, small, sieve = started()
    frame, seen = look(pose(0.04))
    tracked = tracker.track(frame, NOBODY, small.map)
    check_pose(tracked, pose(0.04))
    check_points(tracked, small, seen)
    assert tracked.n_inliers > 0.85 * np.isin(seen, np.flatnonzero(small.id_of >= 0)).sum()
    assert sieve.stages == [Stage.MOTION_MODEL, Stage.LOCAL_MAP]
    assert tracked.reference_keyframe in (0, 1)
    assert not tracked.recovered


def test_without_a_velocity_the_reference_keyframe_leads() -> None:
    tracker, small, sieve = started(velocity=False)
    frame, seen = look(pose(0.1, turn=(0, 0.1, 0)))
    tracked = tracker.track(frame, NOBODY, small.map)
    check_pose(tracked, pose(0.1, turn=(0, 0.1, 0)))
    check_points(tracked, small, seen)
    assert sieve.stages == [Stage.REFERENCE_KEYFRAME, Stage.LOCAL_MAP]


def test_a_jump_falls_back_from_the_motion_model_to_the_reference_keyframe() -> None:
    tracker, small, sieve = started()
    there = pose(0.15, turn=(0.05, 0.25, 0.02))
    frame, seen = look(there)
    tracked = tracker.track(frame, NOBODY, small.map)
    check_pose(tracked, there)
    check_points(tracked, small, seen)
    assert sieve.stages == [Stage.MOTION_MODEL] * 2 + [Stage.REFERENCE_KEYFRAME, Stage.LOCAL_MAP]
    assert len(sieve.asked[1][1]) >= len(sieve.asked[0][1]), "the second try looks in a wider window"


def test_what_looks_like_nothing_known_is_lost() -> None:
    tracker, small, _ = started()
    frame, _ = SmallWorld.of(9, 600).look(pose(0.04))
    tracked = tracker.track(frame, NOBODY, small.map)
    assert tracked.lost
    assert tracked.T_world_cam is None
    assert tracked.n_inliers == 0
    empty, _ = look(pose(50.0))
    assert len(empty) == 0
    assert tracker.track(empty, NOBODY, small.map).lost


def test_after_a_lost_frame_there_is_no_past_to_go_on_from() -> None:
    tracker, small, sieve = started()
    lost = tracker.track(SmallWorld.of(9, 600).look(pose())[0], NOBODY, small.map)
    tracker.remember(lost, small.map)
    sieve.asked.clear()
    assert tracker.track(look(pose(0.04))[0], NOBODY, small.map).lost
    assert sieve.asked == []
    # Found again, the camera has a place but no velocity.
    tracker.remember(replace(small.tracked(0), recovery=Recovery.PLACE), small.map)
    check_pose(tracker.track(look(pose(0.04))[0], NOBODY, small.map), pose(0.04))
    assert sieve.stages == [Stage.REFERENCE_KEYFRAME, Stage.LOCAL_MAP]


def test_matches_that_move_have_no_say() -> None:
    # A third of the keypoints drift together: without the sieve they would pull the camera along.
    frame, _ = look(pose(0.04), noise_px=0.3)
    moves = np.arange(0, len(frame), 3)
    px = frame.keypoints.px.copy()
    px[moves] += [4, 0]
    right_px = frame.keypoints.right_px.copy()
    right_px[moves] += 4
    frame = replace(frame, keypoints=replace(frame.keypoints, px=px, right_px=right_px))
    tracker, small, _ = started(Sieve(moves))
    tracked = tracker.track(frame, NOBODY, small.map)
    check_pose(tracked, pose(0.04))
    assert not tracked.is_matched[moves].any()
    assert not tracked.motion.is_static[moves].any()
    assert tracked.n_inliers > 150


def test_keypoints_that_the_first_sieve_took_out_are_not_matched() -> None:
    tracker, small, _ = started()
    frame, _ = look(pose(0.04))
    tracked = tracker.track(frame.with_static(np.arange(len(frame)) % 2 == 0), NOBODY, small.map)
    check_pose(tracked, pose(0.04))
    assert not tracked.is_matched[1::2].any()


def test_wrong_matches_are_told_apart() -> None:
    tracker, small, _ = started()
    frame, seen = look(pose(0.04))
    descriptors = frame.keypoints.descriptors.copy()
    swapped = np.arange(40)
    descriptors[swapped] = descriptors[np.roll(swapped, 1)]
    frame = replace(frame, keypoints=replace(frame.keypoints, descriptors=descriptors))
    tracked = tracker.track(frame, NOBODY, small.map)
    check_pose(tracked, pose(0.04))
    matched = np.flatnonzero(tracked.is_matched)
    wrong = small.number_of()[tracked.point_ids[matched]] != seen[matched]
    assert wrong.sum() < 3


def test_what_the_first_stage_refused_the_second_does_not_take_again() -> None:
    tracker, small, sieve = started()
    frame, seen = look(pose(0.04))
    px = frame.keypoints.px.copy()
    px[::8, 1] += 9  # within the window, beyond any chi-square
    frame = replace(frame, keypoints=replace(frame.keypoints, px=px, octave=np.zeros_like(frame.keypoints.octave)))
    small.map.points.max_distance_m[:] = np.linalg.norm(small.map.points.position_m, axis=1)
    small.frames[1] = replace(
        small.frames[1],
        keypoints=replace(small.frames[1].keypoints, octave=np.zeros_like(small.frames[1].keypoints.octave)),
    )
    tracker.remember(small.tracked(1), small.map)
    tracker.remember(replace(small.tracked(1), T_world_cam=pose(0.03)), small.map)
    check_pose(tracker.track(frame, NOBODY, small.map), pose(0.04))
    (_, first), (_, second) = sieve.asked
    displaced = small.id_of[seen[::8]]
    assert np.isin(displaced, first.point_id).sum() > 20
    assert not np.isin(displaced, second.point_id).any()


def test_a_keypoint_that_has_its_point_keeps_it() -> None:
    # The second keyframe made points of its own where the first one has some: twins, which match as well.
    small = SmallMap.of(WORLD, [np.eye(4)])
    known = np.flatnonzero(small.id_of >= 0)
    small.id_of[known[80:]] = -1
    small.add(pose(0.02))
    sieve = Sieve()
    tracker = TrackerConfig().build(parts(), sieve)
    for T_world_cam in (pose(0.0), pose(0.02)):
        tracker.remember(replace(small.tracked(1), T_world_cam=T_world_cam), small.map)
    tracked = tracker.track(look(pose(0.04))[0], NOBODY, small.map)
    check_pose(tracked, pose(0.04))
    first, second = (dict(zip(m.keypoint.tolist(), m.point_id.tolist(), strict=True)) for _, m in sieve.asked)
    kept = [second[keypoint] == point for keypoint, point in first.items() if keypoint in second]
    assert len(kept) > 150
    assert all(kept)


def test_points_that_mapping_joined_or_removed_are_followed_to_what_they_are_now() -> None:
    tracker, small, _ = started()
    in_both = np.intersect1d(small.map.points_of(0), small.map.points_of(1))
    in_both = in_both[in_both >= 0]
    world = small.map
    world.remove_points(in_both[:20])
    twins = world.points.append(20, position_m=world.points.position_m[in_both[20:40]])
    world.replace_points(in_both[20:40], np.arange(twins.start, twins.stop))
    world.refresh(np.arange(twins.start, twins.stop))
    tracked = tracker.track(look(pose(0.04))[0], NOBODY, world)
    check_pose(tracked, pose(0.04))
    ids = tracked.point_ids[tracked.is_matched]
    assert world.points.is_alive[ids].all()
    assert np.isin(np.arange(twins.start, twins.stop), ids).sum() > 15


@pytest.mark.parametrize(("n", "state"), [(201, TrackingState.OK), (199, TrackingState.NOT_INITIALIZED)])
def test_the_first_frame_needs_enough_static_depth(n: int, state: TrackingState) -> None:
    frame, _ = WORLD.look(pose())
    assert len(frame) > 260
    depth_m = frame.keypoints.depth_m.copy()
    depth_m[n + 50 :] = 0.0
    is_static = np.arange(len(frame)) >= 30  # 30 taken out by sieve 1, 20 more by sieve 2
    frame = replace(frame, keypoints=replace(frame.keypoints, depth_m=depth_m)).with_static(is_static)
    world = Map(SCALES)
    tracked = (
        TrackerConfig(min_initial_keypoints=200).build(parts(), Sieve(np.arange(30, 50))).track(frame, NOBODY, world)
    )
    assert tracked.state is state
    assert not tracked.lost
    assert tracked.n_inliers == 0
    if state is TrackingState.OK:
        np.testing.assert_array_equal(tracked.T_world_cam, np.eye(4))
        assert not tracked.motion.is_static[30:50].any()
    else:
        assert tracked.T_world_cam is None


def test_the_last_frame_moves_along_with_the_map() -> None:
    tracker, small, _ = started()
    move = se3.exp(np.array([0.4, -0.2, 0.1, 0.2, -0.3, 0.1]))
    keyframes = small.map.keyframes
    keyframes.T_world_cam[:] = move @ keyframes.T_world_cam
    small.map.points.position_m[:] = se3.transform(move, small.map.points.position_m)
    small.map.refresh_geometry(np.arange(len(small.map.points)))
    frame, seen = look(pose(0.04))
    tracked = tracker.track(frame, NOBODY, small.map)
    check_pose(tracked, move @ pose(0.04))
    check_points(tracked, small, seen)


def test_a_reference_keyframe_that_was_culled_with_its_parent_is_replaced_by_an_ancestor() -> None:
    small = SmallMap.of(WORLD, [pose(0.002 * k) for k in range(4)])
    tracker = TrackerConfig().build(parts(), Sieve())
    tracker.remember(small.tracked(3), small.map)
    for k in (3, 2):
        small.map.remove_keyframe(k)
    frame, seen = look(pose(0.01))
    tracked = tracker.track(frame, NOBODY, small.map)
    check_pose(tracked, pose(0.01))
    check_points(tracked, small, seen)
    assert tracked.reference_keyframe in (0, 1)


def test_points_count_how_often_they_were_found_where_they_should_be_visible() -> None:
    tracker, small, _ = started()
    frame, seen = look(pose(0.04))
    half = np.arange(len(frame)) % 2 == 0  # the others are hidden
    kp = type(frame.keypoints)(*(column[half] for column in frame.keypoints.__dict__.values()))
    frame = replace(frame, keypoints=kp, is_static=np.ones(len(kp), bool))
    tracked = tracker.track(frame, NOBODY, small.map)
    found = small.map.points.n_found - 1
    visible = small.map.points.n_visible - 1
    assert set(np.flatnonzero(found).tolist()) == set(tracked.point_ids[tracked.is_matched].tolist())
    assert found.max() == visible.max() == 1
    in_view = small.id_of[np.intersect1d(seen, np.flatnonzero(small.id_of >= 0))]
    assert visible[in_view].mean() > 0.97
    assert visible.sum() == pytest.approx(len(in_view), rel=0.03)
    assert found.sum() < 0.6 * visible.sum()


class TestLocate:
    def located(self, n_points: int, **config: int) -> Tracked:
        """A frame with so many known points at all, located from a pose a little off."""
        tracker, small, _ = started(**config)
        tracker.remember(replace(small.tracked(0), state=TrackingState.LOST, T_world_cam=None), small.map)
        frame, seen = look(pose(0.04))
        known = np.flatnonzero(small.id_of[seen] >= 0)[:n_points]
        kp = type(frame.keypoints)(*(column[known] for column in frame.keypoints.__dict__.values()))
        frame = replace(frame, keypoints=kp, is_static=np.ones(len(known), bool))
        guess = np.linalg.inv(pose(0.04) @ se3.exp(np.full(6, 0.003)))
        point_ids = np.where(np.arange(len(known)) < 25, small.id_of[seen[known]], -1).astype(np.int32)
        return tracker.locate(frame, guess, point_ids, NOBODY, small.map, Recovery.PLACE)

    def test_a_pose_found_by_other_means_is_refined(self) -> None:
        tracked = self.located(200)
        check_pose(tracked, pose(0.04))
        assert tracked.recovered
        assert tracked.n_inliers > 150

    def test_a_recovered_pose_needs_more_inliers_than_a_followed_one(self) -> None:
        assert not self.located(60, min_inliers=10, min_inliers_recovered=45).lost
        too_few = self.located(60, min_inliers=10, min_inliers_recovered=61)
        assert too_few.lost
        assert not too_few.recovered
        assert too_few.T_world_cam is None


def test_for_a_second_after_recovery_more_inliers_are_needed() -> None:
    tracker, small, _ = started(min_inliers=30, min_inliers_recovered=80)
    frame, _ = look(pose(0.04))
    kp = type(frame.keypoints)(*(column[:60] for column in frame.keypoints.__dict__.values()))
    sparse = replace(frame, keypoints=kp, is_static=np.ones(60, bool))
    assert not tracker.track(sparse, NOBODY, small.map).lost
    tracker.remember(replace(small.tracked(1), recovery=Recovery.PLACE), small.map)
    for _ in range(30):
        assert tracker.track(sparse, NOBODY, small.map).lost
        tracker.remember(small.tracked(1), small.map)
    assert tracker.track(sparse, NOBODY, small.map).n_inliers >= 30
