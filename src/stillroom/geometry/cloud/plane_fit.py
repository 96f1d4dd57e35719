"""Planes in inverse depth, where a depth camera's noise is the same at all distances.

A plane n·p + d = 0 seen along the ray (x, y, 1) has the inverse depth 1/z = a·x + b·y + c, with (a, b, c) = −n/d. A
Kinect's depth noise grows with the square of the depth, so that of the inverse depth is constant, and one threshold
serves near and far. Least squares need no more than ten sums of the samples, which add up: the sums of a region are
those of its cells.
"""

import math

import numpy as np

from stillroom.compiled import njit
from stillroom.geometry.arrays import F32, F64, I32, Bool

N_TERMS = 6
"""1, x, y, x², x·y, y²: a parabola over the rays."""
N_SUMS = 10
"""n, Σx, Σy, Σxx, Σxy, Σyy, Σq, Σxq, Σyq, Σqq, where q is the inverse depth."""


# Passes over an organised cloud, for one plane: the misfits of the samples, and the camera's distortion of it.


@njit(nogil=True, cache=True)
def plane_misfits(points: F32, slope: F64) -> F32:
    """Return by how much each sample is nearer than a plane, in inverse depth.

    Args:
        points: Points (h, w, 3) [m]; z = 0 where unknown.
        slope: The plane's a, b, c (3,).

    Returns:
        Misfits (h, w) [1/m]; infinite where unknown.
    """
    off = np.full(points.shape[:2], np.inf, dtype=np.float32)
    a, b, c = slope
    for i in range(points.shape[0]):
        for j in range(points.shape[1]):
            z = points[i, j, 2]
            if z > 0.0:
                off[i, j] = (1.0 - a * points[i, j, 0] - b * points[i, j, 1]) / z - c
    return off


@njit(nogil=True, cache=True)
def parabola_sums(points: F32, off: F32, limit: float) -> tuple[F64, F64, int]:
    """Return the normal equations (6, 6) and (6,) of a parabola through misfits up to a limit, and how many they are.

    Args:
        points: Points (h, w, 3) [m].
        off: Misfits (h, w) [1/m]; infinite where unknown.
        limit: Largest misfit that counts [1/m].
    """
    normal, right = np.zeros((N_TERMS, N_TERMS)), np.zeros(N_TERMS)
    t = np.ones(N_TERMS)
    n = 0
    for i in range(points.shape[0]):
        for j in range(points.shape[1]):
            if not abs(off[i, j]) <= limit:
                continue
            n += 1
            x, y = points[i, j, 0] / points[i, j, 2], points[i, j, 1] / points[i, j, 2]
            t[1], t[2], t[3], t[4], t[5] = x, y, x * x, x * y, y * y
            for k in range(N_TERMS):
                right[k] += t[k] * off[i, j]
                for m in range(k + 1):
                    normal[k, m] += t[k] * t[m]
    for k in range(N_TERMS):
        for m in range(k):
            normal[m, k] = normal[k, m]
    return normal, right, n


@njit(nogil=True, cache=True)
def unbend(points: F32, off: F32, parabola: F64, max_bend: float) -> None:
    """Subtract a parabola (6,), clipped to ± `max_bend` [1/m], from the misfits (h, w) of points (h, w, 3)."""
    p = parabola
    for i in range(points.shape[0]):
        for j in range(points.shape[1]):
            z = points[i, j, 2]
            if z > 0.0:
                x, y = points[i, j, 0] / z, points[i, j, 1] / z
                bend = p[0] + x * (p[1] + p[3] * x + p[4] * y) + y * (p[2] + p[5] * y)
                off[i, j] -= min(max(bend, -max_bend), max_bend)


@njit(nogil=True, cache=True)
def area_moments(points: F32, chosen: Bool, steepness: float) -> F64:
    """Return the area of a plane's samples, and its first and second moments.

    Args:
        points: Points (h, w, 3) [m].
        chosen: The plane's samples (h, w).
        steepness: Length of the plane's (a, b, c): z³ times it is the area of a unit of the plane z = 1.

    Returns:
        Σw, Σwx, Σwy, Σwz, Σwxx, Σwxy, Σwxz, Σwyy, Σwyz, Σwzz (10,) with w the area of a sample in rays.
    """
    s = np.zeros(10)
    for i in range(points.shape[0]):
        for j in range(points.shape[1]):
            if chosen[i, j]:
                x, y, z = np.float64(points[i, j, 0]), np.float64(points[i, j, 1]), np.float64(points[i, j, 2])
                w = z * z * z * steepness
                s[0] += w
                s[1] += w * x
                s[2] += w * y
                s[3] += w * z
                s[4] += w * x * x
                s[5] += w * x * y
                s[6] += w * x * z
                s[7] += w * y * y
                s[8] += w * y * z
                s[9] += w * z * z
    return s


