"""Places must be met several times in a row."""

import numpy as np

from stillroom.data.map import Covisibility
from stillroom.loops.detection import ConsistentGroups


def neighbourhoods(n: int, reach: int) -> Covisibility:
    """A walk: keyframes up to `reach` apart see the same points."""
    graph = Covisibility()
    for k in range(n):
        counts = np.array([100 if 0 < abs(k - other) <= reach else 0 for other in range(n)], dtype=np.int32)
        graph.connect(k, counts)
    return graph


GRAPH = neighbourhoods(60, 2)


def test_three_in_a_row_at_one_place_are_enough_and_two_are_not() -> None:
    groups = ConsistentGroups(3)
    assert groups.confirmed([10], GRAPH) == []
    assert groups.confirmed([12], GRAPH) == []
    assert groups.confirmed([14], GRAPH) == [14]
    assert groups.confirmed([15], GRAPH) == [15]


def test_a_keyframe_without_candidates_breaks_the_row() -> None:
    groups = ConsistentGroups(3)
    for candidates in ([10], [10], [], [10], [10]):
        assert groups.confirmed(candidates, GRAPH) == []
    assert groups.confirmed([10], GRAPH) == [10]


def test_places_that_change_each_time_are_chance() -> None:
    groups = ConsistentGroups(3)
    for candidate in (10, 40, 20, 50, 30, 3):
        assert groups.confirmed([candidate], GRAPH) == []


def test_several_places_are_followed_at_once_and_come_out_in_order() -> None:
    groups = ConsistentGroups(2)
    assert groups.confirmed([40, 10], GRAPH) == []
    assert groups.confirmed([11, 25, 41], GRAPH) == [11, 41]
    groups.forget()
    assert groups.confirmed([11, 41], GRAPH) == []


def test_groups_that_touch_in_one_keyframe_belong_together() -> None:
    groups = ConsistentGroups(2)
    groups.confirmed([10], GRAPH)  # 8 … 12
    assert groups.confirmed([14], GRAPH) == [14]  # 12 … 16
    groups.forget()
    groups.confirmed([10], GRAPH)
    assert groups.confirmed([15], GRAPH) == []  # 13 … 17
