"""What the map derives from its observations: typical descriptors, viewing geometry, shared points, poses."""

import numpy as np
import pytest
from plain_search import bits_between
from small_world import SCALES, SmallMap, SmallWorld, pose

from stillroom.data.map import Map
from stillroom.data.map.links import MAX_DESCRIPTORS, kth_smallest
from stillroom.geometry import se3

POSES = [pose(0.1 * k, 0.02 * k, 0.15 * k, (0.01 * k, -0.02 * k, 0.0)) for k in range(7)]


@pytest.fixture
def small() -> SmallMap:
    return SmallMap.of(SmallWorld.of(1, 250), POSES, flips=30, noise_px=0.5, depth_share=0.7)


def least_median_row(rows: np.ndarray, descriptors: np.ndarray) -> np.ndarray:
    """Rows whose descriptor has the least median distance to all, itself included: several where equal."""
    bits = np.sort(bits_between(descriptors[rows], descriptors[rows]), axis=1)
    median = bits[:, (len(rows) - 1) // 2]
    return rows[median == median.min()]


def test_the_typical_descriptor_has_the_least_median_distance(small: SmallMap) -> None:
    world = small.map
    table, several = world.keypoints, 0
    for point in np.flatnonzero(world.points.n_keyframes > 0):
        rows = world.observations(np.array([point]))[1]
        best = table.descriptors[least_median_row(rows, table.descriptors)]
        own = world.points.descriptors[point]
        assert (best == own).all(axis=1).any() if len(rows) >= 3 else (own == table.descriptors[rows[0]]).all()
        several += len(rows) >= 3
    assert several > 100


def test_the_typical_descriptor_is_no_outlier() -> None:
    small = SmallMap.of(SmallWorld.of(2, 50), POSES[:5], flips=5)
    point = int(np.argmax(small.map.points.n_keyframes))
    rows = small.map.observations(np.array([point]))[1]
    assert len(rows) == 5
    small.map.keypoints.descriptors[rows[0]] ^= 255
    small.map.refresh(np.array([point]))
    assert not np.array_equal(small.map.points.descriptors[point], small.map.keypoints.descriptors[rows[0]])


def test_only_the_newest_descriptors_of_an_old_point_count() -> None:
    small = SmallMap.of(SmallWorld.of(3, 30), [pose(0.001 * k) for k in range(MAX_DESCRIPTORS + 5)], flips=20)
    point = int(np.argmax(small.map.points.n_keyframes))
    rows = small.map.observations(np.array([point]))[1]
    assert len(rows) == MAX_DESCRIPTORS + 5
    newest = rows[:MAX_DESCRIPTORS]
    best = small.map.keypoints.descriptors[least_median_row(newest, small.map.keypoints.descriptors)]
    assert (best == small.map.points.descriptors[point]).all(axis=1).any()


def test_viewing_geometry_is_the_mean_direction_and_the_oldest_scale(small: SmallMap) -> None:
    world = small.map
    points, table = world.points, world.keypoints
    points.position_m[:] += np.random.default_rng(0).normal(0, 0.05, points.position_m.shape)
    world.refresh_geometry(np.arange(len(points)))
    for point in range(len(points)):
        rows = world.observations(np.array([point]))[1]
        away = points.position_m[point] - world.keyframes.T_world_cam[table.keyframe[rows], :3, 3]
        distance_m = np.linalg.norm(away, axis=1)
        mean = (away / distance_m[:, None]).mean(axis=0)
        np.testing.assert_allclose(points.normal[point], mean / np.linalg.norm(mean), atol=1e-9)
        oldest = np.argmin(table.keyframe[rows])
        largest = distance_m[oldest] * SCALES.factors[table.octave[rows[oldest]]]
        assert points.max_distance_m[point] == pytest.approx(largest)
        assert points.min_distance_m[point] == pytest.approx(largest / SCALES.factors[-1])


def test_refreshing_what_nothing_sees_changes_nothing(small: SmallMap) -> None:
    ids = np.array([3, 4])
    small.map.remove_points(ids)
    before = small.map.points.descriptors[ids].copy(), small.map.points.normal[ids].copy()
    small.map.refresh(ids)
    np.testing.assert_array_equal(small.map.points.descriptors[ids], before[0])
    np.testing.assert_array_equal(small.map.points.normal[ids], before[1])


def test_covisibility_counts_shared_points(small: SmallMap) -> None:
    world = small.map
    sets = [set(world.points_of(k)[world.points_of(k) >= 0].tolist()) for k in range(len(POSES))]
    for a in range(len(POSES)):
        world.connect(a)
        shared = {b: len(sets[a] & sets[b]) for b in range(len(POSES)) if b != a}
        assert {b: world.covisibility.weight(a, b) for b in shared} == shared
        assert min(shared.values()) >= world.covisibility.min_weight
        assert world.covisibility.neighbours(a) == sorted(shared, key=lambda b: (-shared[b], -b))


def test_frames_on_culled_keyframes_move_with_the_ancestor_that_is_left(small: SmallMap) -> None:
    world = small.map
    for k in (3, 2, 5):  # a child first, then its parent; and one with a parent that stays
        world.remove_keyframe(k)
    for k in range(7):
        np.testing.assert_allclose(world.keyframe_pose(k), POSES[k], atol=1e-12)
    assert world.alive_keyframes().tolist() == [0, 1, 4, 6]
    moves = {1: se3.exp(np.array([0.3, 0, 0.1, 0.2, 0, 0])), 4: se3.exp(np.array([0, -0.5, 0, 0, 0.1, 0.4]))}
    for k, move in moves.items():
        world.keyframes.T_world_cam[k] = POSES[k] @ move
    ancestor = {3: 1, 2: 1, 5: 4}
    for k in range(7):
        above = ancestor.get(k, k)
        T_above_cam = np.linalg.inv(POSES[above]) @ POSES[k]
        expected = POSES[above] @ moves.get(above, np.eye(4)) @ T_above_cam
        np.testing.assert_allclose(world.keyframe_pose(k), expected, atol=1e-9)


def test_a_culled_keyframe_is_placed_where_its_moved_parent_has_it(small: SmallMap) -> None:
    world = small.map
    world.remove_keyframe(2)
    world.keyframes.T_world_cam[1] = pose(5.0)
    world.remove_keyframe(3)  # hangs on 2, which is culled and hangs on 1, which has moved
    np.testing.assert_allclose(world.keyframe_pose(3), POSES[3], atol=1e-9)
    assert (world.points_of(3) == -1).all()
    assert 3 not in world.covisibility.neighbours(4)


def test_an_empty_map_answers_all_questions() -> None:
    world = Map(SCALES)
    none = np.zeros(0, np.int32)
    assert len(world.alive_keyframes()) == 0
    assert len(world.count_shared(none)) == 0
    assert len(world.current_ids(none)) == 0
    assert len(world.observations(none)[0]) == 0
    assert len(world.points_seen_by(np.array([]))) == 0
    assert len(world.add_points(np.zeros((0, 3)), none)) == 0
    world.remove_points(none)
    world.remove_observations(none)


def test_a_place_in_the_order_is_that_of_sorted_values() -> None:
    rng, scratch = np.random.default_rng(0), np.empty(20, dtype=np.int32)
    for n in range(1, 21):
        values = rng.integers(0, 12, 20).astype(np.int32)
        for k in range(n):
            assert kth_smallest(values, n, k, scratch) == np.sort(values[:n])[k]
