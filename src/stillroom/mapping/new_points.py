"""New points of a keyframe: from its depth at once, by triangulation with its neighbours later."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from stillroom.compiled import njit
from stillroom.data.map import Map
from stillroom.data.result import Tracked
from stillroom.features.matching import Described, find_on_lines, keep_nearest
from stillroom.geometry import se3
from stillroom.geometry.arrays import F32, F64, I32, I64, U64, Bool
from stillroom.geometry.camera import Camera, Lens
from stillroom.geometry.epipolar import inverse_motion, motion_fundamental, triangulate
from stillroom.geometry.hamming import words
from stillroom.optimize.observations import to_camera

BY_NOTHING, BY_RAYS, BY_FIRST, BY_SECOND = 0, 1, 2, 3
"""How a point is located: not at all, by triangulation, by the depth of the first keypoint or of the second."""
MIN_NEAREST = 100
"""A keyframe makes at least this many points from depth, however far (ORB-SLAM2)."""
_CHI2_2D, _CHI2_3D = 5.991, 7.815
_SHORTEST = 0.01
"""Baseline that tells depth, as a share of the scene's median depth."""


@dataclass(frozen=True)
class PairLimits:
    """Which pairs of keypoints make a point.

    Attributes:
        largest_cosine: Of the parallax, where neither keypoint has a depth (ORB-SLAM2: 1.15°).
        most_turned_rad: By how much the keypoints' orientations may differ, less the camera's roll; π: by any angle.
    """

    largest_cosine: float = 0.9998
    most_turned_rad: float = math.pi


_ORB_SLAM2 = PairLimits()


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


def by_triangulation(
    keyframe: int, neighbours: list[int], camera: Camera, world: Map, limits: PairLimits = _ORB_SLAM2
) -> I32:
    """Make points of static keypoints that this keyframe and a neighbour both see and that have no point yet.

    Where parallax is smaller than that of depth, depth is used (ORB-SLAM2: CreateNewMapPoints).

    Args:
        keyframe: The keyframe.
        neighbours: Keyframes that may see the same.
        camera: The camera of all of them.
        world: Receives the points.
        limits: Which pairs make a point.

    Returns:
        Their ids.
    """
    made = [np.zeros(0, dtype=np.int32)]
    centre = world.keyframes.T_world_cam[keyframe, :3, 3]
    for neighbour in neighbours:
        if np.linalg.norm(world.keyframes.T_world_cam[neighbour, :3, 3] - centre) < shortest(neighbour, camera, world):
            continue
        first, second, positions_m = _pair(keyframe, neighbour, camera, world, limits)
        if len(first) == 0:
            continue
        new = world.add_points(positions_m, first, refresh=False)
        world.observe(new, second)
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


def _pair(keyframe: int, neighbour: int, camera: Camera, world: Map, limits: PairLimits) -> tuple[I64, I64, F64]:
    """Return rows (M,) of the keyframe and of a neighbour that see the same, and where that lies (M, 3) [m, world]."""
    table, T_world_cam = world.keypoints, world.keyframes.T_world_cam
    rows, others = world.rows(keyframe), world.rows(neighbour)
    first, second, positions_m = pair_rows(
        (rows.start, rows.stop, others.start, others.stop),
        _Table(
            table.px,
            table.depth_m,
            table.right_px,
            table.octave,
            words(table.descriptors),
            table.point,
            table.is_static,
        ),
        T_world_cam[keyframe],
        T_world_cam[neighbour],
        camera.lens,
        float(camera.bf),
        (world.scales.factors, world.scales.inverse_variances, 1.5 * world.scales.factor, limits.largest_cosine),
    )
    if limits.most_turned_rad < math.pi:
        steady = _turned_rad(first, second, keyframe, neighbour, world) < limits.most_turned_rad
        first, second, positions_m = first[steady], second[steady], positions_m[steady]
    return first, second, positions_m


