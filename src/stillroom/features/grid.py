"""Keypoints sorted into square cells, so that a window is searched and not the whole image."""

from typing import NamedTuple

import numpy as np
from numba import njit

from stillroom.geometry.arrays import F32, I32

CELL_PX = 16.0


class Grid(NamedTuple):
    """Cells row by row over the extent of the keypoints.

    Attributes:
        origin_px: Corner of the first cell (2,) float32 [px].
        shape: Rows and columns of cells (2,) int32.
        start: Where each cell's keypoints start in `order` (cells + 1,) int32.
        order: Indices of the keypoints, cell after cell (N,) int32.
    """

    origin_px: F32
    shape: I32
    start: I32
    order: I32


def build_grid(px: F32) -> Grid:
    """Sort keypoints (N, 2) [px] into cells."""
    if len(px) == 0:
        return Grid(np.zeros(2, np.float32), np.ones(2, np.int32), np.zeros(2, np.int32), np.zeros(0, np.int32))
    origin_px = px.min(axis=0)
    extent = px.max(axis=0) - origin_px
    shape = np.array([int(extent[1] // CELL_PX) + 1, int(extent[0] // CELL_PX) + 1], dtype=np.int32)
    start, order = _sort_into_cells(px, origin_px, shape)
    return Grid(origin_px, shape, start, order)


@njit(nogil=True, cache=True)
def _sort_into_cells(px: F32, origin_px: F32, shape: I32) -> tuple[I32, I32]:
    n_cells = shape[0] * shape[1]
    cell = np.empty(len(px), np.int32)
    start = np.zeros(n_cells + 1, np.int32)
    for i in range(len(px)):
        column = int((px[i, 0] - origin_px[0]) / CELL_PX)
        row = int((px[i, 1] - origin_px[1]) / CELL_PX)
        cell[i] = row * shape[1] + column
        start[cell[i] + 1] += 1
    for c in range(n_cells):
        start[c + 1] += start[c]
    fill = start[:-1].copy()
    order = np.empty(len(px), np.int32)
    for i in range(len(px)):
        order[fill[cell[i]]] = i
        fill[cell[i]] += 1
    return start, order
