"""Points that a keyframe makes of its own depth."""

from dataclasses import replace

import numpy as np
import pytest
from small_world import SCALES, SmallWorld, pose

from stillroom.data.frame import Frame
from stillroom.data.map import Map
from stillroom.data.motion import Motion
from stillroom.data.result import Tracked, TrackingState
from stillroom.mapping.new_points import MIN_NEAREST, from_depth

POSE = pose(0.4, -0.2, 0.1, (0.1, -0.2, 0.05))
CLOSE_M = 3.0


def tracked_frame(frame: Frame, point_ids: np.ndarray | None = None) -> Tracked:
    ids = np.full(len(frame), -1, np.int32) if point_ids is None else point_ids
    return Tracked(frame, TrackingState.OK, POSE, ids, Motion.none(len(frame), 480, 640))


def made(frame: Frame, is_static: np.ndarray | None = None, first: bool = False) -> tuple[Map, np.ndarray, np.ndarray]:
    """Return the map after a keyframe (the second, unless `first`), its points' ids, and which keypoints made one."""
    world = Map(SCALES)
    if not first:
        blank, _ = SmallWorld.of(0, 0).look(POSE, depth_share=0.0)
        assert len(blank) == 0
        world.add_keyframe(blank, POSE, np.zeros(0, np.int32), blank.is_static, -1)
    static = frame.is_static if is_static is None else is_static
    tracked = tracked_frame(frame)
    keyframe = world.add_keyframe(frame, POSE, tracked.point_ids, static, -1 if first else 0)
    ids = from_depth(keyframe, tracked, CLOSE_M, world)
    return world, ids, world.points_of(keyframe) >= 0


@pytest.fixture
def view() -> tuple[SmallWorld, Frame, np.ndarray]:
    world = SmallWorld.of(0, 1800)
    return world, *world.look(POSE, depth_share=0.8)


def test_all_close_points_are_made_where_they_are(view: tuple[SmallWorld, Frame, np.ndarray]) -> None:
    world, frame, seen = view
    depth_m = frame.keypoints.depth_m
    close = (depth_m > 0) & (depth_m < CLOSE_M)
    assert close.sum() > MIN_NEAREST
    made_map, ids, is_made = made(frame)
    np.testing.assert_array_equal(is_made, close)
    numbers = seen[made_map.observations(ids)[1]]
    np.testing.assert_allclose(made_map.points.position_m[ids], world.points_m[numbers], atol=1e-4)
    # Near the left edge the right coordinate of a near point lies outside, and depth cannot be used as stereo.
    has_right = frame.keypoints.right_px[made_map.observations(ids)[1]] >= 0
    np.testing.assert_array_equal(made_map.points.n_observations[ids], np.where(has_right, 2, 1))
    np.testing.assert_array_equal(made_map.points.descriptors[ids], world.descriptors[numbers])
    assert np.all(made_map.points.first_keyframe[ids] == 1)


def test_the_first_keyframe_makes_all_it_can(view: tuple[SmallWorld, Frame, np.ndarray]) -> None:
    _, frame, _ = view
    is_static = np.random.default_rng(0).random(len(frame)) < 0.6
    _, _, is_made = made(frame, is_static, first=True)
    depth_m = frame.keypoints.depth_m
    assert np.count_nonzero(is_static & (depth_m > CLOSE_M)) > 20
    np.testing.assert_array_equal(is_made, is_static & (depth_m > 0))


def test_where_little_is_close_the_nearest_hundred_are_made() -> None:
    world = SmallWorld.of(1, 500, near_m=2.8, far_m=9.0)
    frame, _ = world.look(POSE, depth_share=0.8)
    depth_m = frame.keypoints.depth_m
    assert 0 < np.count_nonzero((depth_m > 0) & (depth_m < CLOSE_M)) < MIN_NEAREST
    _, ids, is_made = made(frame)
    assert len(ids) == MIN_NEAREST
    assert depth_m[is_made].max() < depth_m[~is_made & (depth_m > 0)].min()


def test_moving_keypoints_make_no_points_and_free_no_place_for_others(
    view: tuple[SmallWorld, Frame, np.ndarray],
) -> None:
    _, frame, _ = view
    is_static = np.random.default_rng(0).random(len(frame)) < 0.6
    _, _, is_made = made(frame, is_static)
    depth_m = frame.keypoints.depth_m
    expected = is_static & (depth_m > 0) & (depth_m < CLOSE_M)
    assert expected.sum() > MIN_NEAREST
    np.testing.assert_array_equal(is_made, expected)


def test_keypoints_that_see_a_point_make_no_second_one_but_count(
    view: tuple[SmallWorld, Frame, np.ndarray],
) -> None:
    _, frame, _ = view
    depth_m = frame.keypoints.depth_m
    far_m = np.where(depth_m > 0, depth_m + np.float32(10), depth_m)
    frame = replace(frame, keypoints=replace(frame.keypoints, depth_m=far_m))
    world, ids, is_made = made(frame)  # nothing is close: the nearest hundred
    point_ids = np.full(len(frame), -1, np.int32)
    point_ids[np.flatnonzero(is_made)[:30]] = world.points_of(1)[np.flatnonzero(is_made)[:30]]
    again = tracked_frame(frame, point_ids)
    keyframe = world.add_keyframe(frame, POSE, point_ids, frame.is_static, 1)
    new = from_depth(keyframe, again, CLOSE_M, world)
    assert (len(ids), len(new)) == (MIN_NEAREST, MIN_NEAREST - 30)
    np.testing.assert_array_equal(world.points_of(keyframe) >= 0, is_made)


def test_no_depth_no_points() -> None:
    frame, _ = SmallWorld.of(0, 100).look(POSE, depth_share=0.0)
    assert len(made(frame)[1]) == 0
