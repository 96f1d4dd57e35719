"""The large planes of an organised cloud: walls, floor, table tops. Nothing is sampled at random."""

import math
from dataclasses import dataclass, field

import cv2
import numpy as np

from stillroom.bounds import bounded
from stillroom.geometry.arrays import F32, F64, I16, I32, U8, U16
from stillroom.geometry.cloud.continuation import Reach, continue_planes, give_samples, planes_of_cells
from stillroom.geometry.cloud.plane_fit import (
    cell_misfits,
    cell_sums,
    extent,
    grow_regions,
    layers_of,
    mark_mostly,
    mark_near,
    mark_on,
    merge_regions,
    plane_misfits,
    renumber,
    share_beyond,
    straighten,
)

NO_PLANE = -1
MERGE = 1.5  # times the misfit of one region: two of them on a wall that the camera distorts
GROWN_SHARE = 0.4  # of a plane's area, at least, is whole cells of it
MIN_CELLS = 5
N_PIECES = 3  # of a plane that are examined, largest first


@dataclass(frozen=True)
class PlaneLimits:
    """What counts as a plane.

    Attributes:
        cell: Edge of the cells that planes are grown from [samples].
        max_misfit: Largest misfit of a cell to its plane, in inverse depth [1/m]; Kinect noise is about 0.0016 there.
        tolerance: Largest misfit of a sample on a plane [1/m].
        max_bend: How far the camera may distort a plane [1/m].
        max_off, max_step, max_turn_rad: A flat cell next to a plane continues it when it lies no further off than the
            first and no further than the second from the cell that it is next to [1/m], and is turned no more [rad].
        window: Edge of the window of samples that must mostly lie on the plane for its centre to [samples].
        min_share: How much of the window must.
        min_area_m2: Smallest area seen of one piece of a plane; a carried board or a back stays with the clusters.
        min_piece_m2: The same for a plane that bounds the room, if all its pieces are as large as the other says.
        max_beyond: A plane bounds the room when no more than this share of the image lies behind it or is not known.
        min_width_m: Smallest width of that piece [m]; an upright person is flat, but narrow.
    """

    cell: int = bounded(5, least=1)
    max_misfit: float = 0.004
    tolerance: float = bounded(0.005, above=0)
    max_bend: float = 0.006
    max_off: float = 0.02
    max_step: float = 0.005
    max_turn_rad: float = 0.4
    window: int = bounded(5, least=1)
    min_share: float = 0.75
    min_area_m2: float = 0.5
    min_piece_m2: float = 0.15
    max_beyond: float = 0.25
    min_width_m: float = 0.5


@dataclass(frozen=True)
class Planes:
    """Q planes, largest first, and the samples on them.

    Attributes:
        coefficients: Unit normal towards the camera and offset (Q, 4), n·p + d = 0 [m, camera frame].
        area_m2: Area seen of each (Q,) [m²].
        plane_of: Plane of each sample (h, w), −1 for none.
    """

    coefficients: F32
    area_m2: F32
    plane_of: I16 = field(repr=False)


