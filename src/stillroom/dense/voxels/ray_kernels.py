"""Hits at the ends of rays and misses along them, as log-odds of voxels in a hash table."""

from typing import NamedTuple

import numpy as np

from stillroom.compiled import njit
from stillroom.dense.voxels.hash_kernels import EMPTY, find_slot, pack
from stillroom.geometry.arrays import F32, F64, I32, I64, U8, U16


class Cells(NamedTuple):
    """Voxels that were hit or missed: the hash table, and the rows that it leads to.

    Attributes:
        slot_key: Key of each slot (S,); S is a power of two.
        slot_row: Its row (S,).
        key: Key of each row (N,), as far as rows are in use.
        log_odds: Log-odds of being occupied (N,) float32.
        last_scan: The number of the scan that changed it last (N,).
    """

    slot_key: I64
    slot_row: I32
    key: I64
    log_odds: F32
    last_scan: I32


class Steps(NamedTuple):
    """What a hit and a miss add to log-odds, and the bounds that these are kept within; all float32."""

    hit: np.float32
    miss: np.float32
    lowest: np.float32
    highest: np.float32


class Scan(NamedTuple):
    """The rays of a scan.

    Attributes:
        number: Number of the scan, from 1.
        depth: Depths (h, w) in units.
        usable: Rays that count (h, w), 0 or 1.
        rays: x/z and y/z of each (h, w, 2).
        unit_m: One unit of depth.
        T_world_cam: Pose (4, 4).
        voxel_m: Edge of a voxel.
        max_range_m: A longer ray is cut there; what it hits is not seen.
    """

    number: int
    depth: U16
    usable: U8
    rays: F32
    unit_m: float
    T_world_cam: F64
    voxel_m: float
    max_range_m: float


@njit(nogil=True, cache=True, error_model="numpy")
def mark_hits(keys: I64, ends: U8, number: int, cells: Cells, n_rows: int, steps: Steps) -> int:
    """Raise the log-odds of the voxels that rays end in, each once; return the rows in use afterwards.

    Args:
        keys: Keys of the voxels of pixels (h, w).
        ends: Pixels that count (h, w), 0 or 1.
        number: Number of the scan.
        cells: The voxels, with room for all pixels.
        n_rows: Rows in use.
        steps: What a hit adds.
    """
    height, width = keys.shape
    last = EMPTY
    for y in range(height):
        for x in range(width):
            key = keys[y, x]
            if ends[y, x] == 0 or key in (EMPTY, last):
                continue
            last = key
            n_rows = _change(key, number, cells, n_rows, steps.hit, steps.lowest, steps.highest)
    return n_rows


@njit(nogil=True, cache=True, error_model="numpy")
def mark_misses(scan: Scan, cells: Cells, n_rows: int, first: int, steps: Steps) -> tuple[int, int]:
    """Lower the log-odds of the voxels that rays pass through, but for those that the scan changed already.

    A ray goes from voxel to voxel through the nearest side (Amanatides & Woo, A fast voxel traversal algorithm for ray
    tracing, Eurographics 1987), from that of the camera to the one before its end.

    Args:
        scan: The rays.
        cells: The voxels.
        n_rows: Rows in use.
        first: The ray to begin with, counted along the rows of the image.
        steps: What a miss adds.

    Returns:
        Rows in use afterwards, and the ray to go on with once there is more room; h · w at the end.
    """
    height, width = scan.depth.shape
    T = scan.T_world_cam / scan.voxel_m
    start, end, nearest, pitch = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    cell, turn, left = np.empty(3, np.int64), np.empty(3, np.int64), np.empty(3, np.int64)
    start[0], start[1], start[2] = T[0, 3], T[1, 3], T[2, 3]
    for place in range(first, height * width):
        y, x = place // width, place % width
        if scan.usable[y, x] == 0:
            continue
        z = scan.depth[y, x] * scan.unit_m
        px, py = scan.rays[y, x, 0] * z, scan.rays[y, x, 1] * z
        length_m = np.sqrt(px * px + py * py + z * z)
        share = min(1.0, scan.max_range_m / length_m)
        for k in range(3):
            end[k] = T[k, 0] * px + T[k, 1] * py + T[k, 2] * z + T[k, 3]
            if share < 1.0:
                end[k] = start[k] + share * (end[k] - start[k])
        n_steps = _prepare(start, end, cell, turn, left, nearest, pitch)
        if n_rows + n_steps > len(cells.key):
            return n_rows, place
        for _ in range(n_steps):
            key = pack(cell[0], cell[1], cell[2])
            if key != EMPTY:
                n_rows = _change(key, scan.number, cells, n_rows, steps.miss, steps.lowest, steps.highest)
            k = 0 if nearest[0] <= nearest[1] else 1
            k = k if nearest[k] <= nearest[2] else 2
            cell[k] += turn[k]
            left[k] -= 1
            # An axis that has arrived is not stepped along again: rounding cannot lead past the end.
            nearest[k] = nearest[k] + pitch[k] if left[k] > 0 else np.inf
    return n_rows, height * width


@njit(nogil=True, cache=True, error_model="numpy", inline="always")
def _prepare(start: F64, end: F64, cell: I64, turn: I64, left: I64, nearest: F64, pitch: F64) -> int:
    """Prepare the walk along a ray from `start` to `end` (3,) [voxels]; return how many voxels lie before its last.

    Args:
        start, end: Where it begins and ends.
        cell: Receives the first voxel (3,).
        turn: Receives the direction along each axis (3,): 1 or −1.
        left: Receives the number of steps along each axis (3,).
        nearest: Receives where along the ray, as a share of it, the next voxel begins (3,); infinite without steps.
        pitch: Receives by how much more it is with each step (3,).
    """
    n_steps = 0
    for k in range(3):
        along = end[k] - start[k]
        cell[k] = int(np.floor(start[k]))
        turn[k] = 1 if along > 0 else -1
        left[k] = abs(int(np.floor(end[k])) - cell[k])
        n_steps += left[k]
        nearest[k], pitch[k] = np.inf, np.inf
        if left[k] > 0:
            side = cell[k] + (1 if along > 0 else 0)
            nearest[k], pitch[k] = (side - start[k]) / along, 1.0 / abs(along)
    return n_steps


@njit(nogil=True, cache=True, error_model="numpy", inline="always")
def _change(
    key: int, number: int, cells: Cells, n_rows: int, step: np.float32, lowest: np.float32, highest: np.float32
) -> int:
    """Add a step to the log-odds of a voxel that this scan has not changed yet; return the rows in use afterwards."""
    slot = find_slot(key, cells.slot_key)
    if cells.slot_key[slot] == EMPTY:
        cells.slot_key[slot] = key
        cells.slot_row[slot] = n_rows
        cells.key[n_rows] = key
        cells.log_odds[n_rows] = np.float32(0.0)
        cells.last_scan[n_rows] = 0
        n_rows += 1
    row = cells.slot_row[slot]
    if cells.last_scan[row] != number:
        cells.last_scan[row] = number
        cells.log_odds[row] = min(max(cells.log_odds[row] + step, lowest), highest)
    return n_rows
