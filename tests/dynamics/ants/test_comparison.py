"""What the comparison counts and times."""

from itertools import count

import numpy as np
import pytest

from stillroom.dynamics.ants.comparison import compare, total
from stillroom.dynamics.ants.search import ReverseSearchConfig

POINTS = np.random.default_rng(0).uniform((0, 0), (640, 480), (700, 2))
MOVES = np.linalg.norm(POINTS - (300, 250), axis=1) < 70


def test_counts_what_the_search_found_and_missed() -> None:
    moves = MOVES.copy()
    moves[np.argmin(np.linalg.norm(POINTS - (5, 5), axis=1))] = True  # a corner that no path leads past
    config = ReverseSearchConfig()
    found = config.search(POINTS, lambda which: moves[which])
    result = compare(POINTS, lambda which: moves[which], config)
    assert (result.n_points, result.n_dynamic) == (700, moves.sum())
    assert result.n_tested == found.is_tested.sum()
    assert result.share_tested == pytest.approx(found.share_tested)
    assert result.n_found == (found.is_dynamic & moves).sum()
    assert result.recall == pytest.approx(result.n_found / moves.sum())
    assert result.precision == 1.0
    assert result.exhaustive_s > 0
    assert result.test_s == pytest.approx(result.exhaustive_s / 700)


def test_the_fastest_of_the_repeats_counts_and_the_path_is_paid_for() -> None:
    ticks = count()  # each look at the clock is a second later
    result = compare(POINTS, lambda which: MOVES[which], ReverseSearchConfig(), clock=lambda: float(next(ticks)))
    assert (result.exhaustive_s, result.path_s, result.search_s) == (1.0, 1.0, 1.0)
    assert result.time_ratio == pytest.approx(2.0)


def test_nothing_moves_and_no_points() -> None:
    still = compare(POINTS, lambda which: np.zeros(len(which), dtype=bool), ReverseSearchConfig())
    assert (still.recall, still.precision, still.n_found) == (1.0, 1.0, 0)
    none = compare(np.zeros((0, 2)), lambda which: np.zeros(len(which), dtype=bool), ReverseSearchConfig())
    assert (none.share_tested, none.recall) == (0.0, 1.0)


def test_a_total_adds_up() -> None:
    part = compare(POINTS, lambda which: MOVES[which], ReverseSearchConfig())
    both = total([part, part])
    assert both.n_points == 1400
    assert both.share_tested == pytest.approx(part.share_tested)
    assert both.exhaustive_s == pytest.approx(2 * part.exhaustive_s)
    assert both.test_s == pytest.approx(part.test_s)
