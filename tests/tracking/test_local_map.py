"""The part of the map around the camera, against the rule written plainly."""

import numpy as np
import pytest
from small_world import SCALES, SmallMap, SmallWorld, pose

from stillroom.data.map import Map
from stillroom.tracking.tracker import MAX_KEYFRAMES, LocalMap, local_map_of


def along_a_wall(n: int) -> SmallMap:
    """Keyframes that walk past a long wall of points: each shares points with the next few only."""
    rng = np.random.default_rng(0)
    world = SmallWorld.of(0, 3000)
    world.points_m[:] = rng.uniform([-1, -1, 2.5], [n + 1, 1, 3.0], (3000, 3))
    return SmallMap.of(world, [pose(float(k)) for k in range(n)])


def select_plainly(point_ids: np.ndarray, small: SmallMap, most: int) -> tuple[int, set[int], set[int]]:
    """Voters by votes, then of each voter's ten strongest neighbours the first that is new."""
    world = small.map
    sees = {k: set(world.points_of(k)[world.points_of(k) >= 0].tolist()) for k in range(len(world.keyframes))}
    wanted = set(point_ids[point_ids >= 0].tolist())
    votes = {k: len(wanted & points) for k, points in sees.items() if wanted & points}
    chosen = sorted(votes, key=lambda k: (-votes[k], k))[:most]
    for voter in list(chosen):
        if len(chosen) < most:
            chosen += [k for k in world.covisibility.neighbours(voter, 10) if k not in chosen][:1]
    return chosen[0], set(chosen), set().union(*(sees[k] for k in chosen))


def check(found: LocalMap, expected: tuple[int, set[int], set[int]]) -> None:
    reference, keyframes, points = expected
    assert found.reference == reference
    assert set(found.keyframes) == keyframes
    assert len(found.keyframes) == len(keyframes)
    assert found.points.tolist() == sorted(points)


@pytest.mark.parametrize("seen_by", range(0, 14, 3))
def test_the_local_map_is_that_of_the_plain_rule(seen_by: int) -> None:
    small = along_a_wall(14)
    for k in range(14):
        small.map.connect(k)
    rng = np.random.default_rng(seen_by)
    point_ids = small.map.points_of(seen_by).copy()
    point_ids[rng.random(len(point_ids)) < 0.7] = -1
    expected = select_plainly(point_ids, small, MAX_KEYFRAMES)
    assert 1 < len(expected[1]) < 14
    check(local_map_of(point_ids, 0, small.map), expected)


def test_no_more_than_eighty_keyframes_are_chosen() -> None:
    small = SmallMap.of(SmallWorld.of(0, 60), [pose(0.001 * k) for k in range(MAX_KEYFRAMES + 6)])
    rng = np.random.default_rng(0)
    rows = np.flatnonzero(rng.random(len(small.map.keypoints)) < 0.3)  # so that votes differ
    small.map.remove_observations(rows)
    point_ids = small.map.points_of(3).copy()
    found = local_map_of(point_ids, 0, small.map)
    assert len(found.keyframes) == MAX_KEYFRAMES
    check(found, select_plainly(point_ids, small, MAX_KEYFRAMES))
    assert found.keyframes[0] == found.reference


def test_without_any_vote_the_fallback_is_the_reference() -> None:
    small = along_a_wall(8)
    nothing = np.full(10, -1, np.int32)
    found = local_map_of(nothing, 5, small.map)
    assert found.reference == 5
    first_neighbour = small.map.covisibility.neighbours(5, 1)
    assert found.keyframes == (5, *first_neighbour)
    assert found.points.tolist() == small.map.points_seen_by(np.array(found.keyframes)).tolist()


def test_a_lone_first_keyframe_is_its_own_local_map() -> None:
    world = Map(SCALES)
    small = SmallMap(SmallWorld.of(0, 80), world)
    small.add(np.eye(4))
    found = local_map_of(world.points_of(0), 0, world)
    assert (found.reference, found.keyframes) == (0, (0,))
    assert len(found.points) == len(world.points)
