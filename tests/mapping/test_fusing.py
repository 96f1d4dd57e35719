"""Points that are one are joined, and keyframes see what they should."""

from dataclasses import replace

import numpy as np
import pytest
from small_world import CAMERA, SmallMap, SmallWorld, pose

from stillroom.mapping.fusing import fuse, fuse_neighbourhood, neighbourhood

SECOND = pose(0.15, 0.02, 0.1, (0.01, -0.02, 0.02))
N_KNOWN = 80


def with_duplicates(**look: float) -> tuple[SmallMap, np.ndarray]:
    """Two keyframes that share 80 points and have made the others twice; return also the first ones' ids (P,)."""
    small = SmallMap.of(SmallWorld.of(4, 350), [np.eye(4)], **look)
    first_ids = small.id_of.copy()
    known = np.flatnonzero(first_ids >= 0)
    small.id_of[known[N_KNOWN:]] = -1
    small.add(SECOND, **look)
    return small, first_ids


def points_of_world(small: SmallMap, keyframe: int) -> dict[int, int]:
    """Point of the world → id of the map's point that the keyframe sees there."""
    ids = small.map.points_of(keyframe)
    return {int(p): int(i) for p, i in zip(small.seen[keyframe], ids, strict=True) if i >= 0}


@pytest.mark.parametrize("look", [{}, {"noise_px": 0.5, "flips": 10}, {"depth_share": 0.5}])
def test_duplicates_become_one_point_that_both_see(look: dict[str, float]) -> None:
    small, _ = with_duplicates(**look)
    both = np.intersect1d(*small.seen)
    n_before = small.map.points.is_alive.sum()
    fuse_neighbourhood(1, CAMERA, small.map)
    first, second = points_of_world(small, 0), points_of_world(small, 1)
    joined = [p for p in both.tolist() if first.get(p) == second.get(p, -2)]
    assert len(joined) > 0.93 * len(both)
    assert small.map.points.is_alive.sum() < n_before - 0.8 * (len(both) - N_KNOWN)
    for p in joined:
        point = first[p]
        assert small.map.points.is_alive[point]
        assert small.map.points.n_keyframes[point] == 2
        np.testing.assert_allclose(small.map.points.position_m[point], small.world.points_m[p], atol=1e-4)
    # Nothing was joined that is not one: a keyframe sees every point of the map at one place of the world.
    number = {}
    for k in (0, 1):
        for p, i in points_of_world(small, k).items():
            assert number.setdefault(i, p) == p
    assert small.map.covisibility.weight(0, 1) >= 0.93 * len(both)


def test_in_images_of_twice_the_size_the_same_points_are_joined() -> None:
    small, large = with_duplicates()[0], with_duplicates()[0]
    camera, world = CAMERA, large.map
    for name in ("width", "height", "fx", "fy", "cx", "cy", "bf"):
        camera = replace(camera, **{name: 2 * getattr(camera, name)})
    world.scales = replace(world.scales, finest_px=2.0)
    world.keypoints.px[:] *= 2.0
    world.keypoints.right_px[world.keypoints.right_px >= 0] *= 2.0
    fuse_neighbourhood(1, CAMERA, small.map)
    fuse_neighbourhood(1, camera, world)
    for k in (0, 1):
        np.testing.assert_array_equal(world.points_of(k), small.map.points_of(k))


def test_the_point_with_more_observations_stays_and_inherits() -> None:
    small, first_ids = with_duplicates()
    world = small.map
    second_ids = small.id_of.copy()
    small.id_of = np.where(first_ids >= 0, first_ids, small.id_of)
    small.add(pose(-0.1), make_points=False)  # a third keyframe sees the first one's points too
    twice = np.flatnonzero((first_ids >= 0) & (second_ids >= 0) & (first_ids != second_ids))
    twice = np.intersect1d(twice, small.seen[2])
    old, new = second_ids[twice], first_ids[twice]
    assert np.all(world.points.n_observations[new] > world.points.n_observations[old])
    world.points.n_found[old] = 7
    fuse(new, 1, CAMERA, world)
    gone = ~world.points.is_alive[old]
    assert gone.mean() > 0.95
    assert world.points.is_alive[new].all()
    np.testing.assert_array_equal(world.current_ids(old)[gone], new[gone])
    np.testing.assert_array_equal(world.points.n_found[new[gone]], 8)


