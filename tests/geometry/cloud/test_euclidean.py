"""Euclidean clusters against scipy's neighbours and connected components."""

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from stillroom.geometry.arrays import F64, I64
from stillroom.geometry.cloud.euclidean import depth_scaled, euclidean_clusters, join


def by_scipy(points: F64, tolerance: float) -> I64:
    """Clusters numbered as the points come."""
    pairs = cKDTree(points).query_pairs(tolerance, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(points), len(points)))
    _, component = connected_components(graph, directed=False)
    _, first, inverse = np.unique(component, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[inverse]


def sheet(rng: np.random.Generator, n: int) -> F64:
    return rng.random((n, 3)) * (1.0, 1.0, 0.03)


def lattice(rng: np.random.Generator, n: int) -> F64:
    """Points of a lattice, many of them equal: distances of exactly one, two, three tenths."""
    return rng.integers(-9, 10, (n, 3)) * 0.1


def clumps(rng: np.random.Generator, n: int) -> F64:
    return rng.normal(size=(n, 3)) * 0.02 + rng.integers(0, 4, (n, 3))


def far_away(rng: np.random.Generator, n: int) -> F64:
    return rng.random((n, 3)) * 0.5 + (1000.0, -2000.0, 30.0)


@pytest.mark.parametrize("cloud", [sheet, lattice, clumps, far_away])
@pytest.mark.parametrize("tolerance", [0.0, 1e-4, 0.02, 0.05, 0.1, 0.2, 1.0, 50.0])
@pytest.mark.parametrize("n", [1, 2, 30, 1200])
def test_clusters_are_those_of_scipy(cloud, tolerance: float, n: int) -> None:  # type: ignore[no-untyped-def]
    points = cloud(np.random.default_rng(n), n)
    np.testing.assert_array_equal(euclidean_clusters(points, tolerance), by_scipy(points, tolerance))


def test_points_of_two_groups_are_never_in_one_cluster() -> None:
    rng = np.random.default_rng(2)
    points, group = clumps(rng, 600), rng.integers(-1, 3, 600).astype(np.int32)
    found = euclidean_clusters(points, 0.05, group)
    apart = points + 100.0 * group[:, None]
    np.testing.assert_array_equal(found, by_scipy(apart, 0.05))


def test_what_is_joined_before_changes_nothing_where_it_is_near() -> None:
    points = sheet(np.random.default_rng(3), 400)
    pairs = cKDTree(points).query_pairs(0.05, output_type="ndarray")
    joined = np.arange(len(points), dtype=np.int32)
    for i, j in pairs[::3]:
        join(joined, i, j)
    assert (joined != np.arange(len(points))).sum() > 100
    np.testing.assert_array_equal(euclidean_clusters(points, 0.05, None, joined), by_scipy(points, 0.05))


@pytest.mark.parametrize("tolerance", [0.1, 0.3, 1.0 / 3.0, 0.7])
def test_points_at_the_tolerance_exactly_are_neighbours(tolerance: float) -> None:
    chain = np.zeros((50, 3))
    chain[:, 1] = np.arange(50) * tolerance
    # Whatever rounding makes of the steps, it must make the same of them as scipy does.
    np.testing.assert_array_equal(euclidean_clusters(chain, tolerance), by_scipy(chain, tolerance))
    pair = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, tolerance]])
    assert euclidean_clusters(pair, tolerance).tolist() == [0, 0]
    assert euclidean_clusters(pair, np.nextafter(tolerance, 0.0)).tolist() == [0, 1]


def test_no_points_are_no_clusters() -> None:
    assert euclidean_clusters(np.zeros((0, 3)), 0.1).shape == (0,)


def test_many_orders_of_magnitude_do_not_confuse_the_cells() -> None:
    points = np.array([[0.0, 0, 0], [1e-9, 0, 0], [1e6, 1e6, 1e6], [1e6, 1e6, 1e6 + 1e-3], [-1e6, 3.0, 0]])
    for tolerance in (1e-12, 1e-9, 2e-3, 1.0):
        np.testing.assert_array_equal(euclidean_clusters(points, tolerance), by_scipy(points, tolerance))


@pytest.mark.parametrize("tolerance", [-0.1, float("nan")])
def test_impossible_tolerances_are_refused(tolerance: float) -> None:
    with pytest.raises(ValueError, match="tolerance"):
        euclidean_clusters(np.zeros((2, 3)), tolerance)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_points_that_are_not_finite_are_refused(value: float) -> None:
    with pytest.raises(ValueError, match="finite"):
        euclidean_clusters(np.array([[0.0, 0.0, value]]), 0.1)


def test_scaled_distances_are_tolerances_at_every_depth() -> None:
    rng = np.random.default_rng(4)
    z = np.array([0.3, 1.0, 2.0, 2.5, 4.0, 8.0])
    points = np.stack((0.3 * z, -0.2 * z, z), axis=1)
    tolerance_m = np.maximum(0.04, 0.02 * z)
    steps = rng.normal(size=(6, 3))
    # Tangential steps are exact to first order; along the ray too.
    for direction in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.3, -0.2, 1.0)):
        steps = np.tile(direction, (6, 1)) / np.linalg.norm(direction) * 1e-4 * tolerance_m[:, None]
        moved = depth_scaled(points + steps, 0.04, 0.02) - depth_scaled(points, 0.04, 0.02)
        np.testing.assert_allclose(np.linalg.norm(moved, axis=1), 1e-4, rtol=0.08)


def test_scaled_space_has_no_seam() -> None:
    either_side = np.array([[0.5, 0.4, 2.0 - 1e-9], [0.5, 0.4, 2.0 + 1e-9]])
    near, far = depth_scaled(either_side, 0.04, 0.02)
    np.testing.assert_allclose(near, far, atol=1e-6)


def test_without_growth_space_is_merely_scaled() -> None:
    points = np.random.default_rng(0).random((10, 3))
    np.testing.assert_allclose(depth_scaled(points, 0.04, 0.0), points / 0.04)
