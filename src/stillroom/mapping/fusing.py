"""Fusing of duplicate map points."""

from typing import NamedTuple

import numpy as np

from stillroom.compiled import njit
from stillroom.data.map import Map
from stillroom.features.matching import CELL_PX, NEAR_BITS, Grid, build_grid
from stillroom.geometry import se3
from stillroom.geometry.arrays import F32, F64, I32, I64, U64, Bool
from stillroom.geometry.camera import Camera
from stillroom.geometry.hamming import hamming, words

WINDOW_PX = 3.0
"""Half the edge of the window on the finest level; it is larger on coarser ones."""
LEAST_VIEW_COS = 0.5
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


def fuse_neighbourhood(keyframe: int, camera: Camera, world: Map) -> None:
    """Project the keyframe's points into its neighbours and theirs into it, and fuse matches (ORB-SLAM2)."""
    neighbours = neighbourhood(keyframe, world)
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
    found, target = _find(world.without(point_ids, world.points_of(keyframe)), keyframe, camera, world)
    _join(found, world.rows(keyframe).start + target, world)


def _find(ids: I32, keyframe: int, camera: Camera, world: Map) -> tuple[I64, I64]:
    """Return points (M,) of those given (P,) and which of a keyframe's keypoints (M,) each is; see `find_again`."""
    table, points, rows = world.keypoints, world.points, world.rows(keyframe)
    looks = _Looks(
        points.position_m, points.normal, points.min_distance_m, points.max_distance_m, words(points.descriptors)
    )
    there = _Keypoints(
        table.px[rows], table.octave[rows], table.right_px[rows], words(table.descriptors[rows]), table.is_static[rows]
    )
    viewer = _Viewer(
        se3.inverse(world.keyframes.T_world_cam[keyframe]),
        camera.undistorted_bounds_px,
        (camera.fx, camera.fy, camera.cx, camera.cy, camera.bf),
        world.scales.factors,
        world.scales.inverse_variances,
    )
    found, target = find_again(ids, points.is_alive, looks, there, build_grid(there.px), viewer)
    return found, target


class _Looks(NamedTuple):
    """All points of the map: where they lie and from where they are seen, and descriptors as words (P, 4)."""

    position_m: F64
    normal: F64
    min_distance_m: F64
    max_distance_m: F64
    words: U64


class _Keypoints(NamedTuple):
    """The keypoints (N,) of a keyframe, with descriptors as words (N, 4); only the usable ones are found."""

    px: F32
    octave: I32
    right_px: F32
    words: U64
    usable: Bool


class _Viewer(NamedTuple):
    """The keyframe: pose (4, 4), extent of its image [px], fx, fy, cx, cy, bf; what the levels stand for (L,)."""

    T_cam_world: F64
    bounds_px: tuple[float, float, float, float]
    intrinsics: tuple[float, float, float, float, float]
    factors: F64
    inverse_variances: F64


@njit(nogil=True, cache=True)
def find_again(
    ids: I32, is_alive: Bool, looks: _Looks, there: _Keypoints, grid: Grid, viewer: _Viewer
) -> tuple[I64, I64]:
    """Find points of the map in a keyframe, each by the nearest descriptor in the window around its projection.

    What `features.projection.search_around` does, point by point without arrays between; and a match must lie where
    its point projects to, by the χ² of its level.

    Args:
        ids: The points (P,); those not alive are skipped.
        is_alive: Of all points.
        looks: All points.
        there: The keyframe's keypoints.
        grid: They, in cells.
        viewer: The keyframe.

    Returns:
        Points (M,) and the keypoint (M,) of each, one to one, in the order of `ids`.
    """
    factors = viewer.factors
    log_factor = np.log(factors[1] / factors[0]) if len(factors) > 1 else 1.0
    T = viewer.T_cam_world
    ox = -(T[0, 0] * T[0, 3] + T[1, 0] * T[1, 3] + T[2, 0] * T[2, 3])
    oy = -(T[0, 1] * T[0, 3] + T[1, 1] * T[1, 3] + T[2, 1] * T[2, 3])
    oz = -(T[0, 2] * T[0, 3] + T[1, 2] * T[1, 3] + T[2, 2] * T[2, 3])
    fx, fy, cx, cy, bf = viewer.intrinsics
    target, bits, fits = np.full(len(ids), -1, np.int64), np.empty(len(ids), np.int64), np.zeros(len(ids), np.bool_)
    for i in range(len(ids)):
        p = ids[i]
        if not is_alive[p]:
            continue
        X, Y, Z = looks.position_m[p, 0], looks.position_m[p, 1], looks.position_m[p, 2]
        z = T[2, 0] * X + T[2, 1] * Y + T[2, 2] * Z + T[2, 3]
        if z <= 0.05:
            continue
        u = fx * (T[0, 0] * X + T[0, 1] * Y + T[0, 2] * Z + T[0, 3]) / z + cx
        v = fy * (T[1, 0] * X + T[1, 1] * Y + T[1, 2] * Z + T[1, 3]) / z + cy
        x_min, y_min, x_max, y_max = viewer.bounds_px
        if u < x_min or v < y_min or u > x_max or v > y_max:
            continue
        dx, dy, dz = X - ox, Y - oy, Z - oz
        distance = np.sqrt(dx * dx + dy * dy + dz * dz)
        if distance < 0.8 * looks.min_distance_m[p] or distance > 1.2 * looks.max_distance_m[p]:
            continue
        cosine = (dx * looks.normal[p, 0] + dy * looks.normal[p, 1] + dz * looks.normal[p, 2]) / distance
        if cosine < LEAST_VIEW_COS:
            continue
        level = min(max(int(np.ceil(np.log(looks.max_distance_m[p] / distance) / log_factor)), 0), len(factors) - 1)
        expected = (np.float32(u), np.float32(v), np.float32(u - bf / z))
        at, distance_bits = _nearest(
            expected, level, np.float32(WINDOW_PX * factors[level]), looks.words, p, there, grid
        )
        if at < 0:
            continue
        target[i], bits[i] = at, distance_bits
        fits[i] = _is_at(expected, at, there, viewer.inverse_variances)
    chosen = np.flatnonzero(_own(target, bits, len(there.px)) & fits)
    return ids[chosen].astype(np.int64), target[chosen]


