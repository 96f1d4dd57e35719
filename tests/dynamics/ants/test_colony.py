"""The colony against brute force, and its equations against their text."""

from itertools import permutations

import numpy as np
import pytest

from stillroom.dynamics.ants.colony import ColonyConfig, lay, length_px, shortest_found, walk


def nodes(seed: int, n: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform((0, 0), (640, 480), (n, 2))


def path_of(px: np.ndarray, start: int, end: int, config: ColonyConfig, seed: int) -> np.ndarray:
    draws = np.random.default_rng(seed).random((config.rounds, config.ants, max(1, len(px))))
    return shortest_found(px, start, end, config, draws, np.ones((len(px), len(px))))


@pytest.mark.parametrize("seed", range(6))
def test_many_ants_find_the_shortest_path_of_all_through_few_nodes(seed: int) -> None:
    px = nodes(seed, 7)
    found = path_of(px, 2, 5, ColonyConfig(ants=50, rounds=60, beta=1.5, rho=0.1), seed)
    between = [k for k in range(7) if k not in (2, 5)]
    least = min(length_px(px, np.array([2, *middle, 5])) for middle in permutations(between))
    assert length_px(px, found) == pytest.approx(least)


@pytest.mark.parametrize("n", [2, 3, 4, 40])
def test_every_node_is_visited_once_from_a_to_b(n: int) -> None:
    path = path_of(nodes(1, n), n - 1, 0, ColonyConfig(), seed=0)
    assert sorted(path.tolist()) == list(range(n))
    assert (path[0], path[-1]) == (n - 1, 0)


def test_one_node_and_none() -> None:
    assert path_of(nodes(1, 1), 0, 0, ColonyConfig(), seed=0).tolist() == [0]
    assert len(path_of(np.zeros((0, 2)), 0, 0, ColonyConfig(), seed=0)) == 0


def test_the_same_seed_gives_the_same_path() -> None:
    px = nodes(3, 40)
    paths = [path_of(px, 0, 1, ColonyConfig(), seed).tolist() for seed in (4, 4, 5)]
    assert paths[0] == paths[1]
    assert paths[0] != paths[2]


def test_pheromone_makes_paths_shorter() -> None:
    """With pheromone the colony does better than the same number of ants without."""
    px = [nodes(seed, 30) for seed in range(8)]
    config = {"ants": 10, "rounds": 30, "beta": 3.0}
    lengths = {
        alpha: np.mean([length_px(p, path_of(p, 0, 1, ColonyConfig(alpha=alpha, **config), seed=0)) for p in px])
        for alpha in (0.0, 1.0)
    }
    assert lengths[1.0] < 0.97 * lengths[0.0]


def test_ants_choose_with_the_odds_of_equation_12() -> None:
    attraction = np.array([[0, 1.0, 3.0, 6.0, 0.5], *np.ones((4, 5))])
    n_ants = 20000
    draws = np.random.default_rng(0).random((n_ants, 5))
    tours, lengths = np.empty((n_ants, 5), dtype=np.int64), np.empty(n_ants)
    walk(attraction, np.ones((5, 5)), 0, 4, draws, tours, lengths)
    share = np.bincount(tours[:, 1], minlength=5) / n_ants
    np.testing.assert_allclose(share, [0, 0.1, 0.3, 0.6, 0], atol=0.015)
    assert np.all(lengths == 4)
    # Where two are left, both are as likely; the tabu list holds.
    from_two = tours[tours[:, 1] == 2]
    assert set(from_two[:, 2].tolist()) == {1, 3}
    assert np.mean(from_two[:, 2] == 1) == pytest.approx(0.5, abs=0.03)


def test_each_ant_leaves_its_share_on_its_way() -> None:
    pheromone = np.zeros((4, 4))
    lay(np.array([[0, 1, 2, 3], [0, 2, 1, 3]]), np.array([1.0, 10.0]), pheromone)
    expected = np.zeros((4, 4))
    for i, j, amount in ((0, 1, 1), (1, 2, 11), (2, 3, 1), (0, 2, 10), (1, 3, 10)):
        expected[i, j] = expected[j, i] = amount
    np.testing.assert_array_equal(pheromone, expected)


def test_nodes_in_one_place_do_no_harm() -> None:
    path = path_of(np.zeros((6, 2)), 0, 5, ColonyConfig(), seed=0)
    assert sorted(path.tolist()) == list(range(6))
