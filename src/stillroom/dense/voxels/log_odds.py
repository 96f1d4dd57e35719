"""A hashed grid of log-odds: how likely each voxel is occupied, by the rays that hit it and those that pass through."""

import numpy as np

from stillroom.dense.voxels.hash_kernels import EMPTY, enter_rows, find_rows
from stillroom.dense.voxels.ray_kernels import Cells, Scan, Steps, mark_hits, mark_misses
from stillroom.geometry.arrays import F32, I32, I64, U8

FIRST_SLOTS = 1 << 16
ROWS_PER_SLOT = 0.5
"""How full the hash table may become."""


def log_odds_of(probability: float) -> float:
    """Return the log-odds of a probability between 0 and 1."""
    return float(np.log(probability / (1.0 - probability)))


class LogOddsGrid:
    """The voxels that rays have met, in order of arrival; one that none has met is unknown.

    An integer key takes the place of OctoMap's tree: only leaves are kept, at the finest level.

    Attributes:
        n_rows: How many voxels there are.
    """

    def __init__(self, steps: Steps) -> None:
        """Start empty.

        Args:
            steps: What a hit and a miss add, and the bounds of log-odds.
        """
        self.n_rows = 0
        self._steps = steps
        self._cells = _empty_cells(FIRST_SLOTS)

    @property
    def key(self) -> I64:
        """Packed index of each voxel (N,)."""
        return self._cells.key[: self.n_rows]

    @property
    def log_odds(self) -> F32:
        """Log-odds of being occupied (N,) float32."""
        return self._cells.log_odds[: self.n_rows]

    @property
    def n_bytes(self) -> int:
        """Memory that is held."""
        return sum(array.nbytes for array in self._cells)

    def rows_of(self, keys: I64) -> I32:
        """Return the rows (M,) of voxels with keys (M,), −1 for those that no ray has met."""
        rows: I32 = find_rows(keys, self._cells.slot_key, self._cells.slot_row)
        return rows

    def insert(self, scan: Scan, keys: I64, ends: U8) -> None:
        """Insert a scan: hits where rays end, misses where they pass; a voxel changes once, and a hit has priority.

        Args:
            scan: The rays; each scan has a number of its own.
            keys: Keys of the voxels that they end in (h, w).
            ends: Rays whose end is seen (h, w), 0 or 1.
        """
        self._reserve(self.n_rows + int(np.count_nonzero(ends)))
        self.n_rows = mark_hits(keys, ends, scan.number, self._cells, self.n_rows, self._steps)
        ray, n_rays = 0, keys.size
        while ray < n_rays:
            self.n_rows, ray = mark_misses(scan, self._cells, self.n_rows, ray, self._steps)
            if ray < n_rays:
                self._reserve(2 * len(self._cells.key))

    def _reserve(self, n_rows: int) -> None:
        if n_rows <= len(self._cells.key):
            return
        grown = _empty_cells(1 << int(np.ceil(np.log2(n_rows / ROWS_PER_SLOT))))
        n = self.n_rows
        grown.key[:n], grown.log_odds[:n], grown.last_scan[:n] = self.key, self.log_odds, self._cells.last_scan[:n]
        enter_rows(grown.key[:n], 0, grown.slot_key, grown.slot_row)
        self._cells = grown


def _empty_cells(n_slots: int) -> Cells:
    n = int(ROWS_PER_SLOT * n_slots)
    return Cells(
        np.full(n_slots, EMPTY, dtype=np.int64),
        np.zeros(n_slots, dtype=np.int32),
        np.zeros(n, dtype=np.int64),
        np.zeros(n, dtype=np.float32),
        np.zeros(n, dtype=np.int32),
    )