@njit(nogil=True, cache=True)
def cell_sums(points: F32, cell: int) -> F64:
    """Return the sums of square cells of an organised cloud.

    Args:
        points: Points (h, w, 3) [m]; z = 0 where unknown.
        cell: Edge of a cell [samples]; samples beyond the last whole cell are left out.

    Returns:
        Sums (h // cell, w // cell, 10).
    """
    rows, columns = points.shape[0] // cell, points.shape[1] // cell
    sums = np.zeros((rows, columns, N_SUMS))
    for i in range(rows * cell):
        for j in range(columns * cell):
            z = points[i, j, 2]
            if z <= 0.0:
                continue
            q = 1.0 / z
            x, y = points[i, j, 0] * q, points[i, j, 1] * q
            s = sums[i // cell, j // cell]
            s[0] += 1.0
            s[1] += x
            s[2] += y
            s[3] += x * x
            s[4] += x * y
            s[5] += y * y
            s[6] += q
            s[7] += x * q
            s[8] += y * q
            s[9] += q * q
    return sums


@njit(nogil=True, cache=True)
def fit(s: F64, plane: F64) -> bool:
    """Write the best a, b, c for sums (10,) into `plane` (3,); return False where no plane is determined."""
    n = s[0]
    if n < 3.0:
        return False
    xx, xy, yy = s[3] - s[1] * s[1] / n, s[4] - s[1] * s[2] / n, s[5] - s[2] * s[2] / n
    xq, yq = s[7] - s[1] * s[6] / n, s[8] - s[2] * s[6] / n
    determinant = xx * yy - xy * xy
    if determinant <= 1e-9 * xx * yy or determinant <= 0.0:
        return False
    plane[0] = (yy * xq - xy * yq) / determinant
    plane[1] = (xx * yq - xy * xq) / determinant
    plane[2] = (s[6] - plane[0] * s[1] - plane[1] * s[2]) / n
    return True


@njit(nogil=True, cache=True)
def misfit(s: F64, plane: F64) -> float:
    """Return the root mean square [1/m] by which samples with sums (10,) miss the plane (3,)."""
    a, b, c = plane
    explained = a * (a * s[3] + 2.0 * b * s[4]) + b * b * s[5] + c * (2.0 * (a * s[1] + b * s[2]) + c * s[0])
    square = s[9] - 2.0 * (a * s[7] + b * s[8] + c * s[6]) + explained
    return math.sqrt(max(square, 0.0) / s[0]) if s[0] > 0.0 else math.inf


@njit(nogil=True, cache=True)
def cell_misfits(sums: F64, min_samples: int) -> F64:
    """Return by how much each cell (rows, columns) misses its own best plane [1/m]; infinite with too few samples."""
    rows, columns = sums.shape[0], sums.shape[1]
    misfits = np.full((rows, columns), np.inf)
    plane = np.zeros(3)
    for i in range(rows):
        for j in range(columns):
            if sums[i, j, 0] >= min_samples and fit(sums[i, j], plane):
                misfits[i, j] = misfit(sums[i, j], plane)
    return misfits


@njit(nogil=True, cache=True)
def grow_regions(sums: F64, misfits: F64, seeds: I32, max_misfit: float) -> tuple[I32, F64]:
    """Grow regions of cells that lie on one plane, from the flattest cells on.

    Args:
        sums: Sums of the cells (rows, columns, 10).
        misfits: Misfit of each cell's own plane (rows, columns) [1/m].
        seeds: Flat indices of the cells, in the order in which regions start.
        max_misfit: Largest misfit of a cell to its own plane, and to that of its region [1/m].

    Returns:
        Region of each cell (rows, columns), −1 for none; the sums of the regions (R, 10).
    """
    rows, columns = misfits.shape
    region_of = np.full((rows, columns), -1, dtype=np.int32)
    totals = np.zeros((len(seeds), N_SUMS))
    queue = np.empty(rows * columns, dtype=np.int32)
    plane = np.zeros(3)
    n_regions = 0
    for seed in seeds:
        if region_of[seed // columns, seed % columns] >= 0 or misfits[seed // columns, seed % columns] > max_misfit:
            continue
        total = totals[n_regions]
        queue[0] = seed
        region_of[seed // columns, seed % columns] = n_regions
        total += sums[seed // columns, seed % columns]
        fit(total, plane)
        head, tail = 0, 1
        while head < tail:
            i, j = queue[head] // columns, queue[head] % columns
            head += 1
            for di, dj in ((0, 1), (1, 0), (0, -1), (-1, 0)):
                k, m = i + di, j + dj
                if k < 0 or m < 0 or k >= rows or m >= columns or region_of[k, m] >= 0:
                    continue
                if misfits[k, m] > max_misfit or misfit(sums[k, m], plane) > max_misfit:
                    continue
                region_of[k, m] = n_regions
                total += sums[k, m]
                fit(total, plane)
                queue[tail] = k * columns + m
                tail += 1
        n_regions += 1
    return region_of, totals[:n_regions]
