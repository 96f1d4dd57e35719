"""New points of a keyframe: from its depth at once, by triangulation with its neighbours later."""

import math
from typing import NamedTuple

import numpy as np

from stillroom.compiled import njit
from stillroom.data.map import Map
from stillroom.data.result import Tracked
from stillroom.features.matching import Targets, search_epipolar
from stillroom.geometry import se3
from stillroom.geometry.arrays import F32, F64, I32, I64, Bool
from stillroom.geometry.camera import Camera
from stillroom.geometry.epipolar import fundamental_from_motion, triangulate
from stillroom.optimize.observations import to_camera

MIN_NEAREST = 100
"""A keyframe makes at least this many points from depth, however far (ORB-SLAM2)."""
_CHI2_2D, _CHI2_3D = 5.991, 7.815
_LARGEST_COSINE = 0.9998
_SHORTEST = 0.01
"""Baseline that tells depth, as a share of the scene's median depth."""


def from_depth(keyframe: int, tracked: Tracked, close_depth_m: float, world: Map) -> I32:
    """Create points from static keypoints with depth that have none yet: all close ones, and the nearest 100.

    The first keyframe of a sub-map creates all it can (ORB-SLAM2: StereoInitialization): there is no other map yet.

    Args:
        keyframe: The keyframe that the frame became.
        tracked: The frame.
        close_depth_m: Depth up to which stereo is precise.
        world: Receives the points.

    Returns:
        Their ids.
    """
    keypoints, start = tracked.frame.keypoints, world.rows(keyframe).start
    static = world.keypoints.is_static[world.rows(keyframe)]
    candidates = np.flatnonzero((keypoints.depth_m > 0) & static)
    candidates = candidates[np.argsort(keypoints.depth_m[candidates], kind="stable")]
    n_close = int((keypoints.depth_m[candidates] < close_depth_m).sum())
    if world.keyframes.parent[keyframe] >= 0:
        candidates = candidates[: max(n_close, MIN_NEAREST)]
    free = candidates[world.points_of(keyframe)[candidates] < 0]
    points_cam = tracked.frame.camera.back_project(keypoints.px[free], keypoints.depth_m[free])
    return world.add_points(se3.transform(world.keyframes.T_world_cam[keyframe], points_cam), start + free)


def by_triangulation(keyframe: int, neighbours: list[int], camera: Camera, world: Map) -> I32:
    """Make points of static keypoints that this keyframe and a neighbour both see and that have no point yet.

    Where parallax is smaller than that of depth, depth is used (ORB-SLAM2: CreateNewMapPoints).
    """
    made = [np.zeros(0, dtype=np.int32)]
    centre = world.keyframes.T_world_cam[keyframe, :3, 3]
    for neighbour in neighbours:
        if np.linalg.norm(world.keyframes.T_world_cam[neighbour, :3, 3] - centre) < shortest(neighbour, camera, world):
            continue
        first, second = _search(keyframe, neighbour, camera, world)
        if len(first) == 0:
            continue
        positions_m, good = _locate(first, second, camera, world)
        new = world.add_points(positions_m[good], first[good])
        world.observe(new, second[good])
        made.append(new)
    ids = np.concatenate(made)
    world.refresh(ids)
    return ids


def shortest(neighbour: int, camera: Camera, world: Map) -> float:
    """Return the shortest baseline with a neighbour that tells depth (ORB-SLAM2).

    That of the camera, below which measured depth is better; with a single camera a share of the scene's median depth,
    infinite where the neighbour sees nothing.
    """
    if world.sensor.is_metric:
        return camera.baseline_m
    seen = world.points_of(neighbour)
    T_cam_world = se3.inverse(world.keyframes.T_world_cam[neighbour])
    depths = world.points.position_m[seen[seen >= 0]] @ T_cam_world[2, :3] + T_cam_world[2, 3]
    return _SHORTEST * float(np.median(depths)) if len(depths) else np.inf


