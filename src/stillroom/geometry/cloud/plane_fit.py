"""Planes in inverse depth, where a depth camera's noise is the same at all distances.

A plane n·p + d = 0 seen along the ray (x, y, 1) has the inverse depth 1/z = a·x + b·y + c, with (a, b, c) = −n/d. A
Kinect's depth noise grows with the square of the depth, so that of the inverse depth is constant, and one threshold
serves near and far. Least squares need no more than ten sums of the samples, which add up: the sums of a region are
those of its cells.
"""

import math

import numpy as np

from stillroom.compiled import njit
from stillroom.geometry.arrays import F32, F64, I16, I32, I64, U8, U16

N_TERMS = 6
"""1, x, y, x², x·y, y²: a parabola over the rays."""
MIN_BEND_SAMPLES = 200
RIDGE = 1e-3
BLOCK = 256
"""Samples that are summed at once."""
N_SUMS = 10
"""n, Σx, Σy, Σxx, Σxy, Σyy, Σq, Σxq, Σyq, Σqq, where q is the inverse depth."""


# Passes over all samples of a cloud, for one plane: the misfits, the camera's distortion of it, and what lies on it.


@njit(nogil=True, cache=True, error_model="numpy")
def layers_of(points: F32) -> F32:
    """Return X, Y, Z, X/Z and Y/Z of points (N, 3), each on its own (5, N) [m]; all 0 where Z is."""
    layers = np.zeros((5, len(points)), dtype=np.float32)
    for i in range(len(points)):
        z = points[i, 2]
        if z > 0.0:
            layers[0, i], layers[1, i], layers[2, i] = points[i, 0], points[i, 1], z
            layers[3, i], layers[4, i] = points[i, 0] / z, points[i, 1] / z
    return layers


@njit(nogil=True, cache=True, error_model="numpy")
def plane_misfits(layers: F32, slope: F64) -> F32:
    """Return by how much each sample is nearer than a plane, in inverse depth.

    Args:
        layers: Samples (5, N) [m]; see `layers_of`.
        slope: The plane's a, b, c (3,).

    Returns:
        Misfits (N,) [1/m]; infinite where unknown.
    """
    X, Y, Z = layers[0], layers[1], layers[2]
    off = np.empty(len(Z), dtype=np.float32)
    a, b, c = slope
    for i in range(len(Z)):
        off[i] = (1.0 - a * X[i] - b * Y[i]) / Z[i] - c if Z[i] > 0.0 else np.inf
    return off


@njit(nogil=True, cache=True)
def parabola_sums(layers: F32, off: F32, limit: float) -> tuple[F64, int]:
    """Return the normal equations of a parabola through misfits up to a limit, and how many they are.

    Args:
        layers: Samples (5, N) [m].
        off: Misfits (N,) [1/m]; infinite where unknown.
        limit: Largest misfit that counts [1/m].

    Returns:
        Left side (6, 6) and, in the column after it, the right side (6, 7).
    """
    sums, block = np.zeros((N_TERMS, N_TERMS + 1)), np.ones((BLOCK, N_TERMS + 1))
    n, held = 0, 0
    for i in range(len(off)):
        if abs(off[i]) <= limit:
            x, y = layers[3, i], layers[4, i]
            t = block[held]
            t[1], t[2], t[3], t[4], t[5], t[6] = x, y, x * x, x * y, y * y, off[i]
            held += 1
        if held == BLOCK or i == len(off) - 1:
            add_products(block[:held], sums)
            n, held = n + held, 0
    return sums, n


@njit(nogil=True, cache=True)
def add_products(block: F64, sums: F64) -> None:
    """Add the products of each of the first six columns of a block (B, 7) with all columns to the sums (6, 7)."""
    for k in range(N_TERMS):
        s0, s1, s2, s3, s4, s5, s6 = sums[k]
        for i in range(len(block)):
            t = block[i, k]
            s0, s1, s2, s3 = s0 + t * block[i, 0], s1 + t * block[i, 1], s2 + t * block[i, 2], s3 + t * block[i, 3]
            s4, s5, s6 = s4 + t * block[i, 4], s5 + t * block[i, 5], s6 + t * block[i, 6]
        sums[k, 0], sums[k, 1], sums[k, 2], sums[k, 3] = s0, s1, s2, s3
        sums[k, 4], sums[k, 5], sums[k, 6] = s4, s5, s6


