"""Edges of the essential graph, and the way between two keyframes through it."""

from itertools import pairwise

import numpy as np
from small_world import SCALES, pose

from stillroom.data.map import Map
from stillroom.geometry import se3
from stillroom.loops.correction import connected_to, essential_edges, paths_from, shared_points
from stillroom.loops.moves import alive_parent


def bare_map(poses: list[np.ndarray], parents: list[int], weights: dict[tuple[int, int], int]) -> Map:
    """A map of keyframes alone, with the given number of points shared."""
    world = Map(SCALES)
    for k, (T_world_cam, parent) in enumerate(zip(poses, parents, strict=True)):
        world.keyframes.append(1, T_world_cam=T_world_cam, parent=parent, T_parent_cam=np.eye(4))
        counts = np.zeros(k + 1, dtype=np.int32)
        for (first, second), weight in weights.items():
            if second == k:
                counts[first] = weight
        world.covisibility.connect(k, counts)
    return world


def line() -> Map:
    poses = [pose(0.5 * k) for k in range(6)]
    return bare_map(poses, [-1, 0, 1, 2, 3, 4], {(0, 2): 150, (1, 3): 99, (2, 3): 30, (0, 5): 100})


def edges_of(world: Map, weight: int | None) -> set[tuple[int, int]]:
    return {(int(first), int(second)) for first, second in essential_edges(world, weight)}


def test_tree_strong_covisibility_and_loops_make_the_graph() -> None:
    world = line()
    tree = {(0, 1), (1, 2), (2, 3), (3, 4), (4, 5)}
    assert edges_of(world, 100) == tree | {(0, 2), (0, 5)}
    assert edges_of(world, 15) == tree | {(0, 2), (0, 5), (1, 3)}
    assert edges_of(world, None) == tree
    world.loop_edges.append((1, 4))
    assert edges_of(world, 1000) == tree | {(1, 4)}
    edges = essential_edges(world, 100)
    assert shared_points(edges, world).tolist() == [world.covisibility.weight(*edge) for edge in edges.tolist()]


def test_culled_keyframes_are_bridged() -> None:
    world = line()
    world.loop_edges += [(1, 4), (2, 5)]
    for culled in (1, 2):
        world.keyframes.is_alive[culled] = False
        world.covisibility.remove(culled)
    assert alive_parent(3, world) == 0
    assert alive_parent(0, world) == -1
    assert edges_of(world, 100) == {(0, 3), (3, 4), (4, 5), (0, 5)}


def test_the_way_between_keyframes_is_the_shortest_and_turns_count() -> None:
    world = line()
    edges = np.array(list(pairwise(range(6))))
    np.testing.assert_allclose(paths_from(0, edges, world)[5], 2.5, atol=1e-6)
    np.testing.assert_allclose(paths_from(5, edges, world)[1], 2.0, atol=1e-6)
    world.keyframes.T_world_cam[5] = world.keyframes.T_world_cam[5] @ se3.exp(np.array([0, 0, 0, 0, 0.7, 0]))
    np.testing.assert_allclose(paths_from(0, edges, world)[5], 3.2, atol=1e-6)
    np.testing.assert_allclose(paths_from(0, np.array([[0, 1], [1, 4]]), world)[4], 2.0, atol=1e-6)
    assert paths_from(0, np.array([[0, 1], [3, 4]]), world)[3] == np.inf


def test_what_no_edge_joins_is_left_out() -> None:
    world = line()
    world.keyframes.is_alive[1] = False
    edges = np.array([[0, 1], [1, 2], [3, 4]])
    assert connected_to(4, edges, world).tolist() == [3, 4]
    assert connected_to(2, edges, world).tolist() == [0, 2]