@njit(nogil=True, cache=True)
def _own(target: I64, bits: I64, n_targets: int) -> Bool:
    """Return which points (P,) are nearest to their target, of equals the first; a target of −1 is none."""
    owner = np.full(n_targets, -1, np.int64)
    for i in range(len(target)):
        if target[i] >= 0 and (owner[target[i]] < 0 or bits[i] < bits[owner[target[i]]]):
            owner[target[i]] = i
    own = np.zeros(len(target), np.bool_)
    for at in range(n_targets):
        if owner[at] >= 0:
            own[owner[at]] = True
    return own


@njit(nogil=True, cache=True)
def _nearest(
    expected: tuple[float, float, float],
    level: int,
    radius_px: float,
    descriptors: U64,
    point: int,
    there: _Keypoints,
    grid: Grid,
) -> tuple[int, int]:
    """Return the usable keypoint with the nearest descriptor in a window, and its distance; −1 where none is near."""
    x, y, right = expected
    origin_px, shape, start, order = grid
    c0 = max(0, int(np.floor((x - radius_px - origin_px[0]) / CELL_PX)))
    c1 = min(shape[1] - 1, int(np.floor((x + radius_px - origin_px[0]) / CELL_PX)))
    r0 = max(0, int(np.floor((y - radius_px - origin_px[1]) / CELL_PX)))
    r1 = min(shape[0] - 1, int(np.floor((y + radius_px - origin_px[1]) / CELL_PX)))
    best, at = NEAR_BITS + 1, -1
    if c1 < c0:
        return at, best
    for row in range(r0, r1 + 1):
        for k in range(start[row * shape[1] + c0], start[row * shape[1] + c1 + 1]):
            i = order[k]
            if abs(there.px[i, 0] - x) > radius_px or abs(there.px[i, 1] - y) > radius_px:
                continue
            if not there.usable[i] or there.octave[i] < level - 1 or there.octave[i] > level:
                continue
            if right >= 0 and there.right_px[i] >= 0 and abs(right - there.right_px[i]) > radius_px:
                continue
            bits = hamming(descriptors, point, there.words, i)
            if bits < best:
                best, at = bits, i
    return at, best


@njit(nogil=True, cache=True)
def _is_at(expected: tuple[float, float, float], at: int, there: _Keypoints, inverse_variances: F64) -> bool:
    """Return whether a keypoint lies where a point is expected, by its level's χ²."""
    u, v, right = expected
    right_px = there.right_px[at]
    e_u, e_v = u - there.px[at, 0], v - there.px[at, 1]
    error2 = e_u * e_u + e_v * e_v
    if right_px >= 0:
        error2 += (right - right_px) * (right - right_px)
    chi2 = np.float32(error2 * inverse_variances[there.octave[at]])
    return bool(chi2 <= (_CHI2_3D if right_px >= 0 else _CHI2_2D))


def _join(ids: I64, rows: I64, world: Map) -> None:
    """Let rows (M,) of one keyframe observe points (M,), or join these with those that the rows see, each once."""
    other = world.keypoints.point[rows]
    fresh = other < 0
    world.observe(ids[fresh], rows[fresh])
    if fresh.all():
        return
    ids, other = ids[~fresh], other[~fresh]
    weaker = world.points.n_observations[ids] <= world.points.n_observations[other]
    world.replace_points(np.where(weaker, ids, other), np.where(weaker, other, ids))