def find_planes(points_m: F32, ray_area: float, limits: PlaneLimits) -> Planes:
    """Find the large planes of an organised cloud (OC-SLAM 2.5: planar model segmentation).

    Cells that lie on one plane are grown into regions, regions on one plane (a wall to the left and to the right of a
    person) are merged, and samples are given to the planes that are large enough.

    Args:
        points_m: Points (h, w, 3) [m, camera frame]; z = 0 where unknown.
        ray_area: Area of one sample's pixel on the plane z = 1.
        limits: What counts as a plane.
    """
    shape, size = points_m.shape[:2], (limits.window, limits.window)
    layers = layers_of(points_m.reshape(-1, 3))
    n_known = _count((layers[2] > 0).view(np.uint8), shape, size)
    plane_of = np.full(shape, NO_PLANE, dtype=np.int16)
    kept: list[tuple[F64, float]] = []
    sums = cell_sums(points_m, limits.cell)
    misfits = cell_misfits(sums, max(4, (3 * limits.cell * limits.cell) // 5))
    for slope in _candidates(sums, misfits, ray_area, limits):
        off = _misfits(layers, slope, limits)
        on_plane = _samples_on(off, n_known, plane_of, limits)
        area_m2 = _area_if_large(layers, off, on_plane, slope, ray_area, limits)
        if area_m2 is not None:
            np.putmask(plane_of, on_plane.view(np.bool_), len(kept))
            kept.append((slope, area_m2))
    if kept:
        slopes = np.array([slope for slope, _ in kept])
        of_cell = planes_of_cells(points_m, plane_of, limits.cell, len(kept))
        reach = Reach(limits.max_misfit, limits.max_off, limits.max_step, math.cos(limits.max_turn_rad))
        added = continue_planes(sums, misfits, slopes, of_cell, reach)
        give_samples(points_m, sums, added, limits.cell, limits.tolerance, plane_of)
    return _sorted(kept, plane_of)


def _candidates(sums: F64, misfits: F64, ray_area: float, limits: PlaneLimits) -> list[F64]:
    """Return a, b, c of the regions of cells that may be planes, merged, largest first."""
    flat = np.flatnonzero(misfits <= limits.max_misfit).astype(np.int32)
    seeds = flat[np.argsort(misfits.ravel()[flat], kind="stable")]
    _, totals = grow_regions(sums, misfits, seeds, limits.max_misfit)
    min_samples = MIN_CELLS * limits.cell * limits.cell
    slopes, n, z_m = merge_regions(totals, min_samples, MERGE * limits.max_misfit)
    # About the area of the cells: z³ · |a, b, c| is that of a unit of the plane z = 1.
    area_m2 = n * ray_area * np.linalg.norm(slopes, axis=1) * z_m**3
    order = np.argsort(-n, kind="stable")
    return list(slopes[order[area_m2[order] >= GROWN_SHARE * limits.min_area_m2]])


def _samples_on(off: F32, n_known: U16, plane_of: I16, limits: PlaneLimits) -> U8:
    """Return which samples (h, w) lie on a plane together with what is around them, 1 or 0.

    A surface that crosses the plane is near it in a narrow strip only, which a window over the strip tells.

    Args:
        off: Their misfits (h·w,) [1/m].
        n_known: How many around each are known (h·w,).
        plane_of: Planes found before (h, w); these samples are not given away again.
        limits: What counts as a plane.
    """
    size, shape = (limits.window, limits.window), plane_of.shape
    near = mark_near(off, np.float32(limits.tolerance))
    n_near = _count(near, shape, size)
    core = mark_mostly(near, n_near, n_known, np.float32(limits.min_share), limits.window // 2 + 1)
    around = cv2.dilate(core.reshape(shape), np.ones(size, np.uint8)).ravel()
    on_plane = mark_on(near, around, off, np.float32(2.0 * limits.tolerance), plane_of.ravel())
    return np.asarray(on_plane.reshape(shape), dtype=np.uint8)


def _misfits(layers: F32, slope: F64, limits: PlaneLimits) -> F32:
    """Return the misfits (h·w,) [1/m] of samples to a plane, less what a wide parabola explains of the small ones.

    A depth camera distorts walls, most towards the corners of the image; no person is flat enough to be affected.
    """
    off = plane_misfits(layers, slope)
    straighten(layers, off, limits.tolerance, limits.max_bend)
    return np.asarray(off, dtype=np.float32)


def _count(mask: U8, shape: tuple[int, int], size: tuple[int, int]) -> U16:
    """Return how many of the samples (h·w,) in a window around each are 1 (h·w,)."""
    image = mask.reshape(shape)
    counts = cv2.boxFilter(image, cv2.CV_16U, size, normalize=False, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(counts.ravel(), dtype=np.uint16)


def _area_if_large(
    layers: F32, off: F32, on_plane: U8, slope: F64, ray_area: float, limits: PlaneLimits
) -> float | None:
    """Return the area [m²] of a plane's samples (h, w), or None where they are too small.

    They must be large enough in one piece or, of floor and walls, in several.

    The backs of two people who walk abreast lie on one plane, but not in one piece, and the room is seen behind them.
    Behind floor and walls nothing is seen, and people may leave only pieces of them visible.

    Args:
        layers: Samples (5, h·w) [m].
        off: Misfits of the samples to the plane (h·w,) [1/m]; infinite where unknown.
        on_plane: Samples on it (h, w).
        slope: Its a, b, c.
        ray_area: Area of one sample's pixel on the plane z = 1.
        limits: What is large enough.
    """
    rows, columns = on_plane.shape
    steepness = float(np.linalg.norm(slope))
    area, width_m = extent(layers, on_plane, 1, (0, 0, columns, rows), steepness)
    if area * ray_area < limits.min_area_m2 or width_m < limits.min_width_m:
        return None
    # Unknown depth may or may not be behind the plane.
    beyond = share_beyond(off, np.float32(limits.max_off))
    least_m2 = limits.min_area_m2 if beyond > limits.max_beyond else limits.min_piece_m2
    least_width_m = limits.min_width_m * math.sqrt(least_m2 / limits.min_area_m2)
    _, piece_of, boxes, _ = cv2.connectedComponentsWithStats(on_plane, connectivity=8, ltype=cv2.CV_16U)
    for piece in (np.argsort(-boxes[1:, cv2.CC_STAT_AREA], kind="stable")[:N_PIECES] + 1).tolist():
        of_piece, width_m = extent(layers, piece_of, piece, tuple(boxes[piece, :4].tolist()), steepness)
        if of_piece * ray_area >= least_m2 and width_m >= least_width_m:
            return float(area * ray_area)
    return None


def _sorted(kept: list[tuple[F64, float]], plane_of: I16) -> Planes:
    """Return the planes, largest first, as n·p + d = 0 with the camera on the positive side."""
    area_m2 = np.array([area for _, area in kept], dtype=np.float32)
    order: I32 = np.argsort(-area_m2, kind="stable").astype(np.int32)
    slopes = np.array([slope for slope, _ in kept], dtype=np.float64).reshape(-1, 3)
    norm = np.linalg.norm(slopes, axis=1, keepdims=True)
    # (a, b, c)·p = 1; turned round, the origin is on the positive side.
    coefficients = np.hstack((-slopes, np.ones_like(norm))) / norm
    renumber(np.argsort(order), plane_of.ravel())
    return Planes(coefficients[order].astype(np.float32), area_m2[order], plane_of)