def _search(keyframe: int, neighbour: int, camera: Camera, world: Map) -> tuple[I64, I64]:
    """Return rows (M,) of the keyframe and rows of the neighbour that match along epipolar lines."""
    T_neighbour_world = se3.inverse(world.keyframes.T_world_cam[neighbour])
    T_neighbour_keyframe = T_neighbour_world @ world.keyframes.T_world_cam[keyframe]
    F = fundamental_from_motion(T_neighbour_keyframe, camera.K)
    # The keyframe's centre seen from the neighbour; behind it or in its plane there is no epipole to avoid.
    tx, ty, tz = T_neighbour_keyframe[:3, 3]
    epipole_px = (
        np.array([camera.fx * tx / tz + camera.cx, camera.fy * ty / tz + camera.cy])
        if abs(tz) > 1e-6
        else np.full(2, 1e9)
    )
    rows, others = world.rows(keyframe), world.rows(neighbour)
    first, second = search_epipolar(
        F, _free_targets(rows, world), _free_targets(others, world), world.scales.factors, epipole_px
    )
    return rows.start + first.astype(np.int64), others.start + second.astype(np.int64)


def _free_targets(rows: slice, world: Map) -> Targets:
    table = world.keypoints
    usable = (table.point[rows] < 0) & table.is_static[rows]
    return Targets(table.px[rows], table.octave[rows], table.right_px[rows], table.descriptors[rows], usable)


def _locate(first: I64, second: I64, camera: Camera, world: Map) -> tuple[F64, Bool]:
    """Return positions (M, 3) [m, world] of matched rows and which of them are reliable."""
    table, keyframes = world.keypoints, world.keyframes
    T_world_first = keyframes.T_world_cam[table.keyframe[first[0]]]
    T_world_second = keyframes.T_world_cam[table.keyframe[second[0]]]
    T_first_world, T_second_world = se3.inverse(T_world_first), se3.inverse(T_world_second)
    seen = _Seen(table.px, table.depth_m, table.right_px, table.octave)
    intrinsics = (camera.fx, camera.fy, camera.cx, camera.cy, camera.bf)
    way = choose_ways(first, second, seen, T_world_first, T_world_second, intrinsics)
    positions_m = np.zeros((len(first), 3))
    rays = way == BY_RAYS
    positions_m[rays] = triangulate(
        T_first_world, T_second_world, _rays(first[rays], camera, world), _rays(second[rays], camera, world)
    )
    for chosen, rows, T_world_cam in (
        (way == BY_FIRST, first, T_world_first),
        (way == BY_SECOND, second, T_world_second),
    ):
        points_cam = camera.back_project(table.px[rows[chosen]], table.depth_m[rows[chosen]])
        positions_m[chosen] = se3.transform(T_world_cam, points_cam)
    good = np.isfinite(positions_m).all(axis=1) & (way != BY_NOTHING)
    positions_m[~good] = 0.0
    check(positions_m, first, seen, T_first_world, intrinsics, world.scales.inverse_variances, good)
    check(positions_m, second, seen, T_second_world, intrinsics, world.scales.inverse_variances, good)
    slack = 1.5 * world.scales.factor
    check_scales(
        positions_m,
        table.octave[first],
        table.octave[second],
        T_world_first,
        T_world_second,
        world.scales.factors,
        slack,
        good,
    )
    return positions_m, good


def _rays(rows: I64, camera: Camera, world: Map) -> F64:
    return camera.back_project(world.keypoints.px[rows], np.ones(len(rows)))[:, :2]


BY_NOTHING, BY_RAYS, BY_FIRST, BY_SECOND = 0, 1, 2, 3
"""How a point is located: not at all, by triangulation, by the depth of the first keypoint or of the second."""


class _Seen(NamedTuple):
    """Columns of the keypoint table."""

    px: F32
    depth_m: F32
    right_px: F32
    octave: I32


