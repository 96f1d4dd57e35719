"""The path L that winds through the image from A to B, over where the points are dense (PSPNet-SLAM, Figure 6)."""

from dataclasses import dataclass, field

import numpy as np

from stillroom.dynamics.ants.colony import ColonyConfig, shortest_found
from stillroom.errors import ConfigError
from stillroom.geometry.arrays import F64, I64

PATHS = ("serpentine", "ants")


@dataclass(frozen=True)
class PathConfig:
    """How the path is laid.

    Attributes:
        kind: serpentine, row by row there and back; or ants, the paper's colony. Both go through the same nodes, so
            that they test almost the same points, and on points that are spread evenly the ants' path is a few percent
            longer; the serpentine costs nothing.
        cell_px: Side of a cell; a node is the mean of the points in one [px].
        min_points: Cells with fewer points have no node.
        colony: The ants.
    """

    kind: str = "serpentine"
    cell_px: int = 80
    min_points: int = 5
    colony: ColonyConfig = field(default_factory=ColonyConfig)

    def lay(self, points_px: F64, seed: int) -> F64:
        """Return the nodes K₀ … Kₙ (n, 2) [px] of the path, in order.

        A is the first node of the uppermost row of cells, B the last one of the lowest.

        Args:
            points_px: Points (N, 2) [px].
            seed: Of the ants.

        Raises:
            ConfigError: There is no such kind of path.
        """
        if self.kind not in PATHS:
            raise ConfigError(f"path.kind is '{self.kind}'; it must be one of {', '.join(PATHS)}")
        nodes_px, cells = density_nodes(points_px, self.cell_px, self.min_points)
        if len(nodes_px) == 0:
            return nodes_px
        order = serpentine(cells)
        if self.kind == "ants":
            return nodes_px[shortest_found(nodes_px, int(order[0]), int(order[-1]), self.colony, seed)]
        return nodes_px[order]


def density_nodes(points_px: F64, cell_px: int, min_points: int) -> tuple[F64, I64]:
    """Return the means (n, 2) [px] of the points in each cell that has enough, and its column and row (n, 2)."""
    if len(points_px) == 0:
        return np.zeros((0, 2)), np.zeros((0, 2), dtype=np.int64)
    cell = np.maximum(points_px * (1.0 / cell_px), 0.0).astype(np.int64)
    n_columns = int(cell[:, 0].max()) + 1
    key = cell[:, 0] + n_columns * cell[:, 1]
    count = np.bincount(key)
    dense = np.flatnonzero(count >= max(1, min_points))
    sums = np.stack([np.bincount(key, points_px[:, axis]) for axis in (0, 1)], axis=1)
    return sums[dense] / count[dense, None], np.stack((dense % n_columns, dense // n_columns), axis=1)


def serpentine(cells: I64) -> I64:
    """Return the order (n,) that visits cells (n, 2), column and row, row by row, every other row backwards."""
    row_rank = np.unique(cells[:, 1], return_inverse=True)[1].ravel()
    along = np.where(row_rank % 2 == 0, cells[:, 0], -cells[:, 0])
    return np.lexsort((along, row_rank)).astype(np.int64)
