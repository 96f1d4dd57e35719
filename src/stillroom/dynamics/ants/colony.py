"""An ant colony that looks for a short path through all nodes from A to B (PSPNet-SLAM Eq. 12–15)."""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from stillroom.bounds import bounded, check
from stillroom.compiled import njit
from stillroom.geometry.arrays import F64, I64

PATHS = ("serpentine", "ants")
ROUND, STEP = "round", "step"
DEPOSITS = ROUND, STEP
FAINTEST = 1e-30
"""Pheromone does not fade below this, so that every node can still be chosen."""
GRID = 16
"""Cells a side; points beyond count in the last."""
SHIFTS = ((0, 0), (1, 1), (1, 0), (0, 1))
"""By how many half cells the cells are shifted in four images, to the left and up."""


@dataclass(frozen=True)
class ColonyConfig:
    """The colony. The paper names these numbers without giving values.

    Its pheromone is kept from image to image, so that few ants and rounds suffice.

    Attributes:
        alpha: Weight of the pheromone (α).
        beta: Weight of nearness (β): the greater, the greedier. High, because there are only a few rounds.
        rho: Share of the pheromone that evaporates (ρ), in [0, 1).
        ants: Ants in a round (m).
        rounds: Number of rounds.
        deposit: When pheromone fades and is laid (Eq. 14): after each "round", or after each "step" of all ants, as the
            paper has it.
    """

    alpha: float = 1.0
    beta: float = 6.0
    rho: float = bounded(0.5, least=0, below=1)
    ants: int = bounded(8, least=1)
    rounds: int = bounded(2, least=1)
    deposit: str = bounded(ROUND, one_of=DEPOSITS)


def shortest_found(nodes_px: F64, start: int, end: int, config: ColonyConfig, draws: F64, pheromone: F64) -> I64:
    """Return the shortest path (n,) that the ants find, from node `start` through all others to node `end`.

    The paper gives no formula for Eq. 15's Δτ. After a round each ant lays pheromone in inverse proportion to the
    length of its path (the ant cycle of Dorigo, Maniezzo and Colorni, IEEE Trans. SMC-B 26(1), 1996); after a step, in
    inverse proportion to that of the step (their ant quantity).

    Differs from the paper, by default: pheromone is laid after each round, not after each step; `deposit = "step"` is
    the paper's.

    Args:
        nodes_px: Nodes (n, 2) [px].
        start, end: A and B.
        config: The colony.
        draws: Uniform numbers in [0, 1), (rounds, ants, n or more): the ants' choices.
        pheromone: Initial pheromone on each pair of nodes (n, n).
    """
    n = len(nodes_px)
    if n <= 3:
        between = [k for k in range(n) if k not in (start, end)]
        return np.array(list(dict.fromkeys([start, *between, end])) if n else [], dtype=np.int64)
    best = np.empty(n, dtype=np.int64)
    rules = Rules(config.ants, config.alpha, config.beta, config.rho, config.deposit == STEP)
    let_walk(nodes_px, (start, end), draws, rules, pheromone.copy(), best)
    return best


def length_px(nodes_px: F64, path: I64) -> float:
    """Return the length of a path (n,) over nodes (n, 2) [px]."""
    return float(np.linalg.norm(np.diff(nodes_px[path], axis=0), axis=1).sum())


class Rules(NamedTuple):
    """How ants choose, and how their pheromone fades; see `ColonyConfig`."""

    n_ants: int
    alpha: float
    beta: float
    rho: float
    by_step: bool


@njit(nogil=True, cache=True)
def let_walk(nodes_px: F64, ends: tuple[int, int], draws: F64, rules: Rules, pheromone: F64, best: I64) -> None:
    """Run the rounds of the colony, and write the shortest path (n,) of all; arguments as `shortest_found`."""
    start, end = ends
    n_ants, alpha, beta, rho, by_step = rules
    n = len(nodes_px)
    distance_px, nearness, attraction = np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    for i in range(n):
        for j in range(n):
            dx, dy = nodes_px[i, 0] - nodes_px[j, 0], nodes_px[i, 1] - nodes_px[j, 1]
            distance_px[i, j] = np.sqrt(dx * dx + dy * dy)
            nearness[i, j] = max(distance_px[i, j], 1e-6) ** -beta  # Eq. 13, to the power β
    tours, lengths_px, best_px = np.empty((n_ants, n), dtype=np.int64), np.empty(n_ants), np.inf
    for k in range(len(draws)):
        if by_step:
            walk_together(nearness, distance_px, ends, draws[k], rules, pheromone, tours, lengths_px)
        else:
            for i in range(n):
                for j in range(n):
                    strength = pheromone[i, j] if alpha == 1.0 else pheromone[i, j] ** alpha
                    attraction[i, j] = strength * nearness[i, j]
            walk(attraction, distance_px, start, end, draws[k], tours, lengths_px)
        shortest = np.argmin(lengths_px)
        if lengths_px[shortest] < best_px:
            best[:], best_px = tours[shortest], lengths_px[shortest]
        if not by_step:
            pheromone *= 1.0 - rho
            lay(tours, best_px / np.maximum(lengths_px, 1e-6), pheromone)


