"""Six numbers of a list, by hand."""

import pytest

from stillroom.evaluation.trajectory_errors import Spread, Statistics, improvement_percent


def test_statistics_of_a_known_list() -> None:
    s = Statistics.of([1.0, 2.0, 2.0, 7.0])
    assert (s.mean, s.median, s.min, s.max) == (3.0, 2.0, 1.0, 7.0)
    assert s.rmse == pytest.approx(14.5**0.5)
    assert s.std == pytest.approx(5.5**0.5)


def test_spread_over_runs() -> None:
    assert Spread.of([0.4, 0.1, 0.2]) == Spread(median=0.2, mean=pytest.approx(0.7 / 3), min=0.1, max=0.4, n_runs=3)


def test_improvement_is_positive_when_better_and_unknown_against_nothing() -> None:
    assert improvement_percent(0.416, 0.104) == pytest.approx(75.0)
    assert improvement_percent(0.1, 0.2) == pytest.approx(-100.0)
    assert improvement_percent(0.0, 0.2) is None