def _turned_rad(first: I64, second: I64, keyframe: int, neighbour: int, world: Map) -> F64:
    """Return by how much the orientations of paired rows (M,) differ, less the roll between the keyframes [rad]."""
    T_world_cam, angle_rad = world.keyframes.T_world_cam, world.keypoints.angle_rad
    R = T_world_cam[neighbour, :3, :3].T @ T_world_cam[keyframe, :3, :3]
    roll_rad = math.atan2(R[1, 0] - R[0, 1], R[0, 0] + R[1, 1])
    off_rad = angle_rad[second].astype(np.float64) - angle_rad[first] - roll_rad
    return np.abs(np.remainder(off_rad + math.pi, 2.0 * math.pi) - math.pi)


class _Seen(NamedTuple):
    """Columns of the keypoint table."""

    px: F32
    depth_m: F32
    right_px: F32
    octave: I32


class _Table(NamedTuple):
    """More of them; descriptors as words (R, 4)."""

    px: F32
    depth_m: F32
    right_px: F32
    octave: I32
    words: U64
    point: I32
    is_static: Bool


@njit(nogil=True, cache=True)
def pair_rows(
    ranges: tuple[int, int, int, int],
    table: _Table,
    T_world_first: F64,
    T_world_second: F64,
    lens: Lens,
    bf: float,
    scales: tuple[F64, F64, float, float],
) -> tuple[I64, I64, F64]:
    """Return pairs of static rows without a point, (M,) each, and where that lies (M, 3) [m, world].

    Args:
        ranges: First and last row, less one, of the two keyframes.
        table: All rows.
        T_world_first, T_world_second: Poses T_world_cam (4, 4).
        lens, bf: The camera; distortion is not read.
        scales: Size (L,) [px] and inverse variance (L,) [1/px²] of the levels, and by which factor distances may differ
            from what levels say, and the largest cosine of a parallax.
    """
    factors, inverse_variances, slack, largest_cosine = scales
    T_first_world, T_second_world = inverse_motion(T_world_first), inverse_motion(T_world_second)
    T_second_first = np.empty((4, 4))
    for r in range(4):
        for c in range(4):
            T_second_first[r, c] = 0.0
            for k in range(4):
                T_second_first[r, c] += T_second_world[r, k] * T_world_first[k, c]
    # The keyframe's centre seen from the neighbour; behind it or in its plane there is no epipole to avoid.
    tx, ty, tz = T_second_first[0, 3], T_second_first[1, 3], T_second_first[2, 3]
    epipole_px = np.full(2, 1e9)
    if abs(tz) > 1e-6:
        epipole_px[0], epipole_px[1] = lens.fx * tx / tz + lens.cx, lens.fy * ty / tz + lens.cy
    mine, theirs = _free_rows(ranges[0], ranges[1], table), _free_rows(ranges[2], ranges[3], table)
    F = motion_fundamental(T_second_first, lens)
    target, bits = find_on_lines(F, _described(mine, table), _described(theirs, table), factors, epipole_px)
    query, found = keep_nearest(target, bits, len(theirs))
    first, second = mine[query], theirs[found]
    seen, intrinsics = (
        _Seen(table.px, table.depth_m, table.right_px, table.octave),
        (lens.fx, lens.fy, lens.cx, lens.cy, bf),
    )
    positions_m, good = locate(
        first, second, seen, (T_world_first, T_world_second, T_first_world, T_second_world), intrinsics, largest_cosine
    )
    check(positions_m, first, seen, T_first_world, intrinsics, inverse_variances, good)
    check(positions_m, second, seen, T_second_world, intrinsics, inverse_variances, good)
    octaves = table.octave[first], table.octave[second]
    check_scales(positions_m, octaves[0], octaves[1], T_world_first, T_world_second, factors, slack, good)
    return first[good], second[good], positions_m[good]


