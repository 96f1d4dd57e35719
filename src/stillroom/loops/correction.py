"""Correcting the map for a loop: fuse the place, and distribute the error over the loop."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stillroom.data.map import Map
from stillroom.features.matching import NEAR_BITS
from stillroom.features.projection import Window, keyframe_targets, search_around
from stillroom.geometry import se3
from stillroom.geometry.arrays import F64, I32, I64, Ints
from stillroom.geometry.camera import Camera
from stillroom.loops.verification import Loop
from stillroom.optimize.pose_graph import PoseGraph, PoseGraphOptimizer

WINDOW = Window(4.0, levels_above=0, max_bits=NEAR_BITS)
TYPICAL_SHARED = 100.0
LEAST_SHARED = 15.0
SIGMA_M, SIGMA_RAD = 0.01, 0.005
"""Standard deviations of the motion between keyframes that share a hundred points, related as at a depth of two
metres.
"""


# The essential graph: few edges that carry the shape of the whole map (ORB-SLAM, Mur-Artal et al. 2015, III-D).


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
    """Return the length [m] of the shortest path through the graph to each keyframe (K,); infinite where there is none.

    An edge is as long as its keyframes are apart, and a rotation of one radian counts as a metre: both cause drift.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import dijkstra

    poses = world.keyframes.T_world_cam
    apart = se3.inverse(poses[edges[:, 0]]) @ poses[edges[:, 1]]
    length_m = np.linalg.norm(apart[:, :3, 3], axis=1) + se3.angle_rad(apart)
    n = len(world.keyframes)
    graph = coo_matrix((length_m + 1e-9, (edges[:, 0], edges[:, 1])), shape=(n, n)).tocsr()
    lengths_m: F64 = dijkstra(graph, directed=False, indices=keyframe)
    return lengths_m


# Points move with the keyframe that observed them first.


def move_rigidly(keyframes: Sequence[int] | I64, T_new_old: F64, world: Map) -> None:
    """Move keyframes (K,) by one motion (4, 4), without their points."""
    chosen = np.asarray(keyframes, dtype=np.int64)
    world.keyframes.T_world_cam[chosen] = T_new_old @ world.keyframes.T_world_cam[chosen]


def follow_keyframes(point_ids: I64, T_world_old: F64, world: Map) -> None:
    """Move points (P,) with the keyframe that saw each first.

    Args:
        point_ids: Points in the map; those without observations stay.
        T_world_old: Poses of all keyframes (K, 4, 4) before they moved.
        world: The map, its keyframes moved already.
    """
    rows = world.oldest_observations(point_ids)
    ids, rows = point_ids[rows >= 0], rows[rows >= 0]
    T_new_old = world.keyframes.T_world_cam[: len(T_world_old)] @ se3.inverse(T_world_old)
    apply_motions(ids, T_new_old[world.keypoints.keyframe[rows]], world)


def apply_motions(point_ids: I64, T_new_old: F64, world: Map) -> None:
    """Move points (P,), each by its own motion (P, 4, 4)."""
    positions_m = world.points.position_m[point_ids]
    moved = np.einsum("nij,nj->ni", T_new_old[:, :3, :3], positions_m) + T_new_old[:, :3, 3]
    world.points.position_m[point_ids] = moved


def carry_newer(n_known: int, T_world_old: F64, world: Map) -> None:
    """Move keyframes from id `n_known` on with their parents, which have moved since they were at `T_world_old`.

    Args:
        n_known: Number of keyframes that have been moved already.
        T_world_old: Poses of all keyframes (K, 4, 4) before.
        world: The map.
    """
    keyframes = world.keyframes
    for keyframe in range(n_known, len(keyframes)):
        parent = alive_parent(keyframe, world)
        if parent >= 0 and keyframes.is_alive[keyframe]:
            T_parent_cam = se3.inverse(T_world_old[parent]) @ T_world_old[keyframe]
            keyframes.T_world_cam[keyframe] = keyframes.T_world_cam[parent] @ T_parent_cam


# Fusing duplicate points when a place is seen again; the place's own points stay (ORB-SLAM2: SearchAndFuse).


def take_over(point_ids: I32, rows: Ints, world: Map) -> None:
    """Link rows (M,) to points (M,): the points that they observed before are replaced everywhere."""
    other = world.keypoints.point[rows]
    fresh = other < 0
    world.observe(point_ids[fresh], rows[fresh])
    old, new = other[~fresh], point_ids[~fresh]
    # Each point at most once on either side, so that no chain of replacements forms.
    _, first = np.unique(old, return_index=True)
    keep = np.zeros(len(old), dtype=np.bool_)
    keep[first] = True
    keep &= ~np.isin(old, new) & (old != new)
    world.replace_points(old[keep], new[keep])


def fuse_place(point_ids: I32, keyframe: int, camera: Camera, world: Map) -> None:
    """Search the points (P,) of a place in a keyframe with a corrected pose, and add the observations."""
    points = world.points
    own = world.points_of(keyframe)
    is_seen = np.zeros(len(points), dtype=np.bool_)
    is_seen[own[own >= 0]] = True
    ids = point_ids[~is_seen[point_ids] & points.is_alive[point_ids]]
    T_cam_world = se3.inverse(world.keyframes.T_world_cam[keyframe])
    found = search_around(ids, T_cam_world, camera, world, keyframe_targets(keyframe, world), WINDOW)
    take_over(found.point_ids, world.rows(keyframe).start + found.target.astype(np.int64), world)


