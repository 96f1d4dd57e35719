"""Points go where the keyframes go that saw them first."""

from collections.abc import Sequence

import numpy as np

from stillroom.data.map import Map
from stillroom.geometry import se3
from stillroom.geometry.arrays import F64, I64
from stillroom.loops.essential_graph import alive_parent


def move_rigidly(keyframes: Sequence[int] | I64, T_new_old: F64, world: Map) -> None:
    """Move keyframes (K,) by one motion (4, 4), without their points."""
    chosen = np.asarray(keyframes, dtype=np.int64)
    world.keyframes.T_world_cam[chosen] = T_new_old @ world.keyframes.T_world_cam[chosen]


def follow_keyframes(point_ids: I64, T_world_old: F64, world: Map) -> None:
    """Move points (P,) with the keyframe that saw each first.

    Args:
        point_ids: Points in the map; those that nothing sees stay.
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