@njit(nogil=True, cache=True)
def _free_rows(start: int, stop: int, table: _Table) -> I64:
    """Return the static rows (M,) of a range that see no point."""
    rows = np.empty(stop - start, np.int64)
    n = 0
    for row in range(start, stop):
        if table.point[row] < 0 and table.is_static[row]:
            rows[n] = row
            n += 1
    return rows[:n]


@njit(nogil=True, cache=True)
def _described(rows: I64, table: _Table) -> Described:
    px = np.empty((len(rows), 2))
    for i in range(len(rows)):
        px[i, 0], px[i, 1] = table.px[rows[i], 0], table.px[rows[i], 1]
    return Described(px, table.octave[rows], table.right_px[rows], table.words[rows])


@njit(nogil=True, cache=True)
def locate(
    first: I64,
    second: I64,
    seen: _Seen,
    poses: tuple[F64, F64, F64, F64],
    intrinsics: tuple[float, ...],
    largest_cosine: float,
) -> tuple[F64, Bool]:
    """Return where matched rows see their points (M, 3) [m, world], and whether that is known (M,); else it is 0.

    Args:
        first, second: The rows of each keyframe.
        seen: All rows.
        poses: T_world_cam (4, 4) of the two, and both the other way round.
        intrinsics: fx, fy, cx, cy [px] and bf [px·m].
        largest_cosine: Of the parallax of a point without depth.
    """
    T_world_first, T_world_second, T_first_world, T_second_world = poses
    ways = choose_ways(first, second, seen, (T_world_first, T_world_second), intrinsics, largest_cosine)
    rays = np.flatnonzero(ways == BY_RAYS)
    positions_m, good = np.zeros((len(first), 3)), np.zeros(len(first), np.bool_)
    met_m = triangulate(
        T_first_world, T_second_world, _rays(first[rays], seen, intrinsics), _rays(second[rays], seen, intrinsics)
    )
    for k in range(len(rays)):
        positions_m[rays[k]] = met_m[k]
    fx, fy, cx, cy, _ = intrinsics
    for i in range(len(first)):
        if ways[i] == BY_FIRST or ways[i] == BY_SECOND:
            row, T = (first[i], T_world_first) if ways[i] == BY_FIRST else (second[i], T_world_second)
            z = float(seen.depth_m[row])
            x, y = (float(seen.px[row, 0]) - cx) / fx * z, (float(seen.px[row, 1]) - cy) / fy * z
            positions_m[i, 0], positions_m[i, 1], positions_m[i, 2] = to_camera(T, x, y, z)
        sum_m = positions_m[i, 0] + positions_m[i, 1] + positions_m[i, 2]
        good[i] = ways[i] != BY_NOTHING and np.isfinite(sum_m)
        if not good[i]:
            positions_m[i] = 0.0
    return positions_m, good


@njit(nogil=True, cache=True)
def _rays(rows: I64, seen: _Seen, intrinsics: tuple[float, ...]) -> F64:
    """Return the normalised image coordinates (M, 2) of rows (M,)."""
    fx, fy, cx, cy, _ = intrinsics
    rays = np.empty((len(rows), 2))
    for i in range(len(rows)):
        rays[i, 0] = (float(seen.px[rows[i], 0]) - cx) / fx
        rays[i, 1] = (float(seen.px[rows[i], 1]) - cy) / fy
    return rays


@njit(nogil=True, cache=True)
def choose_ways(
    first: I64,
    second: I64,
    seen: _Seen,
    T_world_cam: tuple[F64, F64],
    intrinsics: tuple[float, ...],
    largest_cosine: float,
) -> I64:
    """Return how to locate the points of matched rows (M,): by depth where that stands for the larger parallax."""
    fx, fy, cx, cy, bf = intrinsics
    ways = np.empty(len(first), np.int64)
    A, B = T_world_cam
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
        if 0.0 < cosine < cosine_stereo and (has_depth or cosine < largest_cosine):
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
