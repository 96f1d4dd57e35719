"""Making the map agree with a loop: fuse the place, and spread the error over the way that led there and back."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from stillroom.data.map import Map
from stillroom.geometry import se3
from stillroom.geometry.arrays import F64, I64
from stillroom.geometry.camera import Camera
from stillroom.loops.essential_graph import essential_edges, shared_points
from stillroom.loops.fusing import fuse_place, take_over
from stillroom.loops.moving import follow_keyframes, move_rigidly
from stillroom.loops.recognition.verification import Loop
from stillroom.optimize.pose_graph import PoseGraph, PoseGraphOptimizer

SIGMA_M, SIGMA_RAD = 0.01, 0.005
"""How exact a motion between keyframes is that share a hundred points; they relate as at a depth of two metres."""
TYPICAL_SHARED = 100.0
LEAST_SHARED = 15.0


@dataclass(frozen=True)
class Correction:
    """What was done to the map.

    Attributes:
        T_world_old: Poses of all keyframes (K, 4, 4) before.
        keyframes: Keyframes that took part, all of what hangs together (N,).
        around: Those of them that show the place, then or now (A,).
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

    The keyframe and its covisible ones are put where the place says they are, the place's points are fused into them,
    and a pose graph spreads the error over all keyframes. Points follow the keyframe that saw them first.
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
    """Let the keyframes of a group, which lie right by now, see the points of a place; count again what they share."""
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
    n = len(world.keyframes)
    graph = coo_matrix((np.ones(len(edges), dtype=np.int8), (edges[:, 0], edges[:, 1])), shape=(n, n))
    _, part = connected_components(graph, directed=False)
    return np.flatnonzero((part == part[keyframe]) & world.keyframes.is_alive)


def _graph(edges: I64, measured: F64, shared: F64, keyframes: I64, poses: F64) -> PoseGraph:
    """Return the pose graph of some keyframes (N,); the oldest of them holds still."""
    node = np.full(len(poses), -1, dtype=np.int64)
    node[keyframes] = np.arange(len(keyframes))
    used = (node[edges] >= 0).all(axis=1)
    is_fixed = np.zeros(len(keyframes), dtype=np.bool_)
    is_fixed[0] = True
    variance = np.repeat((SIGMA_M**2, SIGMA_RAD**2), 3)
    information = np.maximum(shared[used], LEAST_SHARED)[:, None] / TYPICAL_SHARED / variance
    first, second = node[edges[used]].T
    return PoseGraph(poses[keyframes], is_fixed, first, second, measured[used], information)
