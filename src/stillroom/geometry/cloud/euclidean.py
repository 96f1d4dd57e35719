"""Euclidean clusters, exactly: the connected components of "not further apart than the tolerance".

Why not a library: docs/reference.md#library-measurements.
"""

import math

import numpy as np

from stillroom.compiled import njit
from stillroom.geometry.arrays import F64, I32, I64, Floats
from stillroom.geometry.cloud.voxels import CellTable, cell_of_points, slot_of

EDGE = 1.0 + 1e-6  # of a cell, in tolerances: rounding must not put the two points of a pair two cells apart
FORWARD = np.array([(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if (x, y, z) > (0, 0, 0)])
"""Half of a cell's neighbours (13, 3); the other half is covered by symmetry."""


def euclidean_clusters(points: Floats, tolerance: float, group: I32 | None = None, joined: I32 | None = None) -> I32:
    """Cluster points so that two of them, no further apart than the tolerance, are always in one (OC-SLAM 2.4).

    Args:
        points: Points (N, 3), finite, in any unit.
        tolerance: Largest distance of neighbours, in the same unit; 0 joins equal points only.
        group: Group of each point (N,) int32; points of two groups are never in one cluster. None for one group.
        joined: A forest of points that are known to be in one cluster (N,) int32; see `join`. Written to.

    Returns:
        Cluster of each point (N,) int32, numbered from 0 as the points come.

    Raises:
        ValueError: The tolerance is negative or not a number, or a coordinate is not finite.
    """
    exact = np.ascontiguousarray(points, dtype=np.float64).reshape(-1, 3)
    if not tolerance >= 0:
        raise ValueError(f"a tolerance of {tolerance} is not possible")
    if not np.all(np.isfinite(exact)):
        raise ValueError("points to be clustered must be finite")
    if len(exact) == 0:
        return np.zeros(0, dtype=np.int32)
    groups = np.zeros(len(exact), dtype=np.int32) if group is None else group
    parent = np.arange(len(exact), dtype=np.int32) if joined is None else joined
    # Moved to the origin only to be sorted into cells: distances are those of the points as given.
    moved = exact - exact.min(axis=0)
    # A larger cell is slower, never wrong; it keeps cell numbers countable where the tolerance is tiny.
    cell_of, grid = cell_of_points(moved, groups, max(tolerance * EDGE, float(moved.max()) * 1e-9, 1e-300))
    union_neighbours(exact, cell_of, grid, FORWARD, tolerance, parent)
    return np.asarray(trees(parent), dtype=np.int32)


def depth_scaled(points_m: Floats, tolerance_m: float, tolerance_share: float) -> F64:
    """Transform space so that a tolerance that grows with depth is one unit everywhere.

    The spacing of points grows with depth, and so must the distance at which they count as neighbours: it is
    max(tolerance_m, tolerance_share · z). Near the camera the map is a mere scale; from the depth on where the two are
    equal it is (x/z, y/z, log z), scaled too. Both give the same where they meet.

    Args:
        points_m: Points (N, 3) [m, camera frame], z > 0.
        tolerance_m: Tolerance near the camera [m].
        tolerance_share: Tolerance far from it, as a share of the depth; 0 for the same everywhere.

    Returns:
        Points (N, 3) [tolerances].
    """
    points = np.ascontiguousarray(points_m, dtype=np.float64).reshape(-1, 3)
    return np.asarray(scaled_by_depth(points, tolerance_m, tolerance_share), dtype=np.float64)


@njit(nogil=True, cache=True, error_model="numpy")
def scaled_by_depth(points: F64, tolerance_m: float, tolerance_share: float) -> F64:
    """Return points (N, 3) [tolerances]; see `depth_scaled`."""
    scaled = np.empty_like(points)
    turn_m = tolerance_m / tolerance_share if tolerance_share > 0.0 else np.inf
    for i in range(len(points)):
        far = max(points[i, 2] / turn_m, 1.0)
        for k in range(3):
            scaled[i, k] = points[i, k] / (tolerance_m * far)
        if far > 1.0:
            scaled[i, 2] += math.log(far) / tolerance_share
    return scaled


@njit(nogil=True, cache=True)
def union_neighbours(points: F64, cell_of: I32, grid: CellTable, forward: I64, tolerance: float, parent: I32) -> None:
    """Join all pairs within the tolerance by union-find, looking in neighbouring cells only.

    Args:
        points: Points (N, 3).
        cell_of: Cell of each (N,).
        grid: The cells.
        forward: Offsets of the neighbours to look in (13, 3).
        tolerance: Largest distance of neighbours.
        parent: The forest of points (N,), written to; see `join`.
    """
    keys, table = grid
    n_cells = len(keys)
    order, start = sorted_by_cell(cell_of, n_cells)
    whole = np.empty(n_cells, dtype=np.bool_)
    for c in range(n_cells):
        whole[c] = is_whole(order, start[c], start[c + 1], parent)
        if not whole[c]:
            join_cells(points, order, start, c, c, tolerance, parent, False)
            whole[c] = is_whole(order, start[c], start[c + 1], parent)
    for c in range(n_cells):
        x, y, z, group = keys[c, 0], keys[c, 1], keys[c, 2], keys[c, 3]
        for k in range(len(forward)):
            at = slot_of(keys, table, x + forward[k, 0], y + forward[k, 1], z + forward[k, 2], group)
            other = table[at]
            if other < 0:
                continue
            both = whole[c] and whole[other]
            if not (both and root_of(parent, order[start[c]]) == root_of(parent, order[start[other]])):
                join_cells(points, order, start, c, other, tolerance, parent, both)


@njit(nogil=True, cache=True)
def sorted_by_cell(cell_of: I32, n_cells: int) -> tuple[I32, I32]:
    """Return points in the order of their cells (N,), and where each cell starts in it (M + 1,)."""
    start = np.zeros(n_cells + 1, dtype=np.int32)
    for c in cell_of:
        start[c + 1] += 1
    for c in range(n_cells):
        start[c + 1] += start[c]
    order, end = np.empty(len(cell_of), dtype=np.int32), start[:-1].copy()
    for i in range(len(cell_of)):
        order[end[cell_of[i]]] = i
        end[cell_of[i]] += 1
    return order, start


@njit(nogil=True, cache=True)
def join_cells(
    points: F64, order: I32, start: I32, c: int, other: int, tolerance: float, parent: I32, one_is_enough: bool
) -> None:
    """Join what lies within the tolerance between two cells, or within one if they are the same.

    Where each of the two is one cluster already, the first pair decides.
    """
    for a in range(start[c], start[c + 1]):
        for b in range(a + 1 if c == other else start[other], start[other + 1]):
            if is_near(points, order[a], order[b], tolerance):
                join(parent, order[a], order[b])
                if one_is_enough:
                    return


@njit(nogil=True, cache=True)
def is_near(points: F64, i: int, j: int, tolerance: float) -> bool:
    """Return whether two of the points (N, 3) are no further apart than the tolerance."""
    dx, dy, dz = points[i, 0] - points[j, 0], points[i, 1] - points[j, 1], points[i, 2] - points[j, 2]
    return bool(dx * dx + dy * dy + dz * dz <= tolerance * tolerance)


@njit(nogil=True, cache=True)
def is_whole(order: I32, start: int, end: int, parent: I32) -> bool:
    """Return whether all points of a cell, from `start` on in `order`, are in one cluster."""
    root = root_of(parent, order[start])
    a = start + 1
    while a < end and root_of(parent, order[a]) == root:
        a += 1
    return bool(a == end)


# A forest of points (N,) int32: each names its parent, a point before it, or itself; a tree is a cluster.


@njit(nogil=True, cache=True)
def join(parent: I32, i: int, j: int) -> None:
    """Make one tree of those of two points."""
    first, second = root_of(parent, i), root_of(parent, j)
    parent[max(first, second)] = min(first, second)


@njit(nogil=True, cache=True)
def root_of(parent: I32, i: int) -> int:
    """Return the root of i, halving the way there."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@njit(nogil=True, cache=True)
def trees(parent: I32) -> I32:
    """Number the trees as their points come; return that of each point (N,)."""
    number = np.empty(len(parent), dtype=np.int32)
    n = 0
    for i in range(len(parent)):
        if parent[i] == i:
            number[i] = n
            n += 1
        else:
            number[i] = number[parent[i]]
    return number
