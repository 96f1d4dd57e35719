"""When a frame becomes a keyframe: each rule by itself."""

from dataclasses import replace

import numpy as np
import pytest
from small_world import CAMERA, SCALES, SmallMap, SmallWorld, pose

from stillroom.data.map import Map
from stillroom.data.motion import Motion
from stillroom.data.result import Recovery, Tracked, TrackingState
from stillroom.tracking.keyframe_policy import KeyframePolicy, KeyframePolicyConfig

CONFIG = KeyframePolicyConfig(min_gap=2, quiet_after_recovery=5, share=0.6, min_inliers=15)
CLOSE_M = CONFIG.th_depth * CAMERA.baseline_m
SMALL = SmallMap.of(SmallWorld.of(0, 900, near_m=1.2), [np.eye(4)])
N_REFERENCE = int((SMALL.map.points_of(0) >= 0).sum())


def frame_with(
    n_inliers: int, tracked_close: int = 200, untracked_close: int = 0, state: TrackingState = TrackingState.OK
) -> Tracked:
    """A frame that tracks `n_inliers` points, with so many close keypoints that are tracked and that are not."""
    tracked = SMALL.tracked(0)
    n = len(tracked.frame)
    assert n_inliers + untracked_close <= n
    is_matched = np.arange(n) < n_inliers
    depth_m = np.full(n, CLOSE_M * 1.01, np.float32)
    depth_m[: min(tracked_close, n_inliers)] = CLOSE_M * 0.99
    depth_m[n_inliers : n_inliers + untracked_close] = CLOSE_M * 0.99
    point_ids = np.where(is_matched, np.arange(n), -1).astype(np.int32)
    frame = replace(tracked.frame, keypoints=replace(tracked.frame.keypoints, depth_m=depth_m))
    pose_or_none = tracked.T_world_cam if state is TrackingState.OK else None
    return replace(tracked, frame=frame, point_ids=point_ids, state=state, T_world_cam=pose_or_none)


FEW = int(0.6 * N_REFERENCE) - 1
ENOUGH = int(0.6 * N_REFERENCE) + 2


def after_a_pause(frames: int = 5, config: KeyframePolicyConfig = CONFIG) -> KeyframePolicy:
    """A policy that has seen some frames which gave no reason for a keyframe."""
    policy = config.build()
    for _ in range(frames):
        assert not policy.wants(frame_with(ENOUGH), SMALL.map)
    return policy


def test_the_first_frame_with_a_pose_is_wanted_and_others_are_not() -> None:
    empty = Map(SCALES)
    policy = CONFIG.build()
    for state in (TrackingState.NOT_INITIALIZED, TrackingState.LOST):
        assert not policy.wants(frame_with(0, state=state), empty)
    assert policy.wants(frame_with(0), empty)


def test_a_lost_frame_is_never_wanted() -> None:
    assert not after_a_pause().wants(frame_with(FEW, state=TrackingState.LOST), SMALL.map)
    assert after_a_pause().wants(frame_with(FEW), SMALL.map)


def test_wanted_when_too_little_of_the_reference_is_tracked() -> None:
    assert N_REFERENCE > 400
    assert after_a_pause().wants(frame_with(FEW), SMALL.map)
    assert not after_a_pause().wants(frame_with(ENOUGH), SMALL.map)
    fussy = replace(CONFIG, share=0.9)
    assert after_a_pause(0, fussy).wants(frame_with(ENOUGH), SMALL.map) is False  # not yet: the gap
    policy = fussy.build()
    policy.wants(frame_with(N_REFERENCE), SMALL.map)
    assert policy.wants(frame_with(ENOUGH), SMALL.map)


def test_the_share_counts_points_of_the_reference_keyframe() -> None:
    small = SmallMap.of(SmallWorld.of(0, 900, near_m=1.2), [np.eye(4), pose(0.05), pose(0.1)])
    rows = small.map.rows(1)
    small.map.remove_observations(np.arange(rows.start, rows.stop)[: 3 * (rows.stop - rows.start) // 4])
    frame = frame_with(int(0.4 * N_REFERENCE))
    policy = after_a_pause()
    assert not policy.wants(replace(frame, reference_keyframe=1), small.map)
    assert policy.wants(replace(frame, reference_keyframe=0), small.map)


def test_keyframes_keep_their_distance() -> None:
    policy = replace(CONFIG, min_gap=3).build()
    decisions = [policy.wants(frame_with(FEW), SMALL.map) for _ in range(9)]
    assert decisions == [False, False, True] * 3


def test_when_close_points_are_needed_the_next_frame_will_do() -> None:
    policy = replace(CONFIG, min_gap=3).build()
    needy = frame_with(ENOUGH, tracked_close=99, untracked_close=71)
    assert [policy.wants(needy, SMALL.map) for _ in range(3)] == [True, True, True]


@pytest.mark.parametrize(("tracked", "untracked", "wanted"), [(99, 71, True), (100, 71, False), (99, 70, False)])
def test_close_points_are_needed_when_few_are_tracked_and_many_are_not(
    tracked: int, untracked: int, wanted: bool
) -> None:
    assert after_a_pause().wants(frame_with(ENOUGH, tracked, untracked), SMALL.map) == wanted


def test_close_points_on_what_moves_do_not_count() -> None:
    needy = frame_with(ENOUGH, tracked_close=99, untracked_close=71)
    untracked = np.flatnonzero(~needy.is_matched)[:1]
    is_static = np.ones(len(needy.frame), bool)
    is_static[untracked] = False
    moving = replace(needy, motion=Motion(is_static, needy.motion.moving))
    assert not after_a_pause().wants(moving, SMALL.map)
    sieved = replace(needy, frame=needy.frame.with_static(is_static))
    assert not after_a_pause().wants(sieved, SMALL.map)


def test_a_close_keypoint_without_depth_is_none() -> None:
    needy = frame_with(ENOUGH, tracked_close=99, untracked_close=71)
    depth_m = needy.frame.keypoints.depth_m.copy()
    depth_m[np.flatnonzero(~needy.is_matched)[0]] = 0.0
    frame = replace(needy.frame, keypoints=replace(needy.frame.keypoints, depth_m=depth_m))
    assert not after_a_pause().wants(replace(needy, frame=frame), SMALL.map)


@pytest.mark.parametrize(("n_inliers", "wanted"), [(15, False), (16, True)])
def test_a_weak_pose_is_no_ground_to_build_on(n_inliers: int, wanted: bool) -> None:
    assert after_a_pause().wants(frame_with(n_inliers, 0, 300), SMALL.map) == wanted


def test_after_a_recovery_a_large_map_waits_and_a_small_one_does_not() -> None:
    large = SmallMap.of(SmallWorld.of(0, 900, near_m=1.2), [pose(0.01 * k) for k in range(6)])
    recovered = replace(frame_with(FEW), recovery=Recovery.PLACE)
    for small, expected in ((large, [False] * 5 + [True]), (SMALL, [True, False, True, False, True, False])):
        policy = after_a_pause()
        answers = [policy.wants(recovered, small.map)]
        answers += [policy.wants(frame_with(FEW), small.map) for _ in range(5)]
        assert answers == expected
