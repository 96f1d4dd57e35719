"""Blocks of voxels that lie far from the camera, in a file."""

import logging
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stillroom.dense.swap_file import SwapFile
from stillroom.dense.voxels.fusing_kernels import N_COLUMNS, VOIDED_AT
from stillroom.dense.voxels.hash_kernels import EMPTY
from stillroom.dense.voxels.voxel_map import NEVER, VoxelMap, block_centres_m, block_keys_of
from stillroom.geometry.arrays import F64, I64, Bool

logger = logging.getLogger(__name__)

RECORD = np.dtype([("key", "<i8"), ("row", "<i4", (N_COLUMNS,))])
KEPT_SHARE = 0.6
"""After a swap the rows take about this share of their limit, so that the next swap is not immediate."""


class SwappedBlocks:
    """Whole blocks are swapped out and in; no voxel is ever in both places."""

    def __init__(self, folder: Path | None) -> None:
        """Start with nothing swapped."""
        self._file = SwapFile(folder)
        self._blocks: dict[int, tuple[int, int]] = {}

    def __len__(self) -> int:
        """How many blocks lie in the file."""
        return len(self._blocks)

    @property
    def keys(self) -> I64:
        """Keys (B,) of the blocks in the file."""
        return np.fromiter(self._blocks, dtype=np.int64, count=len(self._blocks))

    def out(self, voxels: VoxelMap, max_bytes: float, is_needed: Bool, T_world_cam: F64) -> None:
        """Move blocks out of memory, the farthest from the camera first, until the rest fits.

        Args:
            voxels: The map.
            max_bytes: What it may take.
            is_needed: Blocks (B,) that stay in any case.
            T_world_cam: Pose (4, 4) of the camera.
        """
        keys = voxels.block_keys
        per_row = voxels.n_bytes / max(1, voxels.n_rows)
        surplus = voxels.n_rows - KEPT_SHARE * max_bytes / per_row
        distance_m = np.linalg.norm(block_centres_m(keys, voxels.voxel_m) - T_world_cam[:3, 3], axis=1)
        order = np.argsort(-distance_m, kind="stable")
        order = order[~is_needed[order]]
        rows_in = np.bincount(voxels.block, minlength=len(keys))
        n_out = int(np.searchsorted(np.cumsum(rows_in[order]), surplus)) + 1
        leaving = np.zeros(len(keys), dtype=np.bool_)
        leaving[order[:n_out]] = True
        rows = np.flatnonzero(leaving[voxels.block])
        if len(rows) == 0:
            return
        rows = rows[np.argsort(voxels.block[rows], kind="stable")]
        try:
            self._write(voxels, rows, keys)
        except OSError as error:
            logger.warning("dense map: voxels stay in memory, above the bound: %s", error)
            return
        is_idle = (voxels.weight == 0) & (voxels.rows[:, VOIDED_AT] == NEVER)
        voxels.keep_rows(~leaving[voxels.block] & ~is_idle)

    def back(self, voxels: VoxelMap, block_keys: I64) -> None:
        """Move those of the blocks (B,) that lie in the file back into memory."""
        wanted = [int(key) for key in block_keys if int(key) in self._blocks]
        if not wanted:
            return
        records = np.concatenate([self._read(key, keep=False) for key in wanted])
        voxels.append_rows(records["key"], records["row"])

    def of_pixels(self, voxel_keys: I64) -> I64:
        """Return the blocks (B,) in the file that pixels with voxel keys (h, w) fall into."""
        if not self._blocks:
            return np.zeros(0, dtype=np.int64)
        return np.intersect1d(block_keys_of(voxel_keys[voxel_keys != EMPTY]), self.keys)

    def read_all(self) -> NDArray[np.void]:
        """Return the records of all voxels in the file, which stay there."""
        records = [self._read(key, keep=True) for key in list(self._blocks)]
        return np.concatenate([np.zeros(0, RECORD), *records])

    def _write(self, voxels: VoxelMap, rows: I64, keys: I64) -> None:
        records = np.empty(len(rows), dtype=RECORD)
        records["key"], records["row"] = voxels.key[rows], voxels.rows[rows]
        block = voxels.block[rows]
        starts = np.flatnonzero(np.append(True, block[1:] != block[:-1]))
        written: dict[int, tuple[int, int]] = {}
        for start, stop in zip(starts, np.append(starts[1:], len(rows)), strict=True):
            place = self._file.write(records[start:stop].tobytes())
            written[int(keys[block[start]])] = place, int(stop - start)
        self._blocks |= written

    def _read(self, key: int, keep: bool) -> NDArray[np.void]:
        place, n_rows = self._blocks[key] if keep else self._blocks.pop(key)
        n_bytes = n_rows * RECORD.itemsize
        piece = self._file.read(place, n_bytes) if keep else self._file.take(place, n_bytes)
        return np.frombuffer(piece, dtype=RECORD)
