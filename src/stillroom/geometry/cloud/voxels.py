"""The voxel filter: one point, the mean, for each occupied cube of space."""

from dataclasses import dataclass

import numpy as np

from stillroom.compiled import njit
from stillroom.geometry.arrays import F64, I32, I64, Floats


@dataclass(frozen=True)
class OccupiedVoxels:
    """M occupied voxels of N points, in the order in which the points enter them.

    Attributes:
        mean_m: Mean of the points of each (M, 3) float64 [m].
        n_points: How many they are (M,) int32.
        voxel_of: Voxel of each point (N,) int32: maps results of voxels back to the points.
    """

    mean_m: F64
    n_points: I32
    voxel_of: I32

    def __len__(self) -> int:
        """Number of voxels."""
        return len(self.n_points)


def voxel_filter(points_m: Floats, voxel_m: float) -> OccupiedVoxels:
    """Thin a cloud to one point for each voxel (OC-SLAM 2.3).

    Args:
        points_m: Points (N, 3) [m], finite.
        voxel_m: Edge of a voxel [m].

    Raises:
        ValueError: The edge is not positive.
    """
    if not voxel_m > 0:
        raise ValueError(f"a voxel of {voxel_m} m is not possible")
    points = np.ascontiguousarray(points_m, dtype=np.float64).reshape(-1, 3)
    voxel_of, n_voxels, _, _ = cell_of_points(cells_of(points, voxel_m), table_size(len(points)))
    counts = np.bincount(voxel_of, minlength=n_voxels)
    sums = np.stack([np.bincount(voxel_of, points[:, k], n_voxels) for k in range(3)], axis=1)
    return OccupiedVoxels(sums / np.maximum(counts, 1)[:, None], counts.astype(np.int32), voxel_of)


def cells_of(points: F64, edge: float) -> I64:
    """Return the integer cell of each point (N, 3), for cells of one edge."""
    return np.floor(points / edge).astype(np.int64)


def table_size(n: int) -> int:
    """Return the size of a hash table for n entries: a power of two, at most half full."""
    return 1 << max(4, int(2 * n).bit_length())


@njit(nogil=True, cache=True)
def slot_of(cells: I64, first_of: I32, table: I32, x: int, y: int, z: int) -> int:
    """Return the slot of a hash table in which cell (x, y, z) lies, or would lie.

    Args:
        cells: Integer cells of all points (N, 3).
        first_of: A point of each known cell (M,), whose cell is the key.
        table: Cell numbers by slot (a power of two,), −1 where free.
        x, y, z: The cell to find.
    """
    mask = len(table) - 1
    slot = ((x * 73856093) ^ (y * 19349663) ^ (z * 83492791)) & mask
    while table[slot] >= 0:
        i = first_of[table[slot]]
        if cells[i, 0] == x and cells[i, 1] == y and cells[i, 2] == z:
            return slot
        slot = (slot + 1) & mask
    return slot


@njit(nogil=True, cache=True)
def cell_of_points(cells: I64, n_slots: int) -> tuple[I32, int, I32, I32]:
    """Number the distinct cells of points (N, 3) as they come.

    Returns:
        Number of each point's cell (N,); how many there are; a point of each (N,), of which as many count; the hash
        table (n_slots,), see `slot_of`.
    """
    number = np.empty(len(cells), dtype=np.int32)
    first_of = np.empty(len(cells), dtype=np.int32)
    table = np.full(n_slots, -1, dtype=np.int32)
    n_cells = 0
    for i in range(len(cells)):
        slot = slot_of(cells, first_of, table, cells[i, 0], cells[i, 1], cells[i, 2])
        if table[slot] < 0:
            table[slot] = n_cells
            first_of[n_cells] = i
            n_cells += 1
        number[i] = table[slot]
    return number, n_cells, first_of, table
