"""Adding a keyframe's pixels to the voxels, and subtracting them exactly.

Sums are integers: what was added is subtracted exactly, in any order, without drift over a thousand corrections.
"""

from typing import NamedTuple

import numpy as np

from stillroom.compiled import njit
from stillroom.dense.keyframe_cloud import I8
from stillroom.dense.voxels.hash_kernels import EMPTY, find_slot, pack
from stillroom.geometry.arrays import F32, F64, I32, I64, U8, U16

FINE = 256
"""A position inside a voxel is counted in this many steps along each axis."""

FULL_WEIGHT = 16
"""Weight of a pixel at one metre or nearer; it falls with the square of depth, to 1."""

HEAVIEST = 8_000_000
"""A voxel takes no more weight than this: 256 times it still fits a 32-bit sum."""

WEIGHT, PLACE, COLOUR, NORMAL, SCORE, VOIDED_AT, BLOCK = 0, 1, 4, 7, 10, 11, 12
"""Columns of a row: what a voxel needs lies together, for rows are visited in any order.

Sum of weights; of weight times position in the voxel, colour and normal (three columns each); balance of hits and
passes; when the voxel was last emptied for good; number of its block.
"""

N_COLUMNS = 13


@njit(nogil=True, cache=True, error_model="numpy")
def locate(depth: U16, usable: U8, rays: F32, unit_m: float, T_world_cam: F64, voxel_m: float) -> tuple[I64, U8]:
    """Return the keys (h, w) of the voxels that pixels fall into, and where in them they lie (h, w, 3).

    Args:
        depth: Depths (h, w) in units.
        usable: Pixels that count (h, w); the others get the key −1.
        rays: x/z and y/z of each pixel (h, w, 2).
        unit_m: One unit of depth.
        T_world_cam: Pose (4, 4).
        voxel_m: Edge of a voxel.
    """
    height, width = depth.shape
    keys = np.full((height, width), EMPTY, dtype=np.int64)
    fine = np.empty((height, width, 3), dtype=np.uint8)
    T = T_world_cam / voxel_m
    for y in range(height):
        for x in range(width):
            if usable[y, x] == 0:
                continue
            z = depth[y, x] * unit_m
            px, py = rays[y, x, 0] * z, rays[y, x, 1] * z
            wx = T[0, 0] * px + T[0, 1] * py + T[0, 2] * z + T[0, 3]
            wy = T[1, 0] * px + T[1, 1] * py + T[1, 2] * z + T[1, 3]
            wz = T[2, 0] * px + T[2, 1] * py + T[2, 2] * z + T[2, 3]
            fx, fy, fz = np.floor(wx), np.floor(wy), np.floor(wz)
            keys[y, x] = pack(int(fx), int(fy), int(fz))
            fine[y, x, 0] = min(FINE - 1, int((wx - fx) * FINE))
            fine[y, x, 1] = min(FINE - 1, int((wy - fy) * FINE))
            fine[y, x, 2] = min(FINE - 1, int((wz - fz) * FINE))
    return keys, fine


@njit(nogil=True, cache=True, error_model="numpy")
def pixel_weights(depth: U16, unit_m: float) -> I32:
    """Return the weight (h, w) of each pixel by its depth."""
    height, width = depth.shape
    weights = np.empty((height, width), dtype=np.int32)
    for y in range(height):
        for x in range(width):
            z = depth[y, x] * unit_m
            weights[y, x] = max(1, min(FULL_WEIGHT, int(FULL_WEIGHT / (z * z + 1e-9) + 0.5)))
    return weights


@njit(nogil=True, cache=True, error_model="numpy")
def turn_normals(normals: I8, usable: U8, R_world_cam: F64) -> I8:
    """Return normals (h, w, 3) of the usable pixels, turned into the world and rounded."""
    height, width = usable.shape
    turned = np.zeros((height, width, 3), dtype=np.int8)
    for y in range(height):
        for x in range(width):
            if usable[y, x] == 0:
                continue
            nx, ny, nz = float(normals[y, x, 0]), float(normals[y, x, 1]), float(normals[y, x, 2])
            for k in range(3):
                value = R_world_cam[k, 0] * nx + R_world_cam[k, 1] * ny + R_world_cam[k, 2] * nz
                turned[y, x, k] = int(np.rint(max(-127.0, min(127.0, value))))
    return turned


class Pixels(NamedTuple):
    """Pixels (h, w) of a keyframe's cloud; see above."""

    keys: I64
    fine: U8
    rgb: U8
    normals: I8
    weights: I32
    usable: U8


