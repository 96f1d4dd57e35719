"""What the comparison counts and times."""

from itertools import count

import numpy as np
import pytest

from stillroom.dynamics.ants.comparison import PointSet, compare, total
from stillroom.dynamics.ants.search import PheromoneMapConfig, ReverseSearchConfig

POINTS = np.random.default_rng(0).uniform((0, 0), (640, 480), (700, 2))
MOVES = np.linalg.norm(POINTS - (300, 250), axis=1) < 70
NEW = ReverseSearchConfig(scent=PheromoneMapConfig(enabled=False))


def points(moves: np.ndarray = MOVES, **more: object) -> PointSet:
    return PointSet(POINTS, lambda which: moves[which], **more)


def compared(what: PointSet, **options: object):
    return compare(what, {"one": NEW.build()}, **options)["one"]


def test_counts_what_the_search_found_and_missed() -> None:
    moves = MOVES.copy()
    moves[np.argmin(np.linalg.norm(POINTS - (5, 5), axis=1))] = True  # a corner that no path leads past
    found = NEW.search(POINTS, lambda which: moves[which])
    result = compared(points(moves))
    assert (result.n_images, result.n_points, result.n_dynamic) == (1, 700, moves.sum())
    assert result.n_tested == found.is_tested.sum()
    assert result.share_tested == pytest.approx(found.share_tested)
    assert result.n_found == (found.is_dynamic & moves).sum() == moves.sum() - 1
    assert result.recall == pytest.approx(result.n_found / moves.sum())
    assert result.precision == 1.0
    assert result.exhaustive_s > 0
    assert result.test_s == pytest.approx(result.exhaustive_s / 700)


def test_the_fastest_of_the_repeats_counts_and_path_and_memory_are_paid_for() -> None:
    ticks = count()  # each look at the clock is a second later
    result = compared(points(grow=lambda moves: None), clock=lambda: float(next(ticks)))
    assert (result.exhaustive_s, result.path_s, result.search_s) == (1.0, 1.0, 2.0)
    assert (result.exhaustive_growing_s, result.growing_s) == (1.0, 1.0)
    assert result.time_ratio == pytest.approx(2.0)
    assert result.time_ratio_with_growing == pytest.approx(1.5)


def test_regions_grow_from_what_each_way_found() -> None:
    moves = MOVES.copy()
    moves[np.argmin(np.linalg.norm(POINTS - (5, 5), axis=1))] = True
    grown = []
    compared(points(moves, grow=lambda found: grown.append(found.sum())), repeats=1)
    assert grown == [moves.sum(), MOVES.sum()]


def test_each_search_takes_what_it_found_as_its_past() -> None:
    searches = {"with": ReverseSearchConfig().build(), "without": NEW.build()}
    images = [compare(points(), searches) for _ in range(9)]
    assert images[0]["with"].n_tested == 700, "before there is a past, all are"
    assert images[8]["with"].n_tested < 500
    assert images[8]["with"].recall == 1.0
    assert images[8]["without"].n_tested == images[0]["without"].n_tested


def test_nothing_moves_and_no_points() -> None:
    still = compared(points(np.zeros(700, dtype=bool)))
    assert (still.recall, still.precision, still.n_found) == (1.0, 1.0, 0)
    none = compared(PointSet(np.zeros((0, 2)), lambda which: np.zeros(len(which), dtype=bool)))
    assert (none.share_tested, none.recall) == (0.0, 1.0)


def test_a_total_adds_up() -> None:
    part = compared(points())
    both = total([part, part])
    assert (both.n_images, both.n_points) == (2, 1400)
    assert both.share_tested == pytest.approx(part.share_tested)
    assert both.exhaustive_s == pytest.approx(2 * part.exhaustive_s)
    assert both.test_s == pytest.approx(part.test_s)
