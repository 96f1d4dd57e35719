"""The covisibility graph."""

import numpy as np

from stillroom.data.map import Covisibility


def counts(*values: int) -> np.ndarray:
    return np.array(values, np.int32)


def test_edges_have_at_least_fifteen_points_and_go_both_ways() -> None:
    graph = Covisibility()
    graph.connect(3, counts(15, 14, 40, 99))
    assert graph.neighbours(3) == [2, 0]
    assert (graph.neighbours(0), graph.neighbours(1), graph.neighbours(2)) == ([3], [], [3])
    assert (graph.weight(3, 2), graph.weight(2, 3), graph.weight(3, 1)) == (40, 40, 0)


def test_a_keyframe_with_weak_edges_only_keeps_the_strongest() -> None:
    graph = Covisibility()
    graph.connect(3, counts(3, 9, 7, 99))
    assert graph.neighbours(3) == [1]
    graph.connect(4, counts(0, 0, 0, 0, 50))
    assert graph.neighbours(4) == []


def test_connecting_again_replaces_the_edges_on_both_sides() -> None:
    graph = Covisibility()
    graph.connect(2, counts(20, 30, 0))
    assert graph.neighbours(0) == [2]
    graph.connect(3, counts(50, 0, 0, 0))
    assert graph.neighbours(0) == [3, 2]
    graph.connect(2, counts(0, 60, 0, 16))
    assert graph.neighbours(2) == [1, 3]
    assert graph.neighbours(0) == [3]
    assert graph.neighbours(3) == [0, 2]
    assert graph.weight(0, 2) == 0


def test_of_equal_ones_the_newest_comes_first_and_at_most_cuts() -> None:
    graph = Covisibility()
    graph.connect(4, counts(20, 30, 20, 30, 0))
    assert graph.neighbours(4) == [3, 1, 2, 0]
    assert graph.neighbours(4, 3) == [3, 1, 2]
    assert graph.neighbours(4, 0) == []


def test_a_removed_keyframe_is_nobodys_neighbour() -> None:
    graph = Covisibility()
    graph.connect(2, counts(20, 30, 0))
    graph.connect(1, counts(18, 0, 30))
    assert graph.neighbours(1) == [2, 0]
    graph.remove(2)
    graph.remove(7)  # never connected
    assert graph.neighbours(1) == [0]
    assert graph.neighbours(0) == [1]
    assert graph.neighbours(2) == []


def test_what_is_returned_may_be_changed_by_the_caller() -> None:
    graph, given = Covisibility(), counts(20, 30, 99)
    graph.connect(2, given)
    assert given.tolist() == [20, 30, 99]
    graph.neighbours(2).clear()
    assert graph.neighbours(2) == [1, 0]
