"""The voxel filter: one point, the mean, for each occupied cube of space."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from stillroom.compiled import njit
from stillroom.geometry.arrays import F64, I32, I64, Floats


@dataclass(frozen=True)
class OccupiedVoxels:
    """M occupied voxels of N points, in the order in which the points enter them.

    Attributes:
        mean_m: Mean of the points of each (M, 3) float64 [m].
        n_points: How many they are (M,) int32.
        group: Group of the points of each (M,) int32.
        voxel_of: Voxel of each point (N,) int32: maps results of voxels back to the points.
    """

    mean_m: F64
    n_points: I32
    group: I32
    voxel_of: I32

    def __len__(self) -> int:
        """Number of voxels."""
        return len(self.n_points)


def voxel_filter(points_m: Floats, voxel_m: float, group: I32 | None = None) -> OccupiedVoxels:
    """Thin a cloud to one point for each voxel (OC-SLAM 2.3).

    Args:
        points_m: Points (N, 3) [m], finite.
        voxel_m: Edge of a voxel [m].
        group: Group of each point (N,) int32; points of two groups never share a voxel. None for one group.

    Raises:
        ValueError: The edge is not positive.
    """
    if not voxel_m > 0:
        raise ValueError(f"a voxel of {voxel_m} m is not possible")
    points = np.ascontiguousarray(points_m, dtype=np.float64).reshape(-1, 3)
    groups = np.zeros(len(points), dtype=np.int32) if group is None else group
    voxel_of, grid = cell_of_points(points, groups, voxel_m)
    means, counts = means_of(points, voxel_of, len(grid.keys))
    return OccupiedVoxels(means, counts, grid.keys[:, 3].astype(np.int32), voxel_of)


class CellTable(NamedTuple):
    """M cells of space that hold points.

    Attributes:
        keys: Integer place x, y, z of each, and the group of its points (M, 4).
        table: Cell numbers in a hash table (a power of two,), at most half full; −1 where free.
    """

    keys: I64
    table: I32


@njit(nogil=True, cache=True)
def slot_of(keys: I64, table: I32, x: int, y: int, z: int, group: int) -> int:
    """Return the slot of the hash table of `CellTable` in which a cell lies, or would lie."""
    mask = len(table) - 1
    slot = ((x * 73856093) ^ (y * 19349663) ^ (z * 83492791) ^ (group * 15485863)) & mask
    while True:
        c = table[slot]
        if c < 0 or (keys[c, 0] == x and keys[c, 1] == y and keys[c, 2] == z and keys[c, 3] == group):
            return slot
        slot = (slot + 1) & mask


@njit(nogil=True, cache=True)
def cell_of_points(points: F64, group: I32, edge: float) -> tuple[I32, CellTable]:
    """Sort points (N, 3) of groups (N,) into cells of an edge.

    Returns:
        Number of each point's cell (N,), as they come, and the cells.
    """
    n_slots = 16
    while n_slots < 2 * len(points):
        n_slots *= 2
    number = np.empty(len(points), dtype=np.int32)
    keys, table = np.empty((len(points), 4), dtype=np.int64), np.full(n_slots, -1, dtype=np.int32)
    n_cells, last = 0, 0
    for i in range(len(points)):
        x, y, z = np.floor(points[i, 0] / edge), np.floor(points[i, 1] / edge), np.floor(points[i, 2] / edge)
        X, Y, Z, g = np.int64(x), np.int64(y), np.int64(z), np.int64(group[i])
        # Neighbours often share a cell.
        if n_cells and keys[last, 0] == X and keys[last, 1] == Y and keys[last, 2] == Z and keys[last, 3] == g:
            number[i] = last
            continue
        slot = slot_of(keys, table, X, Y, Z, g)
        if table[slot] < 0:
            table[slot] = n_cells
            keys[n_cells, 0], keys[n_cells, 1], keys[n_cells, 2], keys[n_cells, 3] = X, Y, Z, g
            n_cells += 1
        last = table[slot]
        number[i] = last
    return number, CellTable(keys[:n_cells], table)


@njit(nogil=True, cache=True)
def means_of(points: F64, number: I32, n: int) -> tuple[F64, I32]:
    """Return the means (n, 3) of the points (N, 3) with each number (N,), and how many they are (n,)."""
    means, counts = np.zeros((n, 3)), np.zeros(n, dtype=np.int32)
    for i in range(len(points)):
        counts[number[i]] += 1
        for k in range(3):
            means[number[i], k] += points[i, k]
    for m in range(n):
        for k in range(3):
            means[m, k] /= max(counts[m], 1)
    return means, counts
