"""Fusing of duplicate map points."""

import numpy as np

from stillroom.data.map import Map
from stillroom.features.matching import NEAR_BITS
from stillroom.features.projection import Window, keyframe_targets, search_around
from stillroom.geometry import se3
from stillroom.geometry.arrays import I32
from stillroom.geometry.camera import Camera

_WINDOW = Window(3.0, levels_above=0, max_bits=NEAR_BITS)
_CHI2_2D, _CHI2_3D = 5.99, 7.8


def neighbourhood(keyframe: int, world: Map, n_first: int = 10, n_second: int = 2) -> list[int]:
    """Return covisible keyframes and a few of theirs, each once, in a fixed order."""
    chosen: dict[int, None] = {}
    for neighbour in world.covisibility.neighbours(keyframe, n_first):
        chosen[neighbour] = None
        for second in world.covisibility.neighbours(neighbour, n_second):
            if second != keyframe:
                chosen[second] = None
    return list(chosen)


def fuse_neighbourhood(keyframe: int, camera: Camera, world: Map, n_neighbours: int = 10) -> None:
    """Project the keyframe's points into its neighbours and theirs into it, and fuse matches (ORB-SLAM2)."""
    neighbours = neighbourhood(keyframe, world, n_neighbours)
    for neighbour in neighbours:
        own = world.points_of(keyframe)
        fuse(own[own >= 0], neighbour, camera, world)
    fuse(world.points_seen_by(np.array(neighbours)), keyframe, camera, world)
    own = world.points_of(keyframe)
    world.refresh(own[own >= 0])
    world.connect(keyframe)


def fuse(point_ids: I32, keyframe: int, camera: Camera, world: Map) -> None:
    """Search points (P,) in a keyframe, and add an observation or fuse two points for each match.

    Of two fused points the one with more observations stays.
    """
    table, points = world.keypoints, world.points
    ids = world.without(point_ids, world.points_of(keyframe))
    ids = ids[points.is_alive[ids]]
    T_cam_world = se3.inverse(world.keyframes.T_world_cam[keyframe])
    seen = search_around(ids, T_cam_world, camera, world, keyframe_targets(keyframe, world), _WINDOW)
    found = world.rows(keyframe).start + seen.target
    error2 = ((seen.px - table.px[found]) ** 2).sum(axis=1)
    has_depth = table.right_px[found] >= 0
    error2 += np.where(has_depth, (seen.right_px - table.right_px[found]) ** 2, 0.0)
    error2 *= world.scales.inverse_variances[table.octave[found]]
    good = error2 <= np.where(has_depth, _CHI2_3D, _CHI2_2D)
    _join(seen.point_ids[good], found[good], world)


def _join(ids: I32, rows: I32, world: Map) -> None:
    """Let rows (M,) of one keyframe observe points (M,), or join these with those that the rows see, each once."""
    other = world.keypoints.point[rows]
    fresh = other < 0
    world.observe(ids[fresh], rows[fresh])
    if fresh.all():
        return
    ids, other = ids[~fresh], other[~fresh]
    weaker = world.points.n_observations[ids] <= world.points.n_observations[other]
    world.replace_points(np.where(weaker, ids, other), np.where(weaker, other, ids))
