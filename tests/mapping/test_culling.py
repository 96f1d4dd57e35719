"""What leaves the map again."""

import numpy as np
import pytest
from small_world import SmallMap, SmallWorld, pose

from stillroom.data.map import Covisibility
from stillroom.data.sensor import Sensor
from stillroom.mapping.culling import TRIAL, Trial, count_redundant, cull_keyframes, cull_points

CLOSE_M = 3.0
ALONG = [pose(0.05 * k, 0.0, 0.02 * k) for k in range(6)]


def three_points() -> tuple[SmallMap, np.ndarray]:
    small = SmallMap.of(SmallWorld.of(0, 60), ALONG[:2])
    ids = small.map.points_of(0)[small.map.points_of(0) >= 0][:3]
    small.map.points.first_keyframe[ids] = 10
    small.map.points.n_observations[ids] = TRIAL.min_observations + 1
    return small, ids


@pytest.mark.parametrize(
    ("age", "n_observations", "n_found", "n_visible", "stays", "on_trial"),
    [
        (0, 2, 1, 1, True, True),
        (TRIAL.keyframes - 1, 2, 1, 4, True, True),
        (TRIAL.keyframes, 4, 1, 1, True, False),
        (TRIAL.keyframes, 3, 1, 1, False, False),
        (TRIAL.keyframes + 9, 3, 9, 9, False, False),
        (0, 9, 1, 5, False, False),
        (0, 9, 1, 4, True, True),
        (TRIAL.keyframes, 9, 10, 41, False, False),
    ],
)
def test_a_point_on_trial(
    age: int, n_observations: int, n_found: int, n_visible: int, stays: bool, on_trial: bool
) -> None:
    small, ids = three_points()
    points, one = small.map.points, ids[1]
    points.n_observations[one] = n_observations
    points.n_found[one], points.n_visible[one] = n_found, n_visible
    points.first_keyframe[ids] = 10
    left = cull_points(ids, 10 + age, small.map)
    assert points.is_alive[one] == stays
    assert (one in left) == on_trial
    assert points.is_alive[ids[[0, 2]]].all()
    assert (ids[0] in left) == (age < TRIAL.keyframes)
    if not stays:
        assert one not in small.map.keypoints.point


def test_points_that_are_gone_are_no_longer_on_trial() -> None:
    small, ids = three_points()
    small.map.remove_points(ids[:1])
    assert cull_points(ids, 11, small.map).tolist() == ids[1:].tolist()
    assert len(cull_points(ids[:0], 11, small.map)) == 0


def redundant_by_hand(small: SmallMap, keyframe: int) -> tuple[int, int]:
    """The close points of a keyframe, and those that three others see on a level at most one coarser."""
    world, n_close, n_redundant = small.map, 0, 0
    table = world.keypoints
    for row in range(world.rows(keyframe).start, world.rows(keyframe).stop):
        point = table.point[row]
        if point < 0 or not 0 < table.depth_m[row] <= CLOSE_M:
            continue
        n_close += 1
        others = world.observations(np.array([point]))[1]
        others = [o for o in others if o != row and table.octave[o] <= table.octave[row] + 1]
        n_redundant += len(others) >= 3
    return n_close, n_redundant


def counted(small: SmallMap, keyframe: int) -> tuple[int, int]:
    rows, table, points = small.map.rows(keyframe), small.map.keypoints, small.map.points
    columns = (table.depth_m, table.octave, points.is_alive)
    return count_redundant(rows.start, rows.stop, CLOSE_M, small.map.lists, *columns)


@pytest.mark.parametrize("seed", range(5))
def test_redundancy_is_counted_as_by_hand(seed: int) -> None:
    rng = np.random.default_rng(seed)
    small = SmallMap.of(SmallWorld.of(seed, 300), ALONG, depth_share=0.8)
    table = small.map.keypoints
    table.octave[:] = rng.integers(0, 4, len(table))
    small.map.remove_observations(np.flatnonzero(rng.random(len(table)) < 0.4))
    seen = 0
    for k in range(6):
        n_close, n_redundant = counted(small, k)
        assert (n_close, n_redundant) == redundant_by_hand(small, k)
        assert 0 <= n_redundant < n_close
        seen += n_redundant
    assert seen > 30


def test_keyframes_that_add_nothing_go_but_never_the_first_or_the_newest() -> None:
    small = SmallMap.of(SmallWorld.of(1, 300), [pose(0.002 * k) for k in range(6)])
    removed = cull_keyframes(5, CLOSE_M, small.map)
    # All see the same: a fourth view is too many, a third is not.
    assert removed
    assert not {0, 5} & set(removed)
    assert small.map.alive_keyframes().tolist() == sorted(set(range(6)) - set(removed))
    assert len(small.map.alive_keyframes()) == 3
    assert cull_keyframes(5, CLOSE_M, small.map) == []


def test_the_origin_stays_even_when_it_is_redundant() -> None:
    small = SmallMap.of(SmallWorld.of(1, 300), [pose(0.002 * k) for k in range(6)])
    n_close, n_redundant = counted(small, 0)
    assert n_redundant > 0.95 * n_close > 50
    small.map.covisibility = Covisibility()
    small.map.covisibility.connect(5, np.array([90, 0, 0, 0, 0, 0], np.int32))
    assert cull_keyframes(5, CLOSE_M, small.map) == []


def test_a_keyframe_goes_only_when_more_than_nine_tenths_are_redundant() -> None:
    for seen_by_it_alone, goes in ((0.09, True), (0.12, False)):
        small = SmallMap.of(SmallWorld.of(2, 400), [pose(0.002 * k) for k in range(5)])
        table, rows = small.map.keypoints, small.map.rows(2)
        close = rows.start + np.flatnonzero((table.depth_m[rows] <= CLOSE_M) & (table.point[rows] >= 0))
        alone = close[: round(seen_by_it_alone * len(close))]
        place, others = small.map.observations(table.point[alone])
        # Two of their five views go, and two others are left besides this one.
        gone = others[np.isin(table.keyframe[others], (0, 1))]
        small.map.remove_observations(gone)
        assert len(place) == 5 * len(alone)
        n_close, n_redundant = counted(small, 2)
        assert (n_redundant > 0.9 * n_close) == goes
        small.map.covisibility.connect(4, np.array([0, 0, 50, 0, 0], np.int32))  # asked about this one only
        assert cull_keyframes(4, CLOSE_M, small.map) == ([2] if goes else [])


def test_a_keyframe_without_close_points_stays() -> None:
    small = SmallMap.of(SmallWorld.of(3, 300, near_m=4.0), [pose(0.002 * k) for k in range(6)])
    assert cull_keyframes(5, CLOSE_M, small.map) == []


def test_a_trial_may_be_shorter_and_ask_for_fewer_views() -> None:
    small, ids = three_points()
    small.map.points.n_observations[ids] = (2, 3, 3)
    left = cull_points(ids, 12, small.map, Trial(keyframes=2, min_observations=2))
    assert small.map.points.is_alive[ids].tolist() == [False, True, True]
    assert len(left) == 0


def test_with_a_single_camera_all_points_of_a_keyframe_count() -> None:
    small = SmallMap.of(SmallWorld.of(1, 300, near_m=4.0), [pose(0.002 * k) for k in range(6)], depth_share=0.0)
    assert cull_keyframes(5, np.inf, small.map) == [], "no keypoint of a map in metres has a depth here"
    small.map.sensor = Sensor.MONOCULAR
    assert cull_keyframes(5, np.inf, small.map)
    assert len(small.map.alive_keyframes()) == 3
