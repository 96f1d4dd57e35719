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


def essential_edges(world: Map, min_weight: int | None) -> I64:
    """Return the edges (E, 2) between alive keyframes: spanning tree, strong covisibility, and the loops closed so far.

    Args:
        world: The map.
        min_weight: Shared points from which on covisibility is strong (ORB-SLAM2: 100); None leaves it out.
    """
    table, children = world.keyframes, world.alive_keyframes()
    parents = table.parent[children].astype(np.int64)
    while True:
        culled = np.flatnonzero((parents >= 0) & ~table.is_alive[parents])
        if len(culled) == 0:
            break
        parents[culled] = table.parent[parents[culled]]
    tree = np.column_stack((parents, children))[parents >= 0]
    loops = np.array(world.loop_edges, dtype=np.int64).reshape(-1, 2)
    kinds = [tree, loops]
    if min_weight is not None:
        weighted = world.covisibility.edges().astype(np.int64)
        kinds.append(weighted[weighted[:, 2] >= min_weight, :2])
    edges = np.sort(np.concatenate(kinds), axis=1)
    return np.unique(edges[table.is_alive[edges].all(axis=1)], axis=0)


def shared_points(edges: I64, world: Map) -> F64:
    """Return how many points the keyframes of each edge (E, 2) share, (E,)."""
    return np.array([world.covisibility.weight(int(first), int(second)) for first, second in edges], dtype=np.float64)


def paths_from(keyframe: int, edges: I64, world: Map) -> F64:
    """Return the length [m] of the shortest way through the graph to each keyframe (K,); infinite where none leads.

    An edge is as long as its keyframes are apart, and a turn of one radian counts as a metre: both are where drift
    comes from.
    """
    poses = world.keyframes.T_world_cam
    apart = se3.inverse(poses[edges[:, 0]]) @ poses[edges[:, 1]]
    length_m = np.linalg.norm(apart[:, :3, 3], axis=1) + se3.angle_rad(apart)
    n = len(world.keyframes)
    graph: csr_matrix = coo_matrix((length_m + 1e-9, (edges[:, 0], edges[:, 1])), shape=(n, n)).tocsr()
    lengths_m: F64 = dijkstra(graph, directed=False, indices=keyframe)
    return lengths_m
