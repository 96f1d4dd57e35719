"""The search against a plain one, step by step as Figure 6 has it."""

import cv2
import numpy as np
import pytest

from stillroom.dynamics.ants.colony import PathConfig
from stillroom.dynamics.ants.communities import convex_hull, within
from stillroom.dynamics.ants.search import PheromoneMapConfig, ReverseSearchConfig, exhaustive, first_node_near, search

CONFIG = ReverseSearchConfig()


class Asked:
    """A test that knows the answer, and takes note of what it is asked."""

    def __init__(self, moves: np.ndarray) -> None:
        self.moves, self.asked = moves, []

    def __call__(self, which: np.ndarray) -> np.ndarray:
        self.asked += which.tolist()
        return self.moves[which]


def scene(seed: int, n: int = 900) -> tuple[np.ndarray, np.ndarray]:
    """Points all over the image, two figures among them that move, and a few lone ones."""
    rng = np.random.default_rng(seed)
    points = rng.uniform((0, 0), (640, 480), (n, 2))
    centres = rng.uniform((120, 120), (520, 360), (2, 2))
    moves = np.any(np.linalg.norm((points[:, None] - centres) / (50, 90), axis=2) < 1, axis=1)
    return points, moves | (rng.random(n) < 0.005)


def beside(point: np.ndarray, hull: np.ndarray, margin: float) -> bool:
    """OpenCV's word for whether a point lies in a polygon or near it."""
    return cv2.pointPolygonTest(hull.astype(np.float32)[:, None], point.tolist(), True) >= -margin


def plainly(points: np.ndarray, path: np.ndarray, moves: np.ndarray, radius: float, grow: float) -> tuple[set, list]:
    """Go from node to node; on a hit, widen the hull until nothing new is found; back to the path.

    Groups that come to share a point are one.
    """
    tested: set[int] = set()
    groups = []
    for node in path:
        here = {i for i in range(len(points)) if np.linalg.norm(points[i] - node) <= radius}
        fresh = {i for i in here - tested if moves[i]}
        tested |= here
        members = fresh
        while fresh:
            hull = cv2.convexHull(points[sorted(members)].astype(np.float32))[:, 0]
            around = {i for i in range(len(points)) if beside(points[i], hull, grow)}
            tested |= around
            fresh = {i for i in around if moves[i]} - members
            members = members | fresh
        if members:
            groups = [group for group in groups if not group & members] + [
                members.union(*(group for group in groups if group & members))
            ]
    return tested, groups


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("kind", ["serpentine", "ants"])
def test_finds_and_tests_what_a_walk_from_node_to_node_does(seed: int, kind: str) -> None:
    points, moves = scene(seed)
    points = np.rint(points * 4) / 4  # no point within a rounding error of a margin
    path = PathConfig(kind=kind).build(seed).lay(points)
    test = Asked(moves)
    config = ReverseSearchConfig(radius_px=26.03, grow_px=30.07, min_community=1)
    found = search(points, path, test, config)
    tested, groups = plainly(points, path, moves, 26.03, 30.07)
    assert set(np.flatnonzero(found.is_tested).tolist()) == tested
    np.testing.assert_array_equal(found.is_dynamic, moves & found.is_tested)
    assert sorted(test.asked) == sorted(tested), "each once"
    assert {frozenset(members.tolist()) for members in found.members} == {frozenset(group) for group in groups}


def test_figures_are_found_whole_with_part_of_the_points_tested() -> None:
    shares, recalls = [], []
    for seed in range(10):
        points, moves = scene(seed)
        found = CONFIG.search(points, Asked(moves))
        shares.append(found.share_tested)
        recalls.append(np.mean(found.is_dynamic[moves]))
        assert not np.any(found.is_dynamic & ~moves)
    assert np.mean(shares) < 0.75
    assert np.mean(recalls) > 0.95


def test_with_a_past_more_is_found_than_on_a_first_image() -> None:
    """Figures that walk on by a few pixels an image, among noise that comes and goes."""
    first, later, tested = [], [], []
    for seed in range(6):
        points, moves = scene(seed)
        ants, alone = CONFIG.build(), ReverseSearchConfig(scent=PheromoneMapConfig(enabled=False)).build()
        for step in range(12):
            walked = points + np.where(moves[:, None], (2.0 * step, 0.5 * step), 0.0)
            found = ants.search(walked, Asked(moves))
            ants.remember(walked, found)
        tested.append(found.share_tested)
        later.append(np.mean(found.is_dynamic[moves]))
        first.append(np.mean(alone.search(walked, Asked(moves)).is_dynamic[moves]))
    assert np.mean(later) > 0.95
    assert np.mean(later) >= np.mean(first)
    assert np.mean(tested) < 0.7


