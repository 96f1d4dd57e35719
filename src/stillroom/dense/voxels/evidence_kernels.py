"""Scores of voxels from depth rays: hit, passed, or unknown. A voxel that is passed too often is removed."""

from typing import NamedTuple

import numpy as np

from stillroom.compiled import njit
from stillroom.dense.voxels.fusing_kernels import BLOCK, FINE, PLACE, SCORE, VOIDED_AT, WEIGHT
from stillroom.dense.voxels.hash_kernels import AXIS_BITS, AXIS_MASK, HALF
from stillroom.geometry.arrays import F32, F64, I32, I64, U8, U16, Bool
from stillroom.geometry.camera import Lens
from stillroom.geometry.distortion import distorted

NOTHING, HIT, PASSED = 0, 1, 2


class SmallDepthView(NamedTuple):
    """A small depth image, and where it was taken.

    Attributes:
        T_cam_world: Its pose (4, 4).
        lens: Of the whole image.
        views: Of each pixel (h, w, 3): its depth, odd where it is dynamic, 0 where unknown; the nearest and the
            farthest depth of it and its eight neighbours, 0 where all are unknown.
    """

    T_cam_world: F64
    lens: Lens
    views: U16


class Seeing(NamedTuple):
    """How small depth images are read.

    Attributes:
        unit_m: One unit of depth.
        stride: Of the small image.
        tolerance_m, share: Depths agree within the larger of the first and this share of the depth.
    """

    unit_m: float
    stride: int
    tolerance_m: float
    share: float


class Scoring(NamedTuple):
    """What a hit counts, where a pass counts 1; and the lowest and highest score."""

    hit: int
    lowest: int
    highest: int


class VoxelColumns(NamedTuple):
    """Keys (N,) and columns of the rows of a map, and the edge of its voxels [m]."""

    key: I64
    rows: I32
    voxel_m: float


@njit(nogil=True, cache=True, error_model="numpy")
def position(key: int, row: int, rows: I32, voxel_m: float) -> tuple[float, float, float]:
    """Return the mean position [m, world] of a voxel with weight: its corner and the mean inside it."""
    scale = 1.0 / (FINE * rows[row, WEIGHT])
    half_step = 0.5 / FINE
    x = (((key >> (2 * AXIS_BITS)) & AXIS_MASK) - HALF) + rows[row, PLACE] * scale + half_step
    y = (((key >> AXIS_BITS) & AXIS_MASK) - HALF) + rows[row, PLACE + 1] * scale + half_step
    z = ((key & AXIS_MASK) - HALF) + rows[row, PLACE + 2] * scale + half_step
    return x * voxel_m, y * voxel_m, z * voxel_m


@njit(nogil=True, cache=True, error_model="numpy")
def look(X: float, Y: float, Z: float, view: SmallDepthView, seeing: Seeing) -> int:
    """Return what a small depth image shows at a point of the world [m]: NOTHING, HIT or PASSED."""
    T, views, unit_m = view.T_cam_world, view.views, seeing.unit_m
    z = T[2, 0] * X + T[2, 1] * Y + T[2, 2] * Z + T[2, 3]
    if z <= 0.1:
        return NOTHING
    inverse = 1.0 / z
    x = (T[0, 0] * X + T[0, 1] * Y + T[0, 2] * Z + T[0, 3]) * inverse
    y = (T[1, 0] * X + T[1, 1] * Y + T[1, 2] * Z + T[1, 3]) * inverse
    r2 = x * x + y * y
    if r2 > 4.0:
        return NOTHING
    u, v = distorted(view.lens, x, y)
    if not (u >= -0.5 and v >= -0.5):
        return NOTHING
    height, width = views.shape[:2]
    finer = 1.0 / seeing.stride
    if u * finer >= width or v * finer >= height:
        return NOTHING
    column, row = min(int(u * finer + 0.5), width - 1), min(int(v * finer + 0.5), height - 1)
    units = views[row, column, 0]
    if units == 0:
        return NOTHING
    tolerance = max(seeing.tolerance_m, seeing.share * z)
    nearest, farthest = views[row, column, 1], views[row, column, 2]
    if nearest * unit_m > z + tolerance:
        return PASSED
    if _is_surface(units, z, unit_m, tolerance):
        return HIT
    if _is_surface(nearest, z, unit_m, tolerance) or _is_surface(farthest, z, unit_m, tolerance):
        return HIT
    return NOTHING


@njit(nogil=True, cache=True, error_model="numpy")
def _is_surface(units: int, z: float, unit_m: float, tolerance: float) -> bool:
    """Return whether a pixel shows a static surface at a depth."""
    return units & 1 == 0 and abs(units * unit_m - z) <= tolerance


