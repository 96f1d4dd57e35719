"""The signed distance to the surface sampled by oriented points, block by block.

At a grid corner x the signed distance is the mean of n·(x − p) over the points p near it, weighted by nearness (Hoppe
et al., Surface reconstruction from unorganized points, 1992, with the smooth weights of implicit moving least squares:
Kolluri, Provably good moving least squares, 2005). Only corners within two cells of a point have a distance:
nothing is known elsewhere.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from stillroom.compiled import njit
from stillroom.data.dense_cloud import DenseCloud
from stillroom.errors import MapError
from stillroom.geometry.arrays import F32, F64, I32, I64, U8, Bool

BLOCK = 64
"""Cells of a block along an edge."""

REACH = 3
"""How many cells outside a block points can lie that matter to it: one as far as their distances, and three as to
whether others are alone."""

OFFSET_CELLS = 0.37
"""Where the grid starts, so that surfaces at round coordinates do not run through its corners."""

MAX_NUMBER = 2.0**62
"""Points and blocks together get a number each, which must fit 64 bits."""

WEIGHT, DISTANCE, NORMAL, RGB = 0, 1, slice(2, 5), slice(5, 8)
"""What is summed at a corner."""


@dataclass(frozen=True)
class Block:
    """A cube of 64×64×64 cells.

    Attributes:
        first_cell: Of its lowest corner (3,).
        sums: At each corner (65, 65, 65, 8): weight, and weighted distance [cells], normal and colour.
        is_sampled: Whether a point that is not alone lies in the 3×3×3 cells around each cell (64, 64, 64).
    """

    first_cell: I64
    sums: F32
    is_sampled: Bool


def blocks(cloud: DenseCloud, cell_m: float, max_weight: float, min_points: int) -> Iterator[Block]:
    """Yield the blocks that points lie in or at; the arrays of each are used again for the next.

    Corners that blocks share have the very same sums in each.

    Args:
        cloud: The points.
        cell_m: Edge of a cell [m].
        max_weight: A point counts by its weight up to here.
        min_points: A point is alone if fewer lie in the 5×5×5 cells around it, itself among them.

    Raises:
        MapError: The points lie so far apart that blocks cannot be numbered.
    """
    grid = cloud.positions_m.astype(np.float64) / cell_m - OFFSET_CELLS
    cells = np.floor(grid).astype(np.int64)
    inside = (grid - cells).astype(np.float32)
    weight = np.clip(cloud.weight, 1e-3, max_weight).astype(np.float32)
    sums = np.zeros((BLOCK + 1, BLOCK + 1, BLOCK + 1, RGB.stop), dtype=np.float32)
    counts = np.zeros((BLOCK + 2, BLOCK + 2, BLOCK + 2), dtype=np.uint8)
    is_sampled = np.zeros((BLOCK, BLOCK, BLOCK), dtype=bool)
    for block, members in _members(cells):
        first_cell = block * BLOCK
        sums.fill(0.0)
        counts.fill(0)
        is_sampled.fill(False)
        local = (cells[members] - first_cell).astype(np.int32)
        _splat(local, inside[members], cloud.normals[members], cloud.rgb[members], weight[members], sums)
        _count_around(local, counts)
        _mark_around(local, counts, min_points, is_sampled)
        yield Block(first_cell, sums, is_sampled)


def corner_position_m(corners: F64, cell_m: float) -> F64:
    """Return the positions (N, 3) [m, world] of points (N, 3) given in cells of the grid."""
    return (corners + OFFSET_CELLS) * cell_m


def _members(cells: I64) -> Iterator[tuple[I64, I64]]:
    """Yield each block's place (3,) and the points (M,) that reach it, ascending."""
    if len(cells) == 0:
        return
    lowest = cells.min(axis=0) // BLOCK - 1
    size = cells.max(axis=0) // BLOCK + 2 - lowest
    if float(np.prod(size.astype(np.float64))) * len(cells) > MAX_NUMBER:
        raise MapError("the dense map is too wide for a mesh; are some of its points far away from all others?")

    def number(of: I64) -> I64:
        place = of // BLOCK - lowest
        return np.asarray((place[..., 0] * size[1] + place[..., 1]) * size[2] + place[..., 2], dtype=np.int64)

    own = number(cells)
    within = cells % BLOCK
    at_border = np.flatnonzero(((within < REACH) | (within >= BLOCK - REACH)).any(axis=1))
    found = [own * len(cells) + np.arange(len(cells))]
    for shift in product((-REACH, 0, REACH), repeat=3):
        other = number(cells[at_border] + np.array(shift))
        differs = other != own[at_border]
        found.append(other[differs] * len(cells) + at_border[differs])
    pairs = np.sort(np.concatenate(found))  # np.unique would take five times as long over them
    in_block, member = np.divmod(pairs[np.r_[True, pairs[1:] != pairs[:-1]]], len(cells))
    starts = np.flatnonzero(np.r_[True, in_block[1:] != in_block[:-1]])
    for start, end in zip(starts, [*starts[1:], len(member)], strict=True):
        yield np.array(np.unravel_index(in_block[start], size)) + lowest, member[start:end]


@njit(nogil=True, cache=True)
def _splat(cells: I32, inside: F32, normals: F32, rgb: U8, weight: F32, sums: F32) -> None:
    """Add points to the corners that they reach.

    Args:
        cells: In which cell of the block each lies (N, 3); may be a little outside.
        inside: Where in that cell (N, 3), from 0 to 1.
        normals: (N, 3).
        rgb: (N, 3).
        weight: (N,).
        sums: Changed.
    """
    kernel = np.empty((3, 4))
    n_corners = sums.shape[0]
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


@njit(nogil=True, cache=True)
def _count_around(cells: I32, counts: U8) -> None:
    """Count points, by their cells (N, 3), in the 5×5×5 cells around each, up to 255.

    `counts` is changed; it begins one cell before the block and ends one behind, so that the cells just outside, whose
    points matter to those inside, have all of theirs.
    """
    n = counts.shape[0]
    for i in range(len(cells)):
        for x in range(max(cells[i, 0] - 1, 0), min(cells[i, 0] + 4, n)):
            for y in range(max(cells[i, 1] - 1, 0), min(cells[i, 1] + 4, n)):
                for z in range(max(cells[i, 2] - 1, 0), min(cells[i, 2] + 4, n)):
                    counts[x, y, z] += counts[x, y, z] < 255


@njit(nogil=True, cache=True)
def _mark_around(cells: I32, counts: U8, min_points: int, is_sampled: Bool) -> None:
    """Mark the 3×3×3 cells around each point, by its cell (N, 3), that is not alone."""
    n = is_sampled.shape[0]
    for i in range(len(cells)):
        u, v, w = cells[i, 0], cells[i, 1], cells[i, 2]
        if min(u, v, w) < -1 or max(u, v, w) > n or counts[u + 1, v + 1, w + 1] < min_points:
            continue
        for x in range(max(u - 1, 0), min(u + 2, n)):
            for y in range(max(v - 1, 0), min(v + 2, n)):
                for z in range(max(w - 1, 0), min(w + 2, n)):
                    is_sampled[x, y, z] = True
