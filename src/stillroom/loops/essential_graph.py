"""The essential graph: few edges that carry the shape of the whole map (ORB-SLAM, Mur-Artal et al. 2015, III-D)."""

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import dijkstra

from stillroom.data.map import Map
from stillroom.geometry import se3
from stillroom.geometry.arrays import F64, I64


def alive_parent(keyframe: int, world: Map) -> int:
    """Return the nearest keyframe above this one in the spanning tree that was not culled; −1 for a root."""
    parent = int(world.keyframes.parent[keyframe])
    while parent >= 0 and not world.keyframes.is_alive[parent]:
        parent = int(world.keyframes.parent[parent])
    return parent


def essential_edges(world: Map, min_weight: int) -> I64:
    """Return the edges (E, 2) between alive keyframes: spanning tree, strong covisibility, and the loops closed so far.

    Args:
        world: The map.
        min_weight: Shared points from which on covisibility is strong (ORB-SLAM2: 100).
    """
    alive = world.keyframes.is_alive
    edges: dict[tuple[int, int], None] = {}
    for keyframe in world.alive_keyframes().tolist():
        parent = alive_parent(keyframe, world)
        if parent >= 0:
            edges[_ordered(parent, keyframe)] = None
    for first, second, weight in world.covisibility.edges().tolist():
        if weight >= min_weight and alive[first] and alive[second]:
            edges[_ordered(first, second)] = None
    for first, second in world.loop_edges:
        if alive[first] and alive[second]:
            edges[_ordered(first, second)] = None
    return np.array(list(edges), dtype=np.int64).reshape(-1, 2)


def shared_points(edges: I64, world: Map) -> F64:
    """Return how many points the keyframes of each edge (E, 2) share, (E,)."""
    return np.array([world.covisibility.weight(int(first), int(second)) for first, second in edges], dtype=np.float64)


def path_between(first: int, second: int, edges: I64, world: Map) -> float:
    """Return the length [m] of the shortest way through the graph; infinite where there is none.

    An edge is as long as its keyframes are apart, and a turn of one radian counts as a metre: both are where drift
    comes from.
    """
    poses = world.keyframes.T_world_cam
    apart = se3.inverse(poses[edges[:, 0]]) @ poses[edges[:, 1]]
    length_m = np.linalg.norm(apart[:, :3, 3], axis=1) + se3.angle_rad(apart)
    n = len(world.keyframes)
    graph: csr_matrix = coo_matrix((length_m + 1e-9, (edges[:, 0], edges[:, 1])), shape=(n, n)).tocsr()
    return float(dijkstra(graph, directed=False, indices=first)[second])


def _ordered(first: int, second: int) -> tuple[int, int]:
    return (first, second) if first < second else (second, first)
