"""An ant colony that looks for a short path through all nodes from A to B (PSPNet-SLAM Eq. 12–15)."""

from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np

from stillroom.bounds import bounded
from stillroom.geometry.arrays import F64, I64


@dataclass(frozen=True)
class ColonyConfig:
    """The colony. The paper names these numbers without giving values.

    Its pheromone stays from image to image, so that few ants and rounds do.

    Attributes:
        alpha: Weight of the pheromone (α).
        beta: Weight of nearness (β): the greater, the greedier. High, because a few rounds must do.
        rho: Share of the pheromone that evaporates (ρ), in [0, 1).
        ants: How many walk in a round (m).
        rounds: How often they walk; pheromone is laid after each.
    """

    alpha: float = 1.0
    beta: float = 6.0
    rho: float = bounded(0.5, least=0, below=1)
    ants: int = bounded(8, least=1)
    rounds: int = bounded(2, least=1)


def shortest_found(nodes_px: F64, start: int, end: int, config: ColonyConfig, draws: F64, pheromone: F64) -> I64:
    """Return the shortest path (n,) that the ants find, from node `start` through all others to node `end`.

    Differs from the paper: pheromone is laid after each round, by each ant in inverse proportion to the length of its
    path (Eq. 15's Δτ, for which the paper gives no formula), not after each step.

    Args:
        nodes_px: Nodes (n, 2) [px].
        start, end: A and B.
        config: The colony.
        draws: Uniform numbers in [0, 1), (rounds, ants, n or more): the ants' choices.
        pheromone: What lies on each pair of nodes to begin with (n, n).
    """
    n = len(nodes_px)
    if n <= 3:
        between = [k for k in range(n) if k not in (start, end)]
        return np.array(list(dict.fromkeys([start, *between, end])) if n else [], dtype=np.int64)
    best = np.empty(n, dtype=np.int64)
    rules = Rules(config.ants, config.alpha, config.beta, config.rho)
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


@numba.njit(nogil=True, cache=True)
def let_walk(nodes_px: F64, ends: tuple[int, int], draws: F64, rules: Rules, pheromone: F64, best: I64) -> None:
    """Let the ants walk, round after round, and write the shortest path (n,) of all; arguments as `shortest_found`."""
    start, end = ends
    n_ants, alpha, beta, rho = rules
    n = len(nodes_px)
    distance_px, nearness, attraction = np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    for i in range(n):
        for j in range(n):
            dx, dy = nodes_px[i, 0] - nodes_px[j, 0], nodes_px[i, 1] - nodes_px[j, 1]
            distance_px[i, j] = np.sqrt(dx * dx + dy * dy)
            nearness[i, j] = max(distance_px[i, j], 1e-6) ** -beta  # Eq. 13, to the power β
    tours, lengths_px, best_px = np.empty((n_ants, n), dtype=np.int64), np.empty(n_ants), np.inf
    for k in range(len(draws)):
        for i in range(n):
            for j in range(n):
                strength = pheromone[i, j] if alpha == 1.0 else pheromone[i, j] ** alpha
                attraction[i, j] = strength * nearness[i, j]
        walk(attraction, distance_px, start, end, draws[k], tours, lengths_px)
        shortest = np.argmin(lengths_px)
        if lengths_px[shortest] < best_px:
            best[:], best_px = tours[shortest], lengths_px[shortest]
        pheromone *= 1.0 - rho
        lay(tours, best_px / np.maximum(lengths_px, 1e-6), pheromone)


@numba.njit(nogil=True, cache=True)
def walk(attraction: F64, distance_px: F64, start: int, end: int, draws: F64, tours: I64, lengths_px: F64) -> None:
    """Let each ant go once from start to end, choosing by Eq. 12 among the nodes that it has not visited.

    Args:
        attraction: τ^α η^β of each pair of nodes (n, n).
        distance_px: Their distances (n, n).
        start, end: A and B; B is left for last.
        draws: Uniform numbers (m, n), one a choice.
        tours: The nodes in the order of each ant's visit (m, n); filled in.
        lengths_px: How far each ant went (m,); filled in.
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


@numba.njit(nogil=True, cache=True)
def lay(tours: I64, amounts: F64, pheromone: F64) -> None:
    """Add to the pheromone (n, n) what each ant (m,) leaves on the pairs of nodes of its tour (m, n)."""
    for k in range(len(tours)):
        for step in range(1, tours.shape[1]):
            i, j = tours[k, step - 1], tours[k, step]
            pheromone[i, j] += amounts[k]
            pheromone[j, i] += amounts[k]