@njit(nogil=True, cache=True, error_model="numpy")
def judge_in_view(
    is_near: Bool, voxels: VoxelColumns, now: int, view: SmallDepthView, seeing: Seeing, scoring: Scoring
) -> int:
    """Score all voxels with weight in the blocks (B,) that are near by a depth image; return how many were voided.

    A hit raises a voxel's score, a pass lowers it, both within limits. A pass at the lower limit voids the voxel.

    Args:
        is_near: Of each block.
        voxels: All of the map; scores are written.
        now: Time that voided voxels are marked with.
        view, seeing: The image and how it is read.
        scoring: What it counts.
    """
    n_voided, rows = 0, voxels.rows
    for i in range(len(voxels.key)):
        if rows[i, WEIGHT] == 0 or not is_near[rows[i, BLOCK]]:
            continue
        X, Y, Z = position(voxels.key[i], i, rows, voxels.voxel_m)
        answer = look(X, Y, Z, view, seeing)
        score = rows[i, SCORE]
        if answer == HIT:
            rows[i, SCORE] = min(scoring.highest, score + scoring.hit)
        elif answer == PASSED:
            if score > scoring.lowest:
                rows[i, SCORE] = score - 1
            else:
                for k in range(SCORE):
                    rows[i, k] = 0
                rows[i, VOIDED_AT] = now
                n_voided += 1
    return n_voided


@njit(nogil=True, cache=True, error_model="numpy")
def judge_rows(
    chosen: I32, positions_m: F32, rows: I32, view: SmallDepthView, seeing: Seeing, scoring: Scoring, heard: Bool
) -> None:
    """Score chosen rows (M,) at positions (M, 3) by a depth image, and mark those that it hit or passed (M,).

    Nothing is voided. The other arguments are those of `judge_in_view`.
    """
    for i in range(len(chosen)):
        X, Y, Z = positions_m[i]
        answer = look(X, Y, Z, view, seeing)
        row = chosen[i]
        heard[i] |= answer != NOTHING
        if answer == HIT:
            rows[row, SCORE] = min(scoring.highest, rows[row, SCORE] + scoring.hit)
        elif answer == PASSED:
            rows[row, SCORE] = max(scoring.lowest, rows[row, SCORE] - 1)


@njit(nogil=True, cache=True, error_model="numpy")
def answers(positions_m: F32, view: SmallDepthView, seeing: Seeing) -> U8:
    """Return what a depth image shows at points (M, 3) [m, world], (M,); see `look`."""
    said = np.empty(len(positions_m), dtype=np.uint8)
    for i in range(len(positions_m)):
        X, Y, Z = positions_m[i]
        said[i] = look(X, Y, Z, view, seeing)
    return said


@njit(nogil=True, cache=True, error_model="numpy")
def rows_in(chosen: Bool, rows: I32) -> I32:
    """Return which rows with weight (M,) lie in chosen blocks (B,)."""
    found = np.empty(len(rows), dtype=np.int32)
    n = 0
    for i in range(len(rows)):
        if chosen[rows[i, BLOCK]] and rows[i, WEIGHT] > 0:
            found[n] = i
            n += 1
    return found[:n].copy()


@njit(nogil=True, cache=True, error_model="numpy")
def mean_positions(chosen: I32, row_key: I64, rows: I32, voxel_m: float) -> F32:
    """Return the mean positions (M, 3) float32 [m, world] of chosen rows (M,), which have weight."""
    positions_m = np.empty((len(chosen), 3), dtype=np.float32)
    for i in range(len(chosen)):
        row = chosen[i]
        X, Y, Z = position(row_key[row], row, rows, voxel_m)
        positions_m[i, 0], positions_m[i, 1], positions_m[i, 2] = X, Y, Z
    return positions_m


@njit(nogil=True, cache=True, error_model="numpy")
def count_in_view(points_m: F32, T_cam_world: F64, lens: Lens, width: int, height: int, far_m: float) -> I64:
    """Count for each camera (C, 4, 4) how many points (M, 3) [m, world] lie in its image, nearer than `far_m`."""
    counts = np.zeros(len(T_cam_world), dtype=np.int64)
    for c in range(len(T_cam_world)):
        T = T_cam_world[c]
        for i in range(len(points_m)):
            X, Y, Z = points_m[i]
            z = T[2, 0] * X + T[2, 1] * Y + T[2, 2] * Z + T[2, 3]
            if not 0.1 < z < far_m:
                continue
            u = lens.fx * (T[0, 0] * X + T[0, 1] * Y + T[0, 2] * Z + T[0, 3]) / z + lens.cx
            v = lens.fy * (T[1, 0] * X + T[1, 1] * Y + T[1, 2] * Z + T[1, 3]) / z + lens.cy
            counts[c] += 0.0 <= u < width and 0.0 <= v < height
    return counts
