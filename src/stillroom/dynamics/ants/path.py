"""The path L that winds through the image from A to B, over where the points are dense (PSPNet-SLAM, Figure 6)."""

from dataclasses import dataclass, field

import numba
import numpy as np

from stillroom.bounds import bounded, check
from stillroom.dynamics.ants.colony import ColonyConfig, shortest_found
from stillroom.geometry.arrays import F64, I64

PATHS = ("serpentine", "ants")
GRID = 16
"""Cells a side; what lies beyond is taken to lie in the last."""
SHIFTS = ((0, 0), (1, 1), (1, 0), (0, 1))
"""By how many half cells the cells are shifted in four images, to the left and up."""


@dataclass(frozen=True)
class PathConfig:
    """How the path is laid.

    Attributes:
        kind: serpentine, row by row there and back; or ants, the paper's colony. Both go through the same nodes, so
            that they test the same points, and on points that are spread evenly the ants' path is a few percent
            longer; the serpentine costs nothing.
        cell_px: Side of a cell; a node is the mean of the points in one [px].
        min_points: Cells with fewer points have no node.
        shifts: Whether the cells lie elsewhere in each of four images, by half a cell: what one path misses, the next
            may come upon.
        colony: The ants.
    """

    kind: str = bounded("serpentine", one_of=PATHS)
    cell_px: int = bounded(80, least=1)
    min_points: int = bounded(5, least=1)
    shifts: bool = True
    colony: ColonyConfig = field(default_factory=ColonyConfig)

    def build(self, seed: int = 0) -> "PathLayer":
        """Return what lays paths; the seed is that of the ants."""
        check(self, "path")
        return PathLayer(self, seed)


class PathLayer:
    """Lays paths. Ants leave pheromone between cells of the image, which the ants of the next image find."""

    def __init__(self, config: PathConfig, seed: int = 0) -> None:
        """Start without pheromone."""
        self.config = config
        # The same draws for every image: what differs is what the ants find.
        self._draws = np.random.default_rng(seed).random((config.colony.rounds, config.colony.ants, GRID * GRID))
        self._trails = np.ones((GRID * GRID, GRID * GRID)) if config.kind == "ants" else None
        self._last = np.zeros(0, dtype=np.int64)
        self._n_images = 0

    def lay(self, points_px: F64) -> F64:
        """Return the nodes K₀ … Kₙ (n, 2) [px] of the path through points (N, 2), in order.

        A is the first node of the uppermost row of cells, B the last one of the lowest.
        """
        cell_px = self.config.cell_px
        shift_px = 0.5 * cell_px * np.array(SHIFTS[self._n_images % len(SHIFTS) if self.config.shifts else 0])
        nodes_px, cells = density_nodes(points_px, cell_px, self.config.min_points, shift_px)
        order = serpentine(cells)
        if self._trails is None or len(order) == 0:
            return nodes_px[order]
        number = cells[:, 0] + GRID * cells[:, 1]
        pheromone = self._trails[np.ix_(number, number)]
        a, b = int(order[0]), int(order[-1])
        order = shortest_found(nodes_px, a, b, self.config.colony, self._draws, pheromone)
        self._last = number[order]
        return nodes_px[order]

    def remember(self) -> None:
        """Let the pheromone evaporate, and renew it along the last path (Eq. 14)."""
        self._n_images += 1
        if self._trails is None or len(self._last) == 0:
            return
        here, there, rho = self._last[:-1], self._last[1:], self.config.colony.rho
        seen = np.ix_(self._last, self._last)
        self._trails[seen] = (1.0 - rho) * self._trails[seen] + rho
        self._trails[here, there] += 1.0
        self._trails[there, here] += 1.0


def density_nodes(points_px: F64, cell_px: int, min_points: int, shift_px: F64) -> tuple[F64, I64]:
    """Return the means (n, 2) [px] of the points in each cell that has enough, and its column and row (n, 2).

    The first cell begins so much (2,) to the left of the image and above it.
    """
    sums, count = np.zeros((GRID, GRID, 2)), np.zeros((GRID, GRID), dtype=np.int64)
    add_to_cells(np.ascontiguousarray(points_px, dtype=np.float64), cell_px, shift_px, sums, count)
    row, column = np.nonzero(count >= max(1, min_points))
    return sums[row, column] / count[row, column, None], np.stack((column, row), axis=1)


def serpentine(cells: I64) -> I64:
    """Return the order (n,) that visits cells (n, 2), column and row, row by row, every other row backwards."""
    row_rank = np.unique(cells[:, 1], return_inverse=True)[1].ravel()
    along = np.where(row_rank % 2 == 0, cells[:, 0], -cells[:, 0])
    return np.lexsort((along, row_rank)).astype(np.int64)


@numba.njit(nogil=True, cache=True)
def add_to_cells(points_px: F64, cell_px: int, shift_px: F64, sums: F64, count: I64) -> None:
    """Add points (N, 2) to the sums (rows, columns, 2) and counts (rows, columns) of their cells."""
    for i in range(len(points_px)):
        column = min(max(int((points_px[i, 0] + shift_px[0]) / cell_px), 0), count.shape[1] - 1)
        row = min(max(int((points_px[i, 1] + shift_px[1]) / cell_px), 0), count.shape[0] - 1)
        sums[row, column] += points_px[i]
        count[row, column] += 1
