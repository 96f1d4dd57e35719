"""Euclidean clusters, exactly: the connected components of "not further apart than the tolerance".

Why not a library: docs/reference.md#library-measurements.
"""

from typing import NamedTuple

import numpy as np

from stillroom.compiled import njit
from stillroom.geometry.arrays import F64, I32, I64, Floats
from stillroom.geometry.cloud.voxels import cell_of_points, cells_of, slot_of, table_size

EDGE = 1.0 + 1e-6  # of a cell, in tolerances: rounding must not put the two points of a pair two cells apart
FORWARD = np.array([(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if (x, y, z) > (0, 0, 0)])
"""Half of a cell's neighbours (13, 3); the other half is covered by symmetry."""


def euclidean_clusters(points: Floats, tolerance: float) -> I32:
    """Cluster points so that two of them, no further apart than the tolerance, are always in one (OC-SLAM 2.4).

    Args:
        points: Points (N, 3), finite, in any unit.
        tolerance: Largest distance of neighbours, in the same unit; 0 joins equal points only.

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
    # Moved to the origin only to be sorted into cells: distances are those of the points as given.
    moved = exact - exact.min(axis=0)
    # A larger cell is slower, never wrong; it keeps cell numbers countable where the tolerance is tiny.
    cells = cells_of(moved, max(tolerance * EDGE, float(moved.max()) * 1e-9, 1e-300))
    cell_of, n_cells, first_of, table = cell_of_points(cells, table_size(len(cells)))
    order = np.argsort(cell_of, kind="stable")
    start = np.append(0, np.cumsum(np.bincount(cell_of, minlength=n_cells)))
    labels: I32 = union_neighbours(exact, Cells(cells, order, start, first_of, table), FORWARD, tolerance)
    return labels


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
    points = np.asarray(points_m, dtype=np.float64).reshape(-1, 3)
    if tolerance_share <= 0.0:
        return points / tolerance_m
    turn_m = tolerance_m / tolerance_share
    far = np.maximum(points[:, 2] / turn_m, 1.0)
    scaled = points / (tolerance_m * far)[:, None]
    scaled[:, 2] += np.log(far) / tolerance_share
    return scaled


class Cells(NamedTuple):
    """N points sorted into M cells.

    Attributes:
        cells: Integer cell of each point (N, 3).
        order: Points sorted by the number of their cell (N,).
        start: Where each cell's points start in `order` (M + 1,).
        first_of, table: A point of each cell, and the cells' hash table; see `slot_of`.
    """

    cells: I64
    order: I64
    start: I64
    first_of: I32
    table: I32


@njit(nogil=True, cache=True)
def union_neighbours(points: F64, grid: Cells, forward: I64, tolerance: float) -> I32:
    """Join all pairs within the tolerance by union-find, looking in neighbouring cells only.

    Args:
        points: Points (N, 3).
        grid: The points in cells.
        forward: Offsets of the neighbours to look in (13, 3).
        tolerance: Largest distance of neighbours.

    Returns:
        Cluster of each point (N,), numbered as the points come.
    """
    cells, _, start, first_of, table = grid
    n_cells = len(start) - 1
    parent = np.arange(len(points)).astype(np.int32)
    whole = np.empty(n_cells, dtype=np.bool_)
    for c in range(n_cells):
        join_cells(points, grid, (c, c), tolerance, parent, False)
        whole[c] = is_whole(grid.order, start, c, parent)
    for c in range(n_cells):
        key = cells[first_of[c]]
        for k in range(len(forward)):
            x, y, z = key[0] + forward[k, 0], key[1] + forward[k, 1], key[2] + forward[k, 2]
            other = table[slot_of(cells, first_of, table, x, y, z)]
            if other < 0:
                continue
            both = whole[c] and whole[other]
            if not (both and root_of(parent, first_of[c]) == root_of(parent, first_of[other])):
                join_cells(points, grid, (c, other), tolerance, parent, both)
    label = np.full(len(points), -1, dtype=np.int32)
    n_clusters = 0
    for i in range(len(points)):
        root = root_of(parent, i)  # the smallest index of its cluster, so met before the others
        if root == i:
            label[i] = n_clusters
            n_clusters += 1
        else:
            label[i] = label[root]
    return label


@njit(nogil=True, cache=True)
def join_cells(
    points: F64, grid: Cells, pair: tuple[int, int], tolerance: float, parent: I32, one_is_enough: bool
) -> None:
    """Join what lies within the tolerance between two cells, or within one if they are the same.

    Where each of the two is one cluster already, the first pair decides.
    """
    order, start = grid.order, grid.start
    c, other = pair
    largest = tolerance * tolerance
    for a in range(start[c], start[c + 1]):
        i = order[a]
        for b in range(a + 1 if c == other else start[other], start[other + 1]):
            j = order[b]
            dx, dy, dz = points[i, 0] - points[j, 0], points[i, 1] - points[j, 1], points[i, 2] - points[j, 2]
            if dx * dx + dy * dy + dz * dz <= largest:
                first, second = root_of(parent, i), root_of(parent, j)
                parent[max(first, second)] = min(first, second)
                if one_is_enough:
                    return


@njit(nogil=True, cache=True)
def is_whole(order: I64, start: I64, c: int, parent: I32) -> bool:
    """Return whether all points of a cell are in one cluster."""
    root = root_of(parent, order[start[c]])
    a = start[c] + 1
    while a < start[c + 1] and root_of(parent, order[a]) == root:
        a += 1
    return bool(a == start[c + 1])


@njit(nogil=True, cache=True)
def root_of(parent: I32, i: int) -> int:
    """Return the root of i, halving the way there."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i
