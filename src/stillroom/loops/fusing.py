"""Making one point of two when a place is seen again; the place's own points stay (ORB-SLAM2: SearchAndFuse)."""

import numpy as np

from stillroom.data.map import Map
from stillroom.features.matching import NEAR_BITS
from stillroom.features.projection import Window, keyframe_targets, search_around
from stillroom.geometry import se3
from stillroom.geometry.arrays import I32, Ints
from stillroom.geometry.camera import Camera

WINDOW = Window(4.0, levels_above=0, max_bits=NEAR_BITS)


def take_over(point_ids: I32, rows: Ints, world: Map) -> None:
    """Let rows (M,) see points (M,): what they saw so far is replaced by them everywhere."""
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
    """Look for the points (P,) of a place in a keyframe that lies right by now, and let it see them."""
    points = world.points
    own = world.points_of(keyframe)
    is_seen = np.zeros(len(points), dtype=np.bool_)
    is_seen[own[own >= 0]] = True
    ids = point_ids[~is_seen[point_ids] & points.is_alive[point_ids]]
    T_cam_world = se3.inverse(world.keyframes.T_world_cam[keyframe])
    found = search_around(ids, T_cam_world, camera, world, keyframe_targets(keyframe, world), WINDOW)
    take_over(found.point_ids, world.rows(keyframe).start + found.target.astype(np.int64), world)
