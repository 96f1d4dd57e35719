"""Sub-maps: the part of a map built after tracking was lost, until a place is recognised and it is merged.

A keyframe without a parent begins a sub-map. Sub-maps lie half a kilometre apart, so that no comparison of positions,
such as with earlier depth images, confuses them.
"""

import numpy as np

from stillroom.data.map.map import Map
from stillroom.geometry import se3
from stillroom.geometry.arrays import F64, I64, Bool, Floats, Ints

SPACING_M = 500.0
_IN_A_ROW = 32
NONE = -1
"""The sub-map of what is in no map."""


def origin(submap: int) -> F64:
    """Return the pose `T_world_cam` (4, 4) at which a sub-map begins."""
    T = np.eye(4)
    T[:2, 3] = SPACING_M * (submap % _IN_A_ROW), SPACING_M * (submap // _IN_A_ROW)
    return T


def lies_in(submap: int, positions_m: Floats) -> Bool:
    """Return which positions (N, 3) [m, world] lie in the region of a sub-map."""
    return np.asarray(np.abs(positions_m - origin(submap)[:3, 3]).max(axis=1) < SPACING_M / 2, dtype=np.bool_)


def unjoined(world: Map) -> I64:
    """Return the ids of the sub-maps (S,), the oldest first; a single one where all are merged."""
    found: I64 = np.unique(world.keyframes.submap[world.keyframes.is_alive]).astype(np.int64)
    return found


def main(world: Map, since: int = 0) -> int:
    """Return the sub-map with most keyframes, of equals the oldest: the one of a run's trajectory; NONE without any.

    Args:
        world: The map.
        since: First keyframe of the run that asks; where it made none, those of earlier runs count.
    """
    alive = world.keyframes.is_alive.copy()
    if alive[since:].any():
        alive[:since] = False
    if not alive.any():
        return NONE
    return int(np.argmax(np.bincount(world.keyframes.submap[alive])))


def discard(submap: int, world: Map) -> None:
    """Remove a sub-map with its keyframes and points; no other has its id."""
    table = world.keyframes
    for keyframe in np.flatnonzero(table.is_alive & (table.submap == submap))[::-1]:
        world.remove_keyframe(int(keyframe))


def of_points(point_ids: Ints, world: Map) -> Ints:
    """Return the sub-map (P,) of each point (P,)."""
    submaps: Ints = world.keyframes.submap[world.points.first_keyframe[point_ids]]
    return submaps


def join(moved: int, kept: int, T_kept_moved: F64, growth: float, parent: int, world: Map) -> None:
    """Merge a sub-map into another: its keyframes and points move rigidly, or by a similarity.

    Args:
        moved: The sub-map that moves.
        kept: The one that stays where it is.
        T_kept_moved: Motion (4, 4) of its coordinates; with a scale (`geometry.sim3`) where maps are up to scale.
        growth: What that multiplies lengths by; 1 for a rigid motion.
        parent: Keyframe of the other that becomes the parent of its first keyframe.
        world: The map.
    """
    assert max(moved, kept) < world.n_submaps  # which keeps counting the id that is dropped
    table, points = world.keyframes, world.points
    members = np.flatnonzero(table.submap == moved)
    ids = np.flatnonzero(points.is_alive)
    ids = ids[of_points(ids, world) == moved]
    alive = members[table.is_alive[members]]
    carried = T_kept_moved @ table.T_world_cam[alive]
    carried[:, :3, :3] /= growth
    table.T_world_cam[alive] = carried
    table.scale[members] *= growth
    points.position_m[ids] = se3.transform(T_kept_moved, points.position_m[ids])
    table.submap[members] = kept
    root = members[table.parent[members] < 0]
    table.parent[root] = parent
    world.refresh_geometry(ids)
