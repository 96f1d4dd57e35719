"""How far space is from the surface that oriented points are samples of, block by block.

At a grid corner x the signed distance is the mean of n·(x − p) over the points p near it, weighted by nearness (Hoppe
et al., Surface reconstruction from unorganized points, 1992, with the smooth weights of implicit moving least squares:
Kolluri, Provably good moving least squares, 2005). Only corners within two cells of a point have a distance:
nothing is known elsewhere.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
from numba import njit

from stillroom.data.cloud.dense_cloud import DenseCloud
from stillroom.geometry.arrays import F32, F64, I32, I64, U8

BLOCK = 64
"""Cells of a block along an edge."""

REACH = 2
"""Points reach the corners of the 3×3×3 cells around them, which lie less than this many cells away."""

OFFSET_CELLS = 0.37
"""Where the grid starts, so that surfaces at round coordinates do not run through its corners."""

WEIGHT, DISTANCE, NORMAL, RGB = 0, 1, slice(2, 5), slice(5, 8)
"""What is summed at a corner."""


@dataclass(frozen=True)
class Block:
    """A cube of 64×64×64 cells.

    Attributes:
        first_cell: Of its lowest corner (3,).
        sums: At each corner (65, 65, 65, 8): weight, and weighted distance [cells], normal and colour.
        near: How many points lie in the 3×3×3 cells around each cell (64, 64, 64), at most 255.
    """

    first_cell: I64
    sums: F32
    near: U8


def blocks(cloud: DenseCloud, cell_m: float, max_weight: float) -> Iterator[Block]:
    """Yield the blocks that points lie in or at; the arrays of each are used again for the next.

    Corners that blocks share have the very same sums in each.

    Args:
        cloud: The points.
        cell_m: Edge of a cell [m].
        max_weight: A point counts by its weight up to here.
    """
    grid = cloud.positions_m.astype(np.float64) / cell_m - OFFSET_CELLS
    cells = np.floor(grid).astype(np.int64)
    inside = (grid - cells).astype(np.float32)
    weight = np.clip(cloud.weight, 1e-3, max_weight).astype(np.float32)
    sums = np.zeros((BLOCK + 1, BLOCK + 1, BLOCK + 1, RGB.stop), dtype=np.float32)
    near = np.zeros((BLOCK, BLOCK, BLOCK), dtype=np.uint8)
    for block, members in _members(cells):
        first_cell = block * BLOCK
        sums.fill(0.0)
        near.fill(0)
        local = (cells[members] - first_cell).astype(np.int32)
        _splat(local, inside[members], cloud.normals[members], cloud.rgb[members], weight[members], sums, near)
        yield Block(first_cell, sums, near)


def corner_position_m(corners: F64, cell_m: float) -> F64:
    """Return the positions (N, 3) [m, world] of points (N, 3) given in cells of the grid."""
    return (corners + OFFSET_CELLS) * cell_m


def _members(cells: I64) -> Iterator[tuple[I64, I64]]:
    """Yield each block's place (3,) and the points (M,) that reach it, ascending."""
    if len(cells) == 0:
        return
    lowest = cells.min(axis=0) // BLOCK - 1
    size = cells.max(axis=0) // BLOCK + 2 - lowest

    def number(of: I64) -> I64:
        place = of // BLOCK - lowest
        return np.asarray((place[..., 0] * size[1] + place[..., 1]) * size[2] + place[..., 2], dtype=np.int64)

    own = number(cells)
    within = cells % BLOCK
    at_border = np.flatnonzero(((within < REACH) | (within >= BLOCK - REACH)).any(axis=1))
    found = [own * len(cells) + np.arange(len(cells))]
    for shift in product((-REACH, 0, REACH), repeat=3):
        found.append(number(cells[at_border] + np.array(shift)) * len(cells) + at_border)
    pairs = np.sort(np.concatenate(found))  # np.unique would take five times as long over them
    in_block, member = np.divmod(pairs[np.r_[True, pairs[1:] != pairs[:-1]]], len(cells))
    starts = np.flatnonzero(np.r_[True, in_block[1:] != in_block[:-1]])
    for start, end in zip(starts, [*starts[1:], len(member)], strict=True):
        yield np.array(np.unravel_index(in_block[start], size)) + lowest, member[start:end]


@njit(nogil=True, cache=True)
def _splat(cells: I32, inside: F32, normals: F32, rgb: U8, weight: F32, sums: F32, near: U8) -> None:
    """Add points to the corners that they reach, and count them in the cells around.

    Args:
        cells: In which cell of the block each lies (N, 3); may be a little outside.
        inside: Where in that cell (N, 3), from 0 to 1.
        normals: (N, 3).
        rgb: (N, 3).
        weight: (N,).
        sums: Changed.
        near: Changed.
    """
    kernel = np.empty((3, 4))
    n_corners, n_cells = sums.shape[0], near.shape[0]
    for i in range(len(cells)):
        for axis in range(3):
            for place in range(4):
                u = 0.5 * (place - 1 - inside[i, axis])
                kernel[axis, place] = max((1.0 - u * u) ** 2, 1e-4)
        for a in range(4):
            x = cells[i, 0] + a - 1
            if x < 0 or x >= n_corners:
                continue
            for b in range(4):
                y = cells[i, 1] + b - 1
                if y < 0 or y >= n_corners:
                    continue
                for c in range(4):
                    z = cells[i, 2] + c - 1
                    if z < 0 or z >= n_corners:
                        continue
                    w = weight[i] * kernel[0, a] * kernel[1, b] * kernel[2, c]
                    distance = (
                        normals[i, 0] * (a - 1 - inside[i, 0])
                        + normals[i, 1] * (b - 1 - inside[i, 1])
                        + normals[i, 2] * (c - 1 - inside[i, 2])
                    )
                    at = sums[x, y, z]
                    at[0] += w
                    at[1] += w * distance
                    for k in range(3):
                        at[2 + k] += w * normals[i, k]
                        at[5 + k] += w * rgb[i, k]
                    if a < 3 and b < 3 and c < 3 and x < n_cells and y < n_cells and z < n_cells:
                        near[x, y, z] += near[x, y, z] < 255
