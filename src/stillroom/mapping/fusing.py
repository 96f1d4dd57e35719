"""Fusing of duplicate map points."""

import numpy as np

from stillroom.compiled import njit
from stillroom.data.map import Map
from stillroom.data.map.links import Counts, Found, Links, Unsaved, join
from stillroom.features.matching import NEAR_BITS, TargetArrays
from stillroom.features.projection import (
    Around,
    PointGeometry,
    Viewer,
    Window,
    find_around,
    geometry_of,
    keyframe_targets,
    viewer_of,
)
from stillroom.geometry import se3
from stillroom.geometry.arrays import F32, F64, I32, U64
from stillroom.geometry.camera import Camera
from stillroom.geometry.hamming import words

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
        fuse(world.points_of(keyframe), neighbour, camera, world)
    fuse(world.points_seen_by(np.array(neighbours)), keyframe, camera, world)
    own = world.points_of(keyframe)
    world.refresh(own[own >= 0])
    world.connect(keyframe)


def fuse(point_ids: I32, keyframe: int, camera: Camera, world: Map) -> None:
    """Search points (P,) in a keyframe, and add an observation or fuse two points for each match; −1 is skipped.

    Of two fused points the one with more observations stays.
    """
    factors, T_cam_world = world.scales.factors, se3.inverse(world.keyframes.T_world_cam[keyframe])
    _fuse(
        world.without(point_ids, world.points_of(keyframe)),
        (viewer_of(T_cam_world, camera, factors), factors, world.scales.inverse_variances),
        (geometry_of(world), words(world.points.descriptors)),
        (world.rows(keyframe).start, keyframe_targets(keyframe, world).arrays),
        _WINDOW.around,
        world.changeable,
    )


@njit(nogil=True, cache=True)
def _fuse(
    ids: I32,
    view: tuple[Viewer, F64, F64],
    points: tuple[PointGeometry, U64],
    rows: tuple[int, TargetArrays],
    around: Around,
    changeable: tuple[Links, F32, Counts, Unsaved, Found],
) -> None:
    """Search points (P,) that a keyframe does not see in it; let it observe them, or join them with those that it sees.

    Args:
        ids: The points; those that were removed are left out.
        view: The keyframe, and size (L,) [px] and inverse variance (L,) [1/px²] of its levels.
        points: All points, and their descriptors as words (P, 4).
        rows: First row of the keyframe, and its keypoints.
        around: Where to search.
        changeable: What the map lets kernels change.
    """
    (viewer, factors, inverse_variances), (geometry, descriptors), (first_row, there) = view, points, rows
    lists, row_right_px, counts, unsaved, found = changeable
    n = 0
    alive = np.empty(len(ids), np.int32)
    for p in ids:
        if found.is_alive[p]:
            alive[n] = p
            n += 1
    _, seen, target, px, right_px = find_around(viewer, geometry, alive[:n], factors, descriptors, there, around)
    n = 0
    chosen = np.empty(len(seen), np.int64)
    for i in range(len(seen)):
        t = target[i]
        du, dv = px[i, 0] - there.px[t, 0], px[i, 1] - there.px[t, 1]
        error2, limit = du * du + dv * dv, _CHI2_2D
        if there.right_px[t] >= 0:
            dr = right_px[i] - there.right_px[t]
            error2, limit = error2 + dr * dr, _CHI2_3D
        if np.float32(error2 * inverse_variances[there.octave[t]]) <= limit:
            seen[n], chosen[n] = seen[i], first_row + t
            n += 1
    join(seen[:n], chosen[:n], lists, row_right_px, counts, unsaved, found)