@njit(nogil=True, cache=True)
def straighten(layers: F32, off: F32, tolerance: float, max_bend: float) -> None:
    """Subtract from misfits what a parabola explains of the small ones, where there are enough of them.

    Args:
        layers: Samples (5, N) [m].
        off: Their misfits (N,) [1/m], infinite where unknown; changed.
        tolerance: Largest misfit of a sample on a plane [1/m].
        max_bend: Largest value of the parabola [1/m]; also what may come on top of the tolerance.
    """
    sums, n = parabola_sums(layers, off, tolerance + max_bend)
    if n >= MIN_BEND_SAMPLES:
        unbend(layers, off, solved(sums), max_bend)


@njit(nogil=True, cache=True, error_model="numpy")
def solved(sums: F64) -> F64:
    """Return the parabola (6,) of normal equations (6, 7), by elimination; see `parabola_sums`.

    A ridge keeps it flat where the samples do not determine it, and the pivots above 0.
    """
    a, terms = sums.copy(), np.empty(N_TERMS)
    for k in range(N_TERMS):
        a[k, k] += RIDGE
    for k in range(N_TERMS):
        for i in range(k + 1, N_TERMS):
            share = a[i, k] / a[k, k]
            for j in range(k, N_TERMS + 1):
                a[i, j] -= share * a[k, j]
    for k in range(N_TERMS - 1, -1, -1):
        left = a[k, N_TERMS]
        for j in range(k + 1, N_TERMS):
            left -= a[k, j] * terms[j]
        terms[k] = left / a[k, k]
    return terms


@njit(nogil=True, cache=True)
def unbend(layers: F32, off: F32, parabola: F64, max_bend: float) -> None:
    """Subtract a parabola (6,), clipped to ± `max_bend` [1/m], from the misfits (N,) of samples (5, N)."""
    p0, p1, p2, p3, p4, p5 = parabola
    for i in range(len(off)):
        x, y = layers[3, i], layers[4, i]
        bend = p0 + x * (p1 + p3 * x + p4 * y) + y * (p2 + p5 * y)
        off[i] -= min(max(bend, -max_bend), max_bend)


NEAR, MOSTLY = 1, 2
"""Bits: a sample lies on the plane, and so do most around it."""


@njit(nogil=True, cache=True)
def mark_near(off: F32, tolerance: float) -> U8:
    """Return `NEAR` for the samples with misfits (N,) up to a tolerance [1/m], 0 for others."""
    near = np.empty(len(off), dtype=np.uint8)
    for i in range(len(off)):
        near[i] = abs(off[i]) <= tolerance
    return near


@njit(nogil=True, cache=True)
def mark_mostly(near: U8, n_near: U16, n_known: U16, min_share: float, at_least: int) -> U8:
    """Add `MOSTLY` to `near` (N,) by what a window around each sample holds; return where both bits are set."""
    core = np.empty(len(near), dtype=np.uint8)
    for i in range(len(near)):
        mostly = (np.float32(n_near[i]) >= min_share * np.float32(n_known[i])) & (n_near[i] >= at_least)
        core[i] = near[i] & np.uint8(mostly)
        near[i] |= np.uint8(mostly) << 1
    return core


@njit(nogil=True, cache=True)
def mark_on(near: U8, around: U8, off: F32, tolerance: float, plane_of: I16) -> U8:
    """Return 1 for the samples (N,) around the core of a plane that lie on it and on no plane yet, else 0.

    Args:
        near: Their bits.
        around: Where the core is close.
        off: Their misfits [1/m].
        tolerance: Largest misfit where most around lie on the plane [1/m].
        plane_of: The planes found before; negative where there is none.
    """
    on_plane = np.empty(len(near), dtype=np.uint8)
    for i in range(len(near)):
        outlier = (near[i] >> 1) & np.uint8(abs(off[i]) <= tolerance)
        on_plane[i] = (near[i] | outlier) & around[i] & np.uint8(plane_of[i] < 0) & np.uint8(NEAR)
    return on_plane


@njit(nogil=True, cache=True)
def share_beyond(off: F32, max_off: float) -> float:
    """Return the share of samples with misfits (N,) that lie behind a plane by more than `max_off`, or are unknown."""
    n = 0
    for i in range(len(off)):
        n += (off[i] < -max_off) | (off[i] == np.inf)
    return n / len(off)