@njit(nogil=True, cache=True)
def choose_ways(
    first: I64, second: I64, seen: _Seen, T_world_first: F64, T_world_second: F64, intrinsics: tuple[float, ...]
) -> I64:
    """Return how to locate the points of matched rows (M,): by depth where that stands for the larger parallax."""
    fx, fy, cx, cy, bf = intrinsics
    ways = np.empty(len(first), np.int64)
    A, B = T_world_first, T_world_second
    for i in range(len(first)):
        px, other = seen.px[first[i]], seen.px[second[i]]
        ax, ay, bx, by = (px[0] - cx) / fx, (px[1] - cy) / fy, (other[0] - cx) / fx, (other[1] - cy) / fy
        product, aa, bb = 0.0, 0.0, 0.0
        for r in range(3):
            a = A[r, 0] * ax + A[r, 1] * ay + A[r, 2]
            b = B[r, 0] * bx + B[r, 1] * by + B[r, 2]
            product, aa, bb = product + a * b, aa + a * a, bb + b * b
        cosine = product / (math.sqrt(aa) * math.sqrt(bb))
        cosine_first = _stereo_cosine(seen.depth_m[first[i]], bf / fx)
        cosine_second = _stereo_cosine(seen.depth_m[second[i]], bf / fx)
        cosine_stereo = min(cosine_first, cosine_second)
        has_depth = cosine_stereo < 1.0
        if 0.0 < cosine < cosine_stereo and (has_depth or cosine < _LARGEST_COSINE):
            ways[i] = BY_RAYS
        elif not has_depth:
            ways[i] = BY_NOTHING
        else:
            ways[i] = BY_SECOND if cosine_second <= cosine_first else BY_FIRST
    return ways


@njit(nogil=True, cache=True)
def _stereo_cosine(depth_m: float, baseline_m: float) -> float:
    """Return the cosine of the parallax that depth stands for; above 1 where there is none."""
    return math.cos(2.0 * math.atan2(baseline_m / 2.0, depth_m)) if depth_m > 0 else 2.0


@njit(nogil=True, cache=True)
def check(
    positions_m: F64,
    rows: I64,
    seen: _Seen,
    T_cam_world: F64,
    intrinsics: tuple[float, ...],
    inverse_variances: F64,
    good: Bool,
) -> None:
    """Clear `good` (M,) where positions (M, 3) lie behind the camera or do not project to where their rows saw them."""
    fx, fy, cx, cy, bf = intrinsics
    for i in range(len(rows)):
        x, y, z = to_camera(T_cam_world, positions_m[i, 0], positions_m[i, 1], positions_m[i, 2])
        if not z > 0.0:
            good[i] = False
            continue
        u, row = fx * x / z + cx, rows[i]
        e_u, e_v = u - seen.px[row, 0], fy * y / z + cy - seen.px[row, 1]
        error2 = e_u * e_u + e_v * e_v
        has_depth = seen.right_px[row] >= 0
        if has_depth:
            error2 += (u - bf / z - seen.right_px[row]) ** 2
        good[i] &= error2 * inverse_variances[seen.octave[row]] <= (_CHI2_3D if has_depth else _CHI2_2D)


@njit(nogil=True, cache=True)
def check_scales(
    positions_m: F64,
    octave_first: I32,
    octave_second: I32,
    T_world_first: F64,
    T_world_second: F64,
    factors: F64,
    slack: float,
    good: Bool,
) -> None:
    """Clear `good` (M,) where the ratio of distances does not fit that of the levels the keypoints were found on."""
    for i in range(len(good)):
        near, far = 0.0, 0.0
        for axis in range(3):
            near += (positions_m[i, axis] - T_world_first[axis, 3]) ** 2
            far += (positions_m[i, axis] - T_world_second[axis, 3]) ** 2
        if near == 0.0 or far == 0.0:
            good[i] = False
            continue
        quotient = math.sqrt(far / near) / (factors[octave_first[i]] / factors[octave_second[i]])
        good[i] &= 1.0 / slack < quotient < slack
