"""Where a voxel lies in the table: 64-bit keys, open addressing, linear probing."""

import numpy as np

from stillroom.compiled import njit
from stillroom.geometry.arrays import F64, I32, I64

AXIS_BITS = 21
HALF = 1 << (AXIS_BITS - 1)
AXIS_MASK = (1 << AXIS_BITS) - 1
EMPTY = -1
"""No key is negative."""

GOLDEN = np.uint64(0x9E3779B97F4A7C15)


@njit(nogil=True, cache=True, error_model="numpy")
def pack(ix: int, iy: int, iz: int) -> int:
    """Return the key of a voxel; −1 for one that lies too far from the origin to have one."""
    if not (-HALF <= ix < HALF and -HALF <= iy < HALF and -HALF <= iz < HALF):
        return EMPTY
    return ((ix + HALF) << (2 * AXIS_BITS)) | ((iy + HALF) << AXIS_BITS) | (iz + HALF)


@njit(nogil=True, cache=True, error_model="numpy")
def find_slot(key: int, slot_key: I64) -> int:
    """Return the slot that holds the key, or the empty one where it belongs. There always is an empty one."""
    mask = len(slot_key) - 1
    mixed = np.uint64(key) * GOLDEN
    mixed = (mixed ^ (mixed >> np.uint64(32))) * GOLDEN  # x lies in the top bits: a product alone keeps it there
    slot = int(mixed >> np.uint64(32)) & mask
    while slot_key[slot] != key and slot_key[slot] != EMPTY:
        slot = (slot + 1) & mask
    return slot


@njit(nogil=True, cache=True, error_model="numpy")
def enter_rows(keys: I64, first_row: int, slot_key: I64, slot_row: I32) -> None:
    """Enter the rows from `first_row` on, of keys (N,), none of which is there yet; the length is a power of two."""
    for row in range(first_row, len(keys)):
        slot = find_slot(keys[row], slot_key)
        slot_key[slot] = keys[row]
        slot_row[slot] = row


@njit(nogil=True, cache=True, error_model="numpy")
def find_rows(keys: I64, slot_key: I64, slot_row: I32) -> I32:
    """Return the rows (N,) of keys (N,), −1 for those that are not in the table."""
    rows = np.full(len(keys), -1, dtype=np.int32)
    for i in range(len(keys)):
        if keys[i] != EMPTY:
            slot = find_slot(keys[i], slot_key)
            if slot_key[slot] != EMPTY:
                rows[i] = slot_row[slot]
    return rows


def unpack(keys: I64) -> I64:
    """Return the indices (N, 3) of voxels with keys (N,)."""
    parts = (keys >> (2 * AXIS_BITS), keys >> AXIS_BITS, keys)
    return np.stack([(part & AXIS_MASK) - HALF for part in parts], axis=1)


def pack_all(indices: I64) -> I64:
    """Return the keys (N,) of voxels with indices (N, 3); −1 for those too far from the origin."""
    shifted = indices + HALF
    keys = (shifted[:, 0] << (2 * AXIS_BITS)) | (shifted[:, 1] << AXIS_BITS) | shifted[:, 2]
    near = np.all((shifted >= 0) & (shifted <= AXIS_MASK), axis=1)
    return np.where(near, keys, EMPTY)


def keys_of(positions_m: F64, voxel_m: float) -> I64:
    """Return the keys (N,) of the voxels that hold positions (N, 3) [m]."""
    return pack_all(np.floor(positions_m / voxel_m).astype(np.int64))
