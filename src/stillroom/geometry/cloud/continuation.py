"""Growing a plane beyond its tolerance, where the camera distorts it or the floor is uneven: cell by cell, smoothly.

A person in front of a wall is a depth step away, and legs on a floor are upright: neither continues the plane.
"""

import math
from typing import NamedTuple

import numpy as np

from stillroom.compiled import njit
from stillroom.geometry.arrays import F32, F64, I16
from stillroom.geometry.cloud.plane_fit import fit


@njit(nogil=True, cache=True)
def planes_of_cells(points: F32, plane_of: I16, cell: int, n_planes: int) -> I16:
    """Return the plane that most known samples of each cell lie on (h // cell, w // cell), −1 for none.

    Args:
        points: Points (h, w, 3) [m]; z = 0 where unknown.
        plane_of: Plane of each sample (h, w), −1 for none.
        cell: Edge of a cell [samples].
        n_planes: Number of planes.
    """
    rows, columns = points.shape[0] // cell, points.shape[1] // cell
    mostly = np.full((rows, columns), -1, dtype=np.int16)
    counts = np.zeros(n_planes + 1, dtype=np.int64)
    for i in range(rows):
        for j in range(columns):
            counts[:] = 0
            n_known = 0
            for r in range(i * cell, (i + 1) * cell):
                for c in range(j * cell, (j + 1) * cell):
                    if points[r, c, 2] > 0.0:
                        n_known += 1
                        counts[plane_of[r, c] + 1] += 1
            for p in range(n_planes):
                if 2 * counts[p + 1] > n_known:
                    mostly[i, j] = p
    return mostly


class Reach(NamedTuple):
    """How far a plane may be grown.

    Attributes:
        max_misfit: Largest misfit of a cell's own plane [1/m].
        max_off: Largest distance of a cell from the plane, in inverse depth [1/m].
        max_step: Largest difference of neighbouring cells in that [1/m].
        cosine: Least cosine between a cell's normal and the plane's.
    """

    max_misfit: float
    max_off: float
    max_step: float
    cosine: float


@njit(nogil=True, cache=True)
def continue_planes(
    sums: F64,
    misfits: F64,
    slopes: F64,
    of_cell: I16,
    reach: Reach,
) -> I16:
    """Grow planes over flat neighbouring cells that are turned like them, and a small step off.

    Args:
        sums: Sums of the cells (rows, columns, 10); see `plane_fit`.
        misfits: Misfit of each cell's own plane (rows, columns) [1/m].
        slopes: a, b, c of the planes (Q, 3).
        of_cell: Plane of each cell (rows, columns), −1 for none; written to.
        reach: Limits on a cell.

    Returns:
        Plane of the cells that were added (rows, columns), −1 for the others.
    """
    max_misfit, max_off, max_step, cosine = reach
    rows, columns = of_cell.shape
    added = np.full((rows, columns), -1, dtype=np.int16)
    off = np.zeros((rows, columns))
    queue = np.empty(rows * columns, dtype=np.int32)
    tail = 0
    own = np.zeros(3)
    for i in range(rows):
        for j in range(columns):
            if of_cell[i, j] >= 0:
                a, b, c = slopes[of_cell[i, j]]
                s = sums[i, j]
                off[i, j] = (s[6] - a * s[1] - b * s[2]) / s[0] - c
                queue[tail] = i * columns + j
                tail += 1
    head = 0
    while head < tail:
        i, j = queue[head] // columns, queue[head] % columns
        head += 1
        slope = slopes[of_cell[i, j]]
        steepness = math.sqrt(slope[0] ** 2 + slope[1] ** 2 + slope[2] ** 2)
        for di, dj in ((0, 1), (1, 0), (0, -1), (-1, 0)):
            k, m = i + di, j + dj
            if k < 0 or m < 0 or k >= rows or m >= columns or of_cell[k, m] >= 0 or misfits[k, m] > max_misfit:
                continue
            s = sums[k, m]
            away = (s[6] - slope[0] * s[1] - slope[1] * s[2]) / s[0] - slope[2]
            fit(s, own)
            length = math.sqrt(own[0] ** 2 + own[1] ** 2 + own[2] ** 2)
            along = own[0] * slope[0] + own[1] * slope[1] + own[2] * slope[2]
            if abs(away) <= max_off and abs(away - off[i, j]) <= max_step and along >= cosine * length * steepness:
                of_cell[k, m], added[k, m], off[k, m] = of_cell[i, j], of_cell[i, j], away
                queue[tail] = k * columns + m
                tail += 1
    return added


@njit(nogil=True, cache=True)
def give_samples(points: F32, sums: F64, added: I16, cell: int, tolerance: float, plane_of: I16) -> None:
    """Give the samples in and closely around the added cells to their plane, where they lie on the cell's own.

    Args:
        points: Points (h, w, 3) [m]; z = 0 where unknown.
        sums: Sums of the cells (rows, columns, 10).
        added: Plane of the added cells (rows, columns), −1 for the others.
        cell: Edge of a cell [samples]; half of it is looked at around.
        tolerance: Largest misfit of a sample [1/m].
        plane_of: Plane of each sample (h, w), written to.
    """
    own = np.zeros(3)
    margin = cell // 2
    for i in range(added.shape[0]):
        for j in range(added.shape[1]):
            if added[i, j] < 0:
                continue
            fit(sums[i, j], own)
            for r in range(max(i * cell - margin, 0), min((i + 1) * cell + margin, points.shape[0])):
                for c in range(max(j * cell - margin, 0), min((j + 1) * cell + margin, points.shape[1])):
                    z = points[r, c, 2]
                    if z > 0.0 and plane_of[r, c] < 0:
                        expected = (own[0] * points[r, c, 0] + own[1] * points[r, c, 1]) / z + own[2]
                        if abs(1.0 / z - expected) <= tolerance:
                            plane_of[r, c] = added[i, j]
