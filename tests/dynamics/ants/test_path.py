"""Nodes where points are dense, and the way through them."""

import numpy as np
import pytest

from stillroom.dynamics.ants.colony import ColonyConfig, PathConfig, density_nodes, length_px, serpentine
from stillroom.errors import ConfigError


def test_a_node_is_the_mean_of_the_points_in_a_dense_cell() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform((0, 0), (640, 480), (300, 2))
    nodes, cells = density_nodes(points, 100, 5, np.zeros(2))
    expected = []
    for row in range(5):
        for column in range(7):
            inside = [p for p in points if p[0] // 100 == column and p[1] // 100 == row]
            if len(inside) >= 5:
                expected.append((*np.mean(inside, axis=0), column, row))
    assert len(nodes) == len(expected) > 20
    np.testing.assert_allclose(np.hstack((nodes, cells)), expected)


def test_sparse_cells_have_no_node() -> None:
    points = np.array([[10.0, 10], [20, 20], [15, 12], [500, 400]])
    nodes, cells = density_nodes(points, 80, 2, np.zeros(2))
    np.testing.assert_allclose(nodes, [[15, 14]])
    assert cells.tolist() == [[0, 0]]


def test_the_cells_lie_elsewhere_in_each_of_four_images() -> None:
    points = np.random.default_rng(0).uniform((0, 0), (640, 480), (900, 2))
    layer = PathConfig(cell_px=80).build()
    paths = []
    for shift in ((0, 0), (40, 40), (40, 0), (0, 40), (0, 0)):
        expected, cells = density_nodes(points + shift, 80, 5, np.zeros(2))
        paths.append(layer.lay(points))
        np.testing.assert_allclose(paths[-1], expected[serpentine(cells)] - shift)
        layer.remember()
    assert len({path.tobytes() for path in paths}) == 4
    near = [np.linalg.norm(points[:, None] - path, axis=2).min(axis=1) < 18 for path in paths]
    assert np.mean(np.any(near, axis=0)) > 1.5 * np.mean(near[0])


def test_ants_find_shorter_ways_where_ants_have_been() -> None:
    points = np.random.default_rng(2).uniform((0, 0), (640, 480), (900, 2))
    colony = ColonyConfig(ants=4, rounds=1, beta=4.0)
    layer = PathConfig(kind="ants", shifts=False, colony=colony).build()
    lengths = []
    for _ in range(30):
        path = layer.lay(points)
        layer.remember()
        lengths.append(length_px(path, np.arange(len(path))))
    assert np.mean(lengths[-5:]) < 0.95 * lengths[0]


def test_the_serpentine_goes_there_and_back() -> None:
    cells = np.array([[0, 0], [1, 0], [2, 0], [0, 1], [2, 1], [1, 3], [2, 3]])
    order = serpentine(cells)
    assert cells[order].tolist() == [[0, 0], [1, 0], [2, 0], [2, 1], [0, 1], [1, 3], [2, 3]]


@pytest.mark.parametrize("kind", ["serpentine", "ants"])
def test_both_go_through_the_same_nodes_from_a_to_b(kind: str) -> None:
    points = np.random.default_rng(1).uniform((0, 0), (640, 480), (800, 2))
    plain, path = PathConfig().build(0).lay(points), PathConfig(kind=kind).build(0).lay(points)
    np.testing.assert_allclose(sorted(map(tuple, path)), sorted(map(tuple, plain)))
    np.testing.assert_array_equal(path[[0, -1]], plain[[0, -1]])
    np.testing.assert_array_equal(path, PathConfig(kind=kind).build(0).lay(points))


def test_on_points_in_a_ring_ants_go_round_where_the_serpentine_goes_to_and_fro() -> None:
    angle = np.linspace(0, 2 * np.pi, 600, endpoint=False)
    ring = np.stack((320 + 220 * np.cos(angle), 240 + 220 * np.sin(angle)), axis=1)
    lengths = {}
    for kind in ("serpentine", "ants"):
        path = PathConfig(kind=kind, cell_px=60).build(0).lay(ring)
        lengths[kind] = length_px(path, np.arange(len(path)))
    assert lengths["ants"] < 0.7 * lengths["serpentine"]


@pytest.mark.parametrize("kind", ["serpentine", "ants"])
def test_no_points_no_path(kind: str) -> None:
    assert PathConfig(kind=kind).build(0).lay(np.zeros((0, 2))).shape == (0, 2)
    assert PathConfig(kind=kind).build(0).lay(np.array([[3.0, 4.0]])).shape == (0, 2)


def test_an_unknown_path_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"path\.kind' is 'snake'.*serpentine, ants"):
        PathConfig(kind="snake").build(0)
