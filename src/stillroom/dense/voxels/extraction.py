"""From voxels to a cloud: a surface that noise spread over several voxels becomes one layer."""

import numpy as np

from stillroom.compiled import njit
from stillroom.data.dense_cloud import DenseCloud
from stillroom.dense.voxels.evidence_kernels import mean_positions
from stillroom.dense.voxels.fusing_kernels import COLOUR, FULL_WEIGHT, NORMAL, WEIGHT
from stillroom.dense.voxels.hash_kernels import EMPTY, enter_rows, find_slot, pack
from stillroom.geometry.arrays import F32, I32, I64, Bool

LEAST_AGREEMENT = 0.3
"""Cosine between normals of one surface; the two sides of a board differ in sign."""


def extract(key: I64, rows: I32, voxel_m: float, reach: int) -> DenseCloud:
    """Return the cloud of voxels (N,) with weight, in order of their keys.

    Args:
        key, rows: Keys (N,) and columns (N, 13) of the voxels.
        voxel_m: Edge of a voxel.
        reach: How many voxels to either side along its normal a surface may be smeared; 0 leaves all as they are.
    """
    order = np.argsort(key, kind="stable")
    key, rows = key[order], rows[order]
    weight = rows[:, WEIGHT].copy()
    positions_m = mean_positions(np.arange(len(key), dtype=np.int32), key, rows, voxel_m)
    normals = rows[:, NORMAL : NORMAL + 3].astype(np.float32)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.float32(1e-6))
    if reach > 0:
        n_slots = 1 << int(np.ceil(np.log2(2 * len(key) + 2)))
        slot_key, slot_row = np.full(n_slots, EMPTY, dtype=np.int64), np.zeros(n_slots, dtype=np.int32)
        enter_rows(key, 0, slot_key, slot_row)
        positions_m, is_top = to_one_layer(positions_m, normals, weight, slot_key, slot_row, voxel_m, reach)
    else:
        is_top = np.ones(len(key), dtype=np.bool_)
    rgb = np.rint(rows[is_top, COLOUR : COLOUR + 3] / np.maximum(weight[is_top, None], 1)).astype(np.uint8)
    n_pixels = weight[is_top].astype(np.float32) / np.float32(FULL_WEIGHT)
    return DenseCloud(positions_m[is_top], normals[is_top], rgb, n_pixels, voxel_m)


@njit(nogil=True, cache=True, error_model="numpy")
def to_one_layer(
    positions_m: F32, normals: F32, weight: I32, slot_key: I64, slot_row: I32, voxel_m: float, reach: int
) -> tuple[F32, Bool]:
    """Return which voxels (N,) are the heaviest along their normal, and move them to the mean along it.

    Args:
        positions_m, normals, weight: The voxels.
        slot_key, slot_row: Where each lies in them.
        voxel_m: Edge of a voxel.
        reach: How many voxels to look to either side.

    Returns:
        The moved positions (N, 3), and which are heaviest (N,).
    """
    moved = positions_m.copy()
    is_top = np.ones(len(weight), dtype=np.bool_)
    for i in range(len(weight)):
        nx, ny, nz = normals[i]
        X, Y, Z = positions_m[i]
        total, along, last = float(weight[i]), 0.0, i
        for step in range(-reach, reach + 1):
            length = step * voxel_m
            ix = int(np.floor((X + length * nx) / voxel_m))
            iy = int(np.floor((Y + length * ny) / voxel_m))
            iz = int(np.floor((Z + length * nz) / voxel_m))
            key = pack(ix, iy, iz)
            slot = find_slot(key, slot_key) if key != EMPTY else 0
            if key == EMPTY or slot_key[slot] == EMPTY:
                continue
            j = slot_row[slot]
            if j in (i, last):
                continue
            last = j
            if nx * normals[j, 0] + ny * normals[j, 1] + nz * normals[j, 2] < LEAST_AGREEMENT:
                continue
            if weight[j] > weight[i] or (weight[j] == weight[i] and j < i):
                is_top[i] = False
                break
            distance = nx * (positions_m[j, 0] - X) + ny * (positions_m[j, 1] - Y) + nz * (positions_m[j, 2] - Z)
            total += weight[j]
            along += weight[j] * distance
        shift = along / total
        moved[i, 0] += shift * nx
        moved[i, 1] += shift * ny
        moved[i, 2] += shift * nz
    return moved, is_top