@dataclass(frozen=True)
class Correction:
    """A correction of the map.

    Attributes:
        T_world_old: Poses of all keyframes (K, 4, 4) before.
        keyframes: Keyframes that were optimised, a whole connected component (N,).
        around: Those of them that observe the place, then or now (A,).
        moved_m, turned_rad: How far the keyframe that closed the loop was moved and turned.
    """

    T_world_old: F64
    keyframes: I64
    around: I64
    moved_m: float
    turned_rad: float


def close_loop(
    loop: Loop, world: Map, camera: Camera, optimize: PoseGraphOptimizer, essential_weight: int = 100
) -> Correction:
    """Correct the map for a loop: ORB-SLAM2's CorrectLoop with the scale fixed.

    The keyframe and its covisible ones get the poses that the loop implies, the place's points are fused into them,
    and a pose graph distributes the error over all keyframes. Points follow the keyframe that saw them first.
    """
    T_world_old = world.keyframes.T_world_cam.copy()
    edges = essential_edges(world, essential_weight)
    measured = se3.inverse(T_world_old[edges[:, 0]]) @ T_world_old[edges[:, 1]]
    shared = shared_points(edges, world)
    place = [loop.candidate, *world.covisibility.neighbours(loop.candidate)]
    group = [k for k in (loop.keyframe, *world.covisibility.neighbours(loop.keyframe)) if k not in place]
    move_rigidly(group, loop.T_world_cam @ se3.inverse(T_world_old[loop.keyframe]), world)
    known = {k: set(world.covisibility.neighbours(k)) for k in group}
    fuse_group(loop, place, group, camera, world)
    new = [(k, other) for k in group for other in world.covisibility.neighbours(k) if other not in known[k]]
    new = list(dict.fromkeys([(loop.keyframe, loop.candidate), *(pair for pair in new if pair[1] not in group)]))
    added = np.array(new, dtype=np.int64)
    poses = world.keyframes.T_world_cam
    graph_edges = np.concatenate((edges, added))
    keyframes = connected_to(loop.keyframe, graph_edges, world)
    optimized = optimize(
        _graph(
            graph_edges,
            np.concatenate((measured, se3.inverse(poses[added[:, 0]]) @ poses[added[:, 1]])),
            np.concatenate((shared, shared_points(added, world))),
            keyframes,
            poses,
        )
    )
    poses[keyframes] = optimized.T_world_node
    world.loop_edges.append((loop.candidate, loop.keyframe))
    alive = np.flatnonzero(world.points.is_alive)
    follow_keyframes(alive, T_world_old, world)
    world.refresh_geometry(alive)
    T_old_new = se3.inverse(T_world_old[loop.keyframe]) @ loop.T_world_cam
    around = np.intersect1d([*place, *group], keyframes)
    return Correction(
        T_world_old, keyframes, around, float(np.linalg.norm(T_old_new[:3, 3])), float(se3.angle_rad(T_old_new))
    )


def fuse_group(loop: Loop, place: Sequence[int], group: Sequence[int], camera: Camera, world: Map) -> None:
    """Fuse the points of a place into a group of keyframes with corrected poses; update their covisibility."""
    take_over(loop.point_ids, loop.rows, world)
    points = world.points_seen_by(np.array(place))
    for keyframe in group:
        fuse_place(points, keyframe, camera, world)
    seen = world.points_seen_by(np.array([*place, *group]))
    world.refresh(seen[world.points.is_alive[seen]])
    for keyframe in group:
        world.connect(keyframe)


def connected_to(keyframe: int, edges: I64, world: Map) -> I64:
    """Return the alive keyframes (N,) that edges (E, 2) join with one, itself among them, the oldest first."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    n = len(world.keyframes)
    graph = coo_matrix((np.ones(len(edges), dtype=np.int8), (edges[:, 0], edges[:, 1])), shape=(n, n))
    _, part = connected_components(graph, directed=False)
    return np.flatnonzero((part == part[keyframe]) & world.keyframes.is_alive)


def _graph(edges: I64, measured: F64, shared: F64, keyframes: I64, poses: F64) -> PoseGraph:
    """Return the pose graph of some keyframes (N,); the oldest of them is fixed."""
    node = np.full(len(poses), -1, dtype=np.int64)
    node[keyframes] = np.arange(len(keyframes))
    used = (node[edges] >= 0).all(axis=1)
    is_fixed = np.zeros(len(keyframes), dtype=np.bool_)
    is_fixed[0] = True
    variance = np.repeat((SIGMA_M**2, SIGMA_RAD**2), 3)
    information = np.maximum(shared[used], LEAST_SHARED)[:, None] / TYPICAL_SHARED / variance
    first, second = node[edges[used]].T
    return PoseGraph(poses[keyframes], is_fixed, first, second, measured[used], information)