@njit(nogil=True, cache=True)
def walk(attraction: F64, distance_px: F64, start: int, end: int, draws: F64, tours: I64, lengths_px: F64) -> None:
    """Build the tour of each ant from start to end, choosing by Eq. 12 among the nodes that it has not visited.

    Args:
        attraction: τ^α η^β of each pair of nodes (n, n).
        distance_px: Their distances (n, n).
        start, end: A and B; B is left for last.
        draws: Uniform numbers (m, n), one a choice.
        tours: The nodes in the order of each ant's visit (m, n); filled in.
        lengths_px: Length of each ant's tour (m,); filled in.
    """
    n = len(attraction)
    allowed = np.empty(n, dtype=np.bool_)
    for k in range(len(tours)):
        allowed[:] = True
        allowed[start] = allowed[end] = False
        tours[k, 0], lengths_px[k] = start, 0.0
        at = start
        for step in range(1, n):
            there = end
            if step < n - 1:
                total = 0.0
                for j in range(n):
                    total += attraction[at, j] * allowed[j]
                left = draws[k, step] * total
                for j in range(n):
                    if allowed[j]:
                        there = j
                        left -= attraction[at, j]
                        if left <= 0.0:
                            break
                allowed[there] = False
            lengths_px[k] += distance_px[at, there]
            tours[k, step] = there
            at = there


@njit(nogil=True, cache=True)
def walk_together(
    nearness: F64,
    distance_px: F64,
    ends: tuple[int, int],
    draws: F64,
    rules: Rules,
    pheromone: F64,
    tours: I64,
    lengths_px: F64,
) -> None:
    """Let all ants take a step by Eq. 12, then let the pheromone fade and lay theirs (Eq. 14–15); until the end.

    A step lays the shortest distance of two nodes over its own length.

    Args:
        nearness: η^β of each pair of nodes (n, n).
        distance_px: Their distances (n, n).
        ends: A and B; B is left for last.
        draws: Uniform numbers (m, n), one a choice.
        rules: α and ρ.
        pheromone: τ of each pair (n, n); changes.
        tours, lengths_px: As `walk`; filled in.
    """
    n, m = len(nearness), len(tours)
    allowed, shortest_px = np.ones((m, n), dtype=np.bool_), np.inf
    allowed[:, ends[0]] = allowed[:, ends[1]] = False
    for i in range(n):
        for j in range(i):
            shortest_px = min(shortest_px, max(distance_px[i, j], 1e-6))
    tours[:, 0] = ends[0]
    lengths_px[:] = 0.0
    attraction = np.empty(n)
    for step in range(1, n):
        for k in range(m):
            at, there = tours[k, step - 1], ends[1]
            if step < n - 1:
                total = 0.0
                for j in range(n):
                    attraction[j] = pheromone[at, j] ** rules.alpha * nearness[at, j] * allowed[k, j]
                    total += attraction[j]
                left = draws[k, step] * total
                for j in range(n):
                    if allowed[k, j]:
                        there = j
                        left -= attraction[j]
                        if left <= 0.0:
                            break
                allowed[k, there] = False
            tours[k, step] = there
            lengths_px[k] += distance_px[at, there]
        for i in range(n):
            for j in range(n):
                pheromone[i, j] = max((1.0 - rules.rho) * pheromone[i, j], FAINTEST)
        for k in range(m):
            i, j = tours[k, step - 1], tours[k, step]
            amount = shortest_px / max(distance_px[i, j], 1e-6)
            pheromone[i, j] += amount
            pheromone[j, i] += amount


@njit(nogil=True, cache=True)
def lay(tours: I64, amounts: F64, pheromone: F64) -> None:
    """Add to the pheromone (n, n) what each ant (m,) leaves on the pairs of nodes of its tour (m, n)."""
    for k in range(len(tours)):
        for step in range(1, tours.shape[1]):
            i, j = tours[k, step - 1], tours[k, step]
            pheromone[i, j] += amounts[k]
            pheromone[j, i] += amounts[k]


# The path L that winds through the image from A to B, over where the points are dense (PSPNet-SLAM, Figure 6).


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
            may find.
        colony: The ants.
    """

    kind: str = bounded("serpentine", one_of=PATHS)
    cell_px: int = bounded(80, least=1, pixels=1)
    min_points: int = bounded(5, least=1)
    shifts: bool = True
    colony: ColonyConfig = field(default_factory=ColonyConfig)

    def build(self, seed: int = 0) -> "PathLayer":
        """Return the path layer; the seed is that of the ants."""
        check(self, "path")
        return PathLayer(self, seed)


class PathLayer:
    """Lays paths. Pheromone between cells of the image is kept for the next image."""

    def __init__(self, config: PathConfig, seed: int = 0) -> None:
        """Start without pheromone."""
        self.config = config
        # The same random numbers for every image.
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
    order = np.argsort(cells[:, 0] + GRID * cells[:, 1], kind="stable")
    turn_back(cells[order, 1], order)
    return order


@njit(nogil=True, cache=True)
def turn_back(row: I64, order: I64) -> None:
    """Reverse every other row of an order (n,) of cells, whose rows (n,) rise."""
    start, is_back = 0, False
    for end in range(1, len(order) + 1):
        if end == len(order) or row[end] != row[start]:
            if is_back:
                order[start:end] = order[start:end][::-1].copy()
            start, is_back = end, not is_back


@njit(nogil=True, cache=True)
def add_to_cells(points_px: F64, cell_px: int, shift_px: F64, sums: F64, count: I64) -> None:
    """Add points (N, 2) to the sums (rows, columns, 2) and counts (rows, columns) of their cells."""
    for i in range(len(points_px)):
        column = min(max(int((points_px[i, 0] + shift_px[0]) / cell_px), 0), count.shape[1] - 1)
        row = min(max(int((points_px[i, 1] + shift_px[1]) / cell_px), 0), count.shape[0] - 1)
        sums[row, column] += points_px[i]
        count[row, column] += 1