def test_a_keyframe_that_sees_no_point_there_gets_an_observation() -> None:
    small = SmallMap.of(SmallWorld.of(5, 300), [np.eye(4)])
    ids = small.id_of.copy()
    small.id_of[:] = -1
    small.add(SECOND, make_points=False)
    assert (small.map.points_of(1) < 0).all()
    n_before = small.map.points.is_alive.sum()
    fuse(ids[ids >= 0], 1, CAMERA, small.map)
    found = points_of_world(small, 1)
    assert all(ids[p] == point for p, point in found.items())
    assert len(found) > 0.95 * len(np.intersect1d(*small.seen))
    assert small.map.points.is_alive.sum() == n_before


def test_points_are_projected_both_ways() -> None:
    for points_of_first in (True, False):
        small, first_ids = with_duplicates()
        known = np.flatnonzero((first_ids >= 0) & (first_ids == small.id_of))
        # Only one of the two has points beside those that they share; the other one's keypoints see nothing there.
        own = small.map.points_of(1 if points_of_first else 0)
        small.map.remove_points(own[(own >= 0) & ~np.isin(own, first_ids[known])])
        fuse_neighbourhood(1, CAMERA, small.map)
        first, second = points_of_world(small, 0), points_of_world(small, 1)
        both = np.intersect1d(*small.seen)
        assert len(both) > 2 * N_KNOWN
        assert np.mean([first.get(p, -1) == second.get(p, -2) for p in both.tolist()]) > 0.93


def unseen_by_second(**look: float) -> tuple[SmallMap, np.ndarray]:
    small = SmallMap.of(SmallWorld.of(5, 300), [np.eye(4)])
    ids = small.id_of.copy()
    small.id_of[:] = -1
    small.add(SECOND, make_points=False, **look)
    return small, ids[ids >= 0]


def test_moving_keypoints_get_no_observation() -> None:
    small, ids = unseen_by_second()
    small.map.keypoints.is_static[small.map.rows(1)] = False
    fuse(ids, 1, CAMERA, small.map)
    assert (small.map.points_of(1) < 0).all()


@pytest.mark.parametrize(
    ("x_px", "right_px", "is_fused"),
    [
        (0.0, 0.0, True),
        (2.7, 0.0, True),
        (0.0, 2.7, True),
        (2.9, 0.0, False),
        (0.0, 2.9, False),
        (2.0, 2.0, False),
        (2.4, None, True),
        (2.5, None, False),
    ],
)
def test_what_projects_too_far_away_is_not_fused(x_px: float, right_px: float | None, is_fused: bool) -> None:
    # On the finest level √7.8 = 2.79 px with a right coordinate, both errors together; √5.99 = 2.45 px without.
    small, ids = unseen_by_second()
    table, rows = small.map.keypoints, small.map.rows(1)
    table.octave[:] = 0
    small.map.refresh(ids)
    with_right = table.right_px[rows] >= 0
    table.px[rows, 0] += x_px
    table.right_px[rows] = -1 if right_px is None else table.right_px[rows] + right_px
    table.is_static[rows] = with_right
    fuse(ids, 1, CAMERA, small.map)
    share = (small.map.points_of(1) >= 0).sum() / np.isin(small.seen[1][with_right], small.seen[0]).sum()
    assert share > 0.6 if is_fused else share < 0.02


def test_what_looks_different_is_not_fused() -> None:
    small, ids = unseen_by_second(flips=51)
    fuse(ids, 1, CAMERA, small.map)
    assert (small.map.points_of(1) >= 0).sum() < 5
    small, ids = unseen_by_second(flips=49)
    fuse(ids, 1, CAMERA, small.map)
    assert (small.map.points_of(1) >= 0).sum() > 100


def test_the_neighbourhood_is_two_steps_wide_without_the_keyframe_itself() -> None:
    small = SmallMap(SmallWorld.of(0, 10))
    graph = small.map.covisibility
    edges = {(0, 1): 50, (0, 2): 40, (1, 3): 30, (2, 3): 20, (3, 4): 60, (2, 5): 35, (1, 6): 25}
    for k in range(7):
        counts = np.zeros(7, np.int32)
        for (a, b), weight in edges.items():
            if k in (a, b):
                counts[a + b - k] = weight
        graph.connect(k, counts)
    assert neighbourhood(0, small.map, n_first=10, n_second=5) == [1, 3, 6, 2, 5]
    assert neighbourhood(0, small.map, n_first=1, n_second=2) == [1, 3]
    assert neighbourhood(0, small.map, n_first=0) == []


def test_a_keyframe_without_neighbours_is_left_as_it_is() -> None:
    small = SmallMap.of(SmallWorld.of(0, 100), [np.eye(4)])
    before = small.map.points_of(0).copy()
    fuse_neighbourhood(0, CAMERA, small.map)
    np.testing.assert_array_equal(small.map.points_of(0), before)
