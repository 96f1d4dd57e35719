"""The sums and moments of planes, against plain numpy."""

import numpy as np
import pytest

from stillroom.geometry.arrays import F32
from stillroom.geometry.cloud.plane_fit import (
    N_TERMS,
    cell_sums,
    extent,
    layers_of,
    middle_eigenvalue,
    parabola_sums,
    plane_misfits,
    renumber,
    solved,
    straighten,
    unbend,
)


def cloud(seed: int = 0) -> F32:
    """Points of a rough tilted surface with holes (30, 40, 3) [m]."""
    rng = np.random.default_rng(seed)
    z = 2.0 + 0.02 * np.arange(40) + rng.normal(size=(30, 40)) * 0.01
    z[rng.random(z.shape) < 0.2] = 0.0
    v, u = np.mgrid[-0.4:0.4:30j, -0.5:0.5:40j]
    return np.stack((u * z, v * z, z), axis=-1).astype(np.float32)


def test_layers_are_points_and_rays() -> None:
    points = cloud().reshape(-1, 3)
    layers, known = layers_of(points), points[:, 2] > 0
    np.testing.assert_array_equal(layers[:3], points.T)
    np.testing.assert_array_equal(layers[3:, known], (points[known, :2] / points[known, 2:]).T)
    assert not layers[:, ~known].any()


def test_misfits_lose_their_parabola() -> None:
    layers, slope = layers_of(cloud().reshape(-1, 3)), np.array([-0.14, -0.01, 0.42])
    known = layers[2] > 0
    off = plane_misfits(layers, slope)
    x, y = layers[3:].astype(np.float64)
    expected = 1.0 / layers[2, known].astype(np.float64) - (slope[0] * x + slope[1] * y + slope[2])[known]
    np.testing.assert_allclose(off[known], expected, atol=1e-6)
    assert np.isinf(off[~known]).all()

    near = np.abs(off) <= 0.006
    assert 300 < near.sum() < known.sum(), "more than one block, but not all"
    terms = np.stack((np.ones_like(x), x, y, x * x, x * y, y * y), axis=1)
    sums, n = parabola_sums(layers, off, 0.006)
    assert n == near.sum()
    np.testing.assert_allclose(sums[:, :N_TERMS], terms[near].T @ terms[near], rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(sums[:, N_TERMS], terms[near].T @ off[near], rtol=1e-4, atol=1e-5)

    parabola = np.array([0.002, 0.01, -0.02, 0.05, 0.03, -0.04])
    bent = off.copy()
    unbend(layers, bent, parabola, 0.006)
    np.testing.assert_allclose(bent[known], (off - np.clip(terms @ parabola, -0.006, 0.006))[known], atol=1e-6)


def test_what_a_wide_parabola_explains_is_subtracted() -> None:
    layers, slope = layers_of(cloud().reshape(-1, 3)), np.array([-0.14, -0.01, 0.42])
    off = plane_misfits(layers, slope)
    near = np.abs(off) <= 0.002 + 0.004
    x, y = layers[3:].astype(np.float64)
    terms = np.stack((np.ones_like(x), x, y, x * x, x * y, y * y), axis=1)
    parabola = np.linalg.solve(terms[near].T @ terms[near] + 1e-3 * np.eye(6), terms[near].T @ off[near])
    assert np.abs(terms @ parabola).max() > 0.004, "the bound has an effect"
    straight = off.copy()
    straighten(layers, straight, 0.002, 0.004)
    known = layers[2] > 0
    np.testing.assert_allclose(straight[known], (off - np.clip(terms @ parabola, -0.004, 0.004))[known], atol=1e-6)

    few = np.ascontiguousarray(layers[:, near][:, :150])
    left = off[near][:150].copy()
    straighten(few, left, 0.002, 0.004)
    np.testing.assert_array_equal(left, off[near][:150])


def test_normal_equations_are_solved_as_numpy_does() -> None:
    rng = np.random.default_rng(0)
    terms = rng.normal(size=(300, 6)) * [1.0, 0.5, 0.4, 0.2, 0.1, 0.02]
    sums = np.hstack((terms.T @ terms, terms.T @ rng.normal(size=(300, 1))))
    expected = np.linalg.solve(sums[:, :6] + 1e-3 * np.eye(6), sums[:, 6])
    np.testing.assert_allclose(solved(sums), expected, rtol=1e-9)


def test_planes_get_other_numbers_and_none_stays_none() -> None:
    plane_of = np.array([0, -1, 2, 1, 0, -1], np.int16)
    renumber(np.array([2, 0, 1]), plane_of)
    np.testing.assert_array_equal(plane_of, [2, -1, 1, 0, 2, -1])


@pytest.mark.parametrize("cell", [1, 5, 7])
def test_sums_of_cells_are_those_of_their_samples(cell: int) -> None:
    points = cloud()
    sums = cell_sums(points, cell)
    assert sums.shape == (30 // cell, 40 // cell, 10)
    for i, j in np.ndindex(sums.shape[:2]):
        own = points[i * cell : (i + 1) * cell, j * cell : (j + 1) * cell].reshape(-1, 3).astype(np.float64)
        own = own[own[:, 2] > 0]
        q = 1.0 / own[:, 2]
        terms = np.stack((np.ones_like(q), own[:, 0] * q, own[:, 1] * q, q), axis=1)
        products = terms.T @ terms
        expected = products[[0, 0, 0, 1, 1, 2, 0, 1, 2, 3], [0, 1, 2, 1, 2, 2, 3, 3, 3, 3]]
        np.testing.assert_allclose(sums[i, j], expected, atol=1e-9)


def test_the_extent_of_a_part_is_its_area_and_smaller_width() -> None:
    points, part_of = cloud(), np.zeros((30, 40), dtype=np.int32)
    part_of[5:20, 10:35] = 3
    part_of[:, 38:] = 3
    layers = layers_of(points.reshape(-1, 3))
    for window, inside in (((0, 0, 40, 30), np.s_[:, :]), ((10, 5, 25, 15), np.s_[5:20, 10:35])):
        own = points[inside][part_of[inside] == 3].astype(np.float64)
        weight = own[:, 2] ** 3 * 0.7
        spread = np.linalg.eigvalsh(np.cov(own.T, aweights=weight, ddof=0))
        area, width_m = extent(layers, part_of, 3, window, 0.7)
        assert area == pytest.approx(weight.sum())
        assert width_m == pytest.approx(np.sqrt(12.0 * spread[1]))
    assert extent(layers, part_of, 4, (0, 0, 40, 30), 0.7) == (0.0, 0.0)


def test_the_middle_eigenvalue_is_that_of_numpy() -> None:
    rng = np.random.default_rng(1)
    for scales in (
        (1.0, 0.5, 0.01),
        (1.0, 1.0, 0.0),
        (2.0, 2.0, 2.0),
        (1.0, 0.0, 0.0),
        (0.0, 0.0, 0.0),
        (3.0, 1e-6, 0.0),
    ):
        Q = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        M = Q @ np.diag(scales) @ Q.T
        found = middle_eigenvalue(M[0, 0], M[0, 1], M[0, 2], M[1, 1], M[1, 2], M[2, 2])
        # Where two eigenvalues are the same, rounding moves them by the root of a float's precision.
        assert found == pytest.approx(sorted(scales)[1], abs=3e-8)
