"""Where it smells of food: where points moved in the last images, and what a network masked in this one."""

from dataclasses import dataclass

import numba
import numpy as np

from stillroom.geometry.arrays import F64, Bool

GRID = 128
"""Cells of the scent a side; what lies beyond is taken to lie in the last."""
MASK_STEP_PX = 8
"""Every so many-th row and column of a mask is looked at."""


@dataclass(frozen=True)
class ScentConfig:
    """What the search knows before it sets out: the pheromone of ants that found food.

    Attributes:
        enabled: Whether it knows anything. Without, every image is searched as if it were the first.
        cell_px: Side of a cell of the image in which moving points leave scent [px].
        reach: How many cells around them, and around masked pixels, smell too: what a network overlooks of a person
            lies beside what it saw of him.
        rho: Share of the scent that evaporates from image to image (ρ of Eq. 14).
        least: Cells that smell less than this are left to the path.
    """

    enabled: bool = True
    cell_px: int = 24
    reach: int = 1
    rho: float = 0.3
    least: float = 0.3


class Scent:
    """Scent by cells of the image, 1 where points moved in the last image."""

    def __init__(self, config: ScentConfig) -> None:
        """Start with scent everywhere: before there is a past, nothing can be left out."""
        self.config = config
        self._strength = np.ones((GRID, GRID))

    def mark(self, points_px: F64, mask: Bool | None, is_marked: Bool) -> None:
        """Mark the points (N, 2) that lie where it smells, (N,), of the past or of a mask (H, W)."""
        config, strength = self.config, self._strength
        if not config.enabled:
            return
        if mask is not None:
            strength = strength.copy()
            renew_by_mask(mask[::MASK_STEP_PX, ::MASK_STEP_PX], strength, config.cell_px / MASK_STEP_PX, config.reach)
        smell(points_px, strength, config.cell_px, config.least, is_marked)

    def leave(self, points_px: F64) -> None:
        """Let the scent evaporate, and renew it around moving points (M, 2)."""
        self._strength *= 1.0 - self.config.rho
        renew(points_px, self._strength, self.config.cell_px, self.config.reach)


@numba.njit(nogil=True, cache=True)
def smell(points_px: F64, strength: F64, cell_px: int, least: float, is_marked: Bool) -> None:
    """Mark the points (N, 2) in cells of at least a strength; the others are left as they are."""
    for i in range(len(points_px)):
        column = min(max(int(points_px[i, 0] / cell_px), 0), strength.shape[1] - 1)
        row = min(max(int(points_px[i, 1] / cell_px), 0), strength.shape[0] - 1)
        if strength[row, column] >= least:
            is_marked[i] = True


@numba.njit(nogil=True, cache=True)
def renew(points_px: F64, strength: F64, cell_px: int, reach: int) -> None:
    """Set the strength of the cells of points (M, 2), and of so many around them, to 1."""
    height, width = strength.shape
    for i in range(len(points_px)):
        column = min(max(int(points_px[i, 0] / cell_px), 0), width - 1)
        row = min(max(int(points_px[i, 1] / cell_px), 0), height - 1)
        strength[max(0, row - reach) : row + reach + 1, max(0, column - reach) : column + reach + 1] = 1.0


@numba.njit(nogil=True, cache=True)
def renew_by_mask(mask: Bool, strength: F64, cell: float, reach: int) -> None:
    """Set the strength of the cells of masked pixels (h, w), and of so many around them, to 1; `cell` is in pixels."""
    height, width = strength.shape
    for v in range(mask.shape[0]):
        for u in range(mask.shape[1]):
            if mask[v, u]:
                row, column = min(int(v / cell), height - 1), min(int(u / cell), width - 1)
                strength[max(0, row - reach) : row + reach + 1, max(0, column - reach) : column + reach + 1] = 1.0
