"""Pheromone after each step: against a plain colony that follows Eq. 12 to 15 word for word."""

import numpy as np
import pytest

from stillroom.dynamics.ants.colony import ColonyConfig, PathConfig, length_px, shortest_found
from stillroom.dynamics.ants.search import papers_search


def nodes(seed: int, n: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform((0, 0), (640, 480), (n, 2))


def plainly(px: np.ndarray, start: int, end: int, config: ColonyConfig, draws: np.ndarray) -> list[int]:
    """All ants take a step; then all pheromone fades, and each lays its own on the edge it came along."""
    n = len(px)
    d = np.linalg.norm(px[:, None] - px, axis=2)
    nearest = d[d > 0].min()
    tau = np.ones((n, n))
    best, best_px = [], np.inf
    for draw in draws:
        ants = [[start] for _ in range(config.ants)]
        for step in range(1, n):
            laid = np.zeros((n, n))
            for k, tour in enumerate(ants):
                allowed = [j for j in range(n) if j not in tour and j != end] or [end]
                odds = np.array([tau[tour[-1], j] ** config.alpha * d[tour[-1], j] ** -config.beta for j in allowed])
                chosen = np.searchsorted(np.cumsum(odds), draw[k, step] * odds.sum())
                there = allowed[min(chosen, len(allowed) - 1)]
                laid[tour[-1], there] += nearest / d[tour[-1], there]
                laid[there, tour[-1]] += nearest / d[tour[-1], there]
                tour.append(there)
            tau = (1 - config.rho) * tau + laid
        for tour in ants:
            if length_px(px, np.array(tour)) < best_px:
                best, best_px = tour, length_px(px, np.array(tour))
    return best


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("alpha", [1.0, 0.5])
def test_the_colony_walks_as_the_equations_say(seed: int, alpha: float) -> None:
    config = ColonyConfig(alpha=alpha, beta=2.0, rho=0.3, ants=5, rounds=3, deposit="step")
    px = nodes(seed, 14)
    draws = np.random.default_rng(seed).random((config.rounds, config.ants, len(px)))
    found = shortest_found(px, 3, 9, config, draws, np.ones((14, 14)))
    assert found.tolist() == plainly(px, 3, 9, config, draws)


def test_pheromone_of_steps_makes_paths_shorter() -> None:
    """With pheromone the colony does better than the same number of ants without."""
    lengths = {}
    for alpha in (0.0, 1.0):
        config = ColonyConfig(alpha=alpha, ants=10, rounds=30, beta=3.0, rho=0.1, deposit="step")
        lengths[alpha] = 0.0
        for seed in range(8):
            px = nodes(seed, 30)
            draws = np.random.default_rng(0).random((config.rounds, config.ants, len(px)))
            path = shortest_found(px, 0, 1, config, draws, np.ones((30, 30)))
            assert sorted(path.tolist()) == list(range(30))
            lengths[alpha] += length_px(px, path)
    assert lengths[1.0] < 0.97 * lengths[0.0]


def test_many_steps_do_not_fade_a_way_out() -> None:
    config = ColonyConfig(rho=0.9, ants=2, rounds=40, deposit="step")
    px = nodes(0, 60)
    draws = np.random.default_rng(0).random((config.rounds, config.ants, len(px)))
    assert sorted(shortest_found(px, 0, 1, config, draws, np.ones((60, 60))).tolist()) == list(range(60))


def test_the_papers_search_is_as_printed() -> None:
    config = papers_search()
    assert (config.path.kind, config.path.colony.deposit) == ("ants", "step")
    assert not config.path.shifts
    assert not config.scent.enabled
    assert PathConfig().colony.deposit == "round", "what others use stays as it was"
