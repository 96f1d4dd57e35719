"""Nodes where points are dense, and the way through them."""

import numpy as np
import pytest

from stillroom.dynamics.ants.colony import length_px
from stillroom.dynamics.ants.path import PathConfig, density_nodes, serpentine
from stillroom.errors import ConfigError


def test_a_node_is_the_mean_of_the_points_in_a_dense_cell() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform((0, 0), (640, 480), (300, 2))
    nodes, cells = density_nodes(points, 100, 5)
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
    nodes, cells = density_nodes(points, 80, 2)
    np.testing.assert_allclose(nodes, [[15, 14]])
    assert cells.tolist() == [[0, 0]]


def test_the_serpentine_goes_there_and_back() -> None:
    cells = np.array([[0, 0], [1, 0], [2, 0], [0, 1], [2, 1], [1, 3], [2, 3]])
    order = serpentine(cells)
    assert cells[order].tolist() == [[0, 0], [1, 0], [2, 0], [2, 1], [0, 1], [1, 3], [2, 3]]


@pytest.mark.parametrize("kind", ["serpentine", "ants"])
def test_both_go_through_the_same_nodes_from_a_to_b(kind: str) -> None:
    points = np.random.default_rng(1).uniform((0, 0), (640, 480), (800, 2))
    plain, path = PathConfig().lay(points, 0), PathConfig(kind=kind).lay(points, 0)
    np.testing.assert_allclose(sorted(map(tuple, path)), sorted(map(tuple, plain)))
    np.testing.assert_array_equal(path[[0, -1]], plain[[0, -1]])
    np.testing.assert_array_equal(path, PathConfig(kind=kind).lay(points, 0))


def test_on_points_in_a_ring_ants_go_round_where_the_serpentine_goes_to_and_fro() -> None:
    angle = np.linspace(0, 2 * np.pi, 600, endpoint=False)
    ring = np.stack((320 + 220 * np.cos(angle), 240 + 220 * np.sin(angle)), axis=1)
    lengths = {}
    for kind in ("serpentine", "ants"):
        path = PathConfig(kind=kind, cell_px=60).lay(ring, 0)
        lengths[kind] = length_px(path, np.arange(len(path)))
    assert lengths["ants"] < 0.7 * lengths["serpentine"]


@pytest.mark.parametrize("kind", ["serpentine", "ants"])
def test_no_points_no_path(kind: str) -> None:
    assert PathConfig(kind=kind).lay(np.zeros((0, 2)), 0).shape == (0, 2)
    assert PathConfig(kind=kind).lay(np.array([[3.0, 4.0]]), 0).shape == (0, 2)


def test_an_unknown_path_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"path\.kind is 'snake'.*serpentine, ants"):
        PathConfig(kind="snake").lay(np.zeros((5, 2)), 0)