def test_beside_a_mask_everything_is_tested() -> None:
    points, _ = scene(3)
    mask = np.zeros((480, 640), dtype=bool)
    mask[100:300, 200:330] = True
    column, row = points.astype(int).T
    points = points[~mask[row, column]]
    ants, nothing = CONFIG.build(), Asked(np.zeros(len(points), dtype=bool))
    for _ in range(8):
        found = ants.search(points, nothing, mask)
        ants.remember(points, found)
    beside_px = np.linalg.norm(np.maximum(0, np.abs(points - (264.5, 199.5)) - (64.5, 99.5)), axis=1)
    assert found.is_tested[beside_px < 20].all()
    assert found.is_tested[beside_px > 60].mean() < 0.5


def test_searching_changes_nothing_that_is_remembered() -> None:
    points, moves = scene(4)
    for kind in ("serpentine", "ants"):
        ants = ReverseSearchConfig(path=PathConfig(kind=kind)).build(1)
        ants.remember(points, ants.search(points, Asked(moves)))
        twice = [ants.search(points, Asked(moves)) for _ in range(2)]
        np.testing.assert_array_equal(twice[0].is_tested, twice[1].is_tested)
        np.testing.assert_array_equal(twice[0].path_px, twice[1].path_px)


def test_where_nothing_moves_only_the_path_is_tested() -> None:
    points, _ = scene(0)
    found = CONFIG.search(points, Asked(np.zeros(len(points), dtype=bool)))
    near = np.linalg.norm(points[:, None] - found.path_px, axis=2).min(axis=1) <= CONFIG.radius_px
    np.testing.assert_array_equal(found.is_tested, near)
    assert 0.1 < found.share_tested < 0.5
    assert found.hulls == ()


def test_a_wide_circle_tests_everything() -> None:
    points, moves = scene(1)
    found = ReverseSearchConfig(radius_px=1000.0).search(points, Asked(moves))
    assert found.is_tested.all()
    np.testing.assert_array_equal(found.is_dynamic, exhaustive(points, Asked(moves)))


def test_a_lone_point_is_no_community() -> None:
    points, _ = scene(2)
    path = PathConfig().build(0).lay(points)
    moves = np.zeros(len(points), dtype=bool)
    moves[np.argmin(np.linalg.norm(points - path[5], axis=1))] = True
    found = search(points, path, Asked(moves), CONFIG)
    np.testing.assert_array_equal(found.is_dynamic, moves)
    assert found.hulls == ()
    assert len(search(points, path, Asked(moves), ReverseSearchConfig(min_community=1)).hulls) == 1


def test_no_points() -> None:
    found = CONFIG.search(np.zeros((0, 2)), Asked(np.zeros(0, dtype=bool)))
    assert len(found.is_dynamic) == 0
    assert found.share_tested == 0.0


def test_first_node_near_is_the_first_along_the_path() -> None:
    points = np.array([[0.0, 0], [10, 0], [100, 0]])
    node = np.full(3, -1)
    first_node_near(points, np.array([[12.0, 0], [4, 0], [5, 0]]), 8.0, node)
    assert node.tolist() == [1, 0, -1]


@pytest.mark.parametrize("seed", range(5))
def test_the_hull_and_what_lies_beside_it_are_opencvs(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.uniform(0, 300, (80, 2)).round(1)
    points = points[np.lexsort(points.T[::-1])]
    member = rng.random(80) < 0.2
    hull = np.empty((81, 2))
    n = convex_hull(points, member, hull)
    expected = cv2.convexHull(points[member].astype(np.float32))[:, 0].astype(float)
    assert sorted(map(tuple, hull[:n].round(3).tolist())) == sorted(map(tuple, expected.round(3).tolist()))
    near = np.empty(80, dtype=bool)
    within(points, hull[:n], 20.001, near)
    np.testing.assert_array_equal(near, [beside(point, hull[:n], 20.001) for point in points])
    assert 10 < near.sum() < 80 or near[member].all()


@pytest.mark.parametrize(
    ("members", "corners"),
    [
        ([[5.0, 5.0]], 1),
        ([[5.0, 5.0], [5.0, 5.0]], 1),
        ([[0.0, 0.0], [10.0, 10.0]], 2),
        ([[0.0, 0.0], [5.0, 5.0], [10.0, 10.0]], 2),
        ([[5.0, 0.0], [5.0, 9.0], [5.0, 4.0]], 2),
    ],
)
def test_hulls_without_an_area(members: list, corners: int) -> None:
    points = np.array([*sorted(members), [100.0, 100.0]])
    hull, near = np.empty((len(points) + 1, 2)), np.empty(len(points), dtype=bool)
    n = convex_hull(points, np.arange(len(points)) < len(members), hull)
    assert n == corners
    within(points, hull[:n], 1.0, near)
    assert near.tolist() == [True] * len(members) + [False]
    within(np.array([[7.0, 3.0]]), hull[:n], 3.0, near[:1])
    assert near[0] == (min(np.hypot(*(p - (7, 3))) for p in points[:-1]) <= 3 or len({*map(tuple, members)}) > 1)