class HashTable(NamedTuple):
    """The hash table of the voxels: the key and the row of each slot (S,)."""

    slot_key: I64
    slot_row: I32


@njit(nogil=True, cache=True, error_model="numpy")
def add_pixels(pixels: Pixels, table: HashTable, row_key: I64, rows: I32, n_rows: int, newborn: I32) -> tuple[int, int]:
    """Add pixels to the voxels; a pixel without room or voxel is cleared in `usable`.

    Args:
        pixels: The pixels; `usable` changes.
        table: The hash table, with room for all that may come.
        row_key, rows: Keys (N,) and columns (N, 13) of the rows, with room for all that may come.
        n_rows: Rows in use.
        newborn: Receives the rows that had no weight and now have.

    Returns:
        Rows in use afterwards, and the number of newborn rows.
    """
    keys, fine, rgb, normals, weights, usable = pixels
    slot_key, slot_row = table
    height, width = keys.shape
    n_newborn = 0
    rows_above = np.full(width, -1, dtype=np.int32)
    last_key, row = EMPTY, -1
    for y in range(height):
        for x in range(width):
            above, rows_above[x] = rows_above[x], -1
            if usable[y, x] == 0:
                continue
            key = keys[y, x]
            if key == EMPTY:
                usable[y, x] = 0
                continue
            if key != last_key:
                if above >= 0 and keys[y - 1, x] == key:  # most voxels are met again in the next line
                    row = above
                else:
                    slot = find_slot(key, slot_key)
                    if slot_key[slot] == EMPTY:
                        slot_key[slot] = key
                        slot_row[slot] = n_rows
                        row_key[n_rows] = key
                        n_rows += 1
                    row = slot_row[slot]
                last_key = key
            rows_above[x] = row
            if rows[row, WEIGHT] > HEAVIEST:
                usable[y, x] = 0
                continue
            if rows[row, WEIGHT] == 0:
                newborn[n_newborn] = row
                n_newborn += 1
            _add(weights[y, x], fine[y, x], rgb[y, x], normals[y, x], rows[row])
    return n_rows, n_newborn


@njit(nogil=True, cache=True, error_model="numpy", inline="always")
def _add(weight: int, fine: U8, rgb: U8, normal: I8, sums: I32) -> None:
    """Add a pixel to the sums (13,) of a voxel. All is read before anything is written: arrays might be one another."""
    w = weight
    x, y, z = w * fine[0], w * fine[1], w * fine[2]
    r, g, b = w * rgb[0], w * rgb[1], w * rgb[2]
    n0, n1, n2 = w * normal[0], w * normal[1], w * normal[2]
    s0, s1, s2, s3, s4 = sums[0] + w, sums[1] + x, sums[2] + y, sums[3] + z, sums[4] + r
    s5, s6, s7, s8, s9 = sums[5] + g, sums[6] + b, sums[7] + n0, sums[8] + n1, sums[9] + n2
    sums[0], sums[1], sums[2], sums[3], sums[4] = s0, s1, s2, s3, s4
    sums[5], sums[6], sums[7], sums[8], sums[9] = s5, s6, s7, s8, s9


@njit(nogil=True, cache=True, error_model="numpy")
def subtract_pixels(pixels: Pixels, table: HashTable, rows: I32, added_at: int) -> None:
    """Subtract pixels from the voxels that they were added to at the time `added_at`.

    Where a voxel was voided since, the pixel is no longer in it, and is cleared in `usable`: it was dynamic.
    """
    keys, fine, rgb, normals, weights, usable = pixels
    slot_key, slot_row = table
    height, width = keys.shape
    rows_above = np.full(width, -1, dtype=np.int32)
    last_key, row = EMPTY, -1
    for y in range(height):
        for x in range(width):
            above, rows_above[x] = rows_above[x], -1
            if usable[y, x] == 0:
                continue
            key = keys[y, x]
            if key != last_key:
                if above >= 0 and keys[y - 1, x] == key:
                    row = above
                else:
                    slot = find_slot(key, slot_key)
                    row = slot_row[slot] if slot_key[slot] != EMPTY else -1
                last_key = key
            rows_above[x] = row
            if row < 0 or rows[row, VOIDED_AT] > added_at:
                usable[y, x] = 0
                continue
            _add(-weights[y, x], fine[y, x], rgb[y, x], normals[y, x], rows[row])