@njit(nogil=True, cache=True)
def extent(
    layers: F32, part_of: I32, part: int, window: tuple[int, int, int, int], steepness: float
) -> tuple[float, float]:
    """Return the area of a part of a plane [m² for a ray area of 1], and the smaller of its two widths [m].

    Args:
        layers: Samples (5, N) [m].
        part_of: Part of each sample (h, w).
        part: Which one.
        window: First column and row, and number of columns and rows, that hold it.
        steepness: Length of the plane's (a, b, c): z³ times it is the area of a unit of the plane z = 1.
    """
    X, Y, Z = layers[0], layers[1], layers[2]
    x0, y0, columns, rows = window
    s, sx, sy, sz, xx, xy, xz, yy, yz, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(y0, y0 + rows):
        for j in range(x0, x0 + columns):
            if part_of[i, j] == part:
                at = i * part_of.shape[1] + j
                x, y, z = np.float64(X[at]), np.float64(Y[at]), np.float64(Z[at])
                w = z * z * z * steepness
                wx, wy, wz = w * x, w * y, w * z
                s, sx, sy, sz = s + w, sx + wx, sy + wy, sz + wz
                xx, xy, xz, yy, yz, zz = xx + wx * x, xy + wx * y, xz + wx * z, yy + wy * y, yz + wy * z, zz + wz * z
    if s <= 0.0:
        return 0.0, 0.0
    sx, sy, sz = sx / s, sy / s, sz / s
    xx, xy, xz = xx / s - sx * sx, xy / s - sx * sy, xz / s - sx * sz
    yy, yz, zz = yy / s - sy * sy, yz / s - sy * sz, zz / s - sz * sz
    # A strip of width w has the variance w² / 12 across.
    return s, math.sqrt(12.0 * max(middle_eigenvalue(xx, xy, xz, yy, yz, zz), 0.0))


@njit(nogil=True, cache=True)
def middle_eigenvalue(xx: float, xy: float, xz: float, yy: float, yz: float, zz: float) -> float:
    """Return the second of the three eigenvalues of a symmetric matrix, by the roots of its cubic."""
    mean = (xx + yy + zz) / 3.0
    a, b, c = xx - mean, yy - mean, zz - mean
    spread = math.sqrt((a * a + b * b + c * c + 2.0 * (xy * xy + xz * xz + yz * yz)) / 6.0)
    if spread <= 0.0:
        return mean
    determinant = a * (b * c - yz * yz) - xy * (xy * c - yz * xz) + xz * (xy * yz - b * xz)
    third = math.acos(min(max(0.5 * determinant / spread**3, -1.0), 1.0)) / 3.0
    largest, smallest = math.cos(third), math.cos(third + 2.0 * math.pi / 3.0)
    return mean - 2.0 * spread * (largest + smallest)


@njit(nogil=True, cache=True)
def renumber(number_of: I64, plane_of: I16) -> None:
    """Give the planes of samples (N,) other numbers (Q,); −1, no plane, stays."""
    for i in range(len(plane_of)):
        if plane_of[i] >= 0:
            plane_of[i] = number_of[plane_of[i]]


# Cells of samples, and regions of cells.


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
    for i in range(rows):
        for j in range(columns):
            n, sx, sy, xx, xy, yy, sq, xq, yq, qq = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for r in range(i * cell, (i + 1) * cell):
                for c in range(j * cell, (j + 1) * cell):
                    z = points[r, c, 2]
                    if z > 0.0:
                        q = 1.0 / z
                        x, y = points[r, c, 0] * q, points[r, c, 1] * q
                        n, sx, sy, sq = n + 1.0, sx + x, sy + y, sq + q
                        xx, xy, yy, xq, yq, qq = xx + x * x, xy + x * y, yy + y * y, xq + x * q, yq + y * q, qq + q * q
            s = sums[i, j]
            s[0], s[1], s[2], s[3], s[4], s[5], s[6], s[7], s[8], s[9] = n, sx, sy, xx, xy, yy, sq, xq, yq, qq
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


@njit(nogil=True, cache=True)
def merge_regions(totals: F64, min_samples: float, max_misfit: float) -> tuple[F64, F64, F64]:
    """Merge regions that lie on one plane, the largest first.

    Args:
        totals: Sums of the regions (R, 10).
        min_samples: Smaller regions are left out; a few cells determine a plane badly.
        max_misfit: Largest misfit of either of two to the plane of both [1/m].

    Returns:
        Of M planes: a, b, c (M, 3), the number of samples (M,), and their mean depth [m] as that of the inverse (M,).
    """
    merged, slopes = np.zeros_like(totals), np.zeros((len(totals), 3))
    both, plane = np.zeros(N_SUMS), np.zeros(3)
    n = 0
    for r in np.argsort(-totals[:, 0], kind="mergesort"):
        if totals[r, 0] < min_samples:
            break
        i, is_found = 0, False
        while i < n and not is_found:
            both[:] = merged[i] + totals[r]
            plane[:] = 0.0
            fit(both, plane)
            is_found = misfit(merged[i], plane) <= max_misfit and misfit(totals[r], plane) <= max_misfit
            i += not is_found
        if is_found:
            merged[i] = both
        else:
            merged[n] = totals[r]
            n += 1
    for i in range(n):
        fit(merged[i], slopes[i])
    return slopes[:n], merged[:n, 0], merged[:n, 0] / merged[:n, 6]
