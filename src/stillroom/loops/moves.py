"""What follows when keyframes are moved: their points, later keyframes, and the lengths of a map up to scale.

Motions of coordinates are (4, 4), rigid or, where a map is up to scale, similarities (`geometry.sim3`). Each keyframe's
`scale` in the map tells by how much lengths around it changed.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stillroom.data.map import Map
from stillroom.geometry import se3
from stillroom.geometry.arrays import F64, I64


@dataclass(frozen=True)
class Places:
    """Where all keyframes were: poses `T_world_cam` (K, 4, 4), and the scales of their surroundings (K,)."""

    T_world_cam: F64
    scale: F64

    @staticmethod
    def of(world: Map) -> "Places":
        """Copy them."""
        return Places(world.keyframes.T_world_cam.copy(), world.keyframes.scale.copy())

    def growth(self, world: Map) -> F64:
        """Return what lengths around each keyframe (K,) have been multiplied by since; 1 in a metric map."""
        scale: F64 = world.keyframes.scale[: len(self.scale)] / self.scale
        return scale

    def motions(self, world: Map) -> F64:
        """Return the motions (K, 4, 4) of the coordinates around each keyframe since."""
        T_cam_old = se3.inverse(self.T_world_cam)
        T_cam_old[:, :3] *= self.growth(world)[:, None, None]
        moved: F64 = world.keyframes.T_world_cam[: len(self.T_world_cam)] @ T_cam_old
        return moved


def alive_parent(keyframe: int, world: Map) -> int:
    """Return the nearest keyframe above this one in the spanning tree that was not culled; −1 for a root."""
    parent = int(world.keyframes.parent[keyframe])
    while parent >= 0 and not world.keyframes.is_alive[parent]:
        parent = int(world.keyframes.parent[parent])
    return parent


def move(keyframes: Sequence[int] | I64, T_new_old: F64, growth: float, world: Map) -> None:
    """Move keyframes (K,) by one motion (4, 4) that multiplies lengths by `growth`, without their points."""
    chosen = np.asarray(keyframes, dtype=np.int64)
    moved = T_new_old @ world.keyframes.T_world_cam[chosen]
    moved[:, :3, :3] /= growth
    world.keyframes.T_world_cam[chosen] = moved
    world.keyframes.scale[chosen] *= growth


# Points move with the keyframe that observed them first.


def follow_keyframes(point_ids: I64, before: Places, world: Map) -> None:
    """Move points (P,) with the keyframe that saw each first.

    Args:
        point_ids: Points in the map; those without observations stay.
        before: Where all keyframes were before they moved.
        world: The map, its keyframes moved already.
    """
    rows = world.oldest_observations(point_ids)
    ids, rows = point_ids[rows >= 0], rows[rows >= 0]
    apply_motions(ids, before.motions(world)[world.keypoints.keyframe[rows]], world)


def apply_motions(point_ids: I64, T_new_old: F64, world: Map) -> None:
    """Move points (P,), each by its own motion (P, 4, 4)."""
    positions_m = world.points.position_m[point_ids]
    moved = np.einsum("nij,nj->ni", T_new_old[:, :3, :3], positions_m) + T_new_old[:, :3, 3]
    world.points.position_m[point_ids] = moved


def carry_newer(n_known: int, before: Places, world: Map) -> None:
    """Move keyframes from id `n_known` on with their parents, and let culled ones take part in changes of scale.

    Args:
        n_known: Number of keyframes that have been moved already.
        before: Where all keyframes were when their parents had not moved yet.
        world: The map.
    """
    keyframes = world.keyframes
    for keyframe in range(n_known, len(keyframes)):
        parent = alive_parent(keyframe, world)
        if parent >= 0 and keyframes.is_alive[keyframe]:
            growth = keyframes.scale[parent] / before.scale[parent]
            T_parent_cam = se3.inverse(before.T_world_cam[parent]) @ before.T_world_cam[keyframe]
            T_parent_cam[:3, 3] *= growth
            keyframes.T_world_cam[keyframe] = keyframes.T_world_cam[parent] @ T_parent_cam
            keyframes.scale[keyframe] = before.scale[keyframe] * growth
    rescale_culled(before, world, n_known)


def rescale_culled(before: Places, world: Map, since: int = 0) -> None:
    """Let culled keyframes from id `since` on take part in the change of scale above them: poses are noted in them."""
    keyframes, growth = world.keyframes, before.growth(world)
    if (growth == 1.0).all():
        return
    for keyframe in since + np.flatnonzero(~keyframes.is_alive[since : len(growth)]):
        parent = alive_parent(int(keyframe), world)
        if parent >= 0:
            keyframes.scale[keyframe] = before.scale[keyframe] * growth[parent]
