"""Large bundles are solved sparsely: the same answer as densely, and as GTSAM's."""

import numpy as np
import pytest
from bundle_problems import huber_cost
from optimize_problems import CAMERA, predict

from stillroom.geometry import se3
from stillroom.optimize import reduced_system
from stillroom.optimize.bundle import BundleConfig, BundleProblem, BundleResult
from stillroom.optimize.bundle_kernels import Blocks, Order, factor_points
from stillroom.optimize.reduced_system import DenseSystem, SparseSystem


def walk(seed: int, keyframes: int = 30, points: int = 600) -> BundleProblem:
    """A long walk past a wall: only neighbours share points, so most of the reduced matrix is zero."""
    rng = np.random.default_rng(seed)
    T_true = np.stack([se3.exp(np.array([-0.8 * k, 0, 0, *(0.05 * rng.normal(size=3))])) for k in range(keyframes)])
    world = np.column_stack(
        (rng.uniform(-2, 0.8 * keyframes + 2, points), rng.uniform(-1, 1, points), rng.uniform(2, 5, points))
    )
    keyframe, point = np.divmod(np.arange(keyframes * points), points)
    seen = np.stack([predict(T, world) for T in T_true]).reshape(-1, 3)
    inside = (seen[:, 0] > 0) & (seen[:, 0] < 640) & (seen[:, 1] > 0) & (seen[:, 1] < 480)
    observed = seen[inside] + rng.normal(size=(inside.sum(), 3))
    observed[rng.random(len(observed)) < 0.03, :2] += 40.0
    T_start = np.stack([se3.exp(np.append(0.02 * rng.normal(size=3), 0.005 * rng.normal(size=3))) @ T for T in T_true])
    is_fixed = np.zeros(keyframes, dtype=bool)
    is_fixed[0] = True
    return BundleProblem(
        T_start,
        is_fixed,
        world + 0.02 * rng.normal(size=world.shape),
        keyframe[inside].astype(np.int32),
        point[inside].astype(np.int32),
        observed,
        np.ones_like(observed),
    )


@pytest.mark.parametrize("seed", range(3))
def test_a_step_is_the_same_sparsely_and_densely(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n_free, n_points = 9, 60
    lists = [np.sort(rng.choice(np.arange(-1, n_free), rng.integers(1, 6), replace=seed == 2)) for _ in range(n_points)]
    starts = np.concatenate(([0], np.cumsum([len(one) for one in lists]))).astype(np.int64)
    slots = np.concatenate(lists).astype(np.int64)
    W = rng.normal(size=(len(slots), 3, 6))
    H_pp, factors = np.zeros((n_points, 6)), np.empty((n_points, 6))
    H_pp[:, [0, 2, 5]] = 20.0 + rng.random((n_points, 3))
    factor_points(H_pp, 0.1, factors)
    root = rng.normal(size=(n_free, 6, 6))
    H_cc = root @ np.swapaxes(root, 1, 2) + 60.0 * np.eye(6)
    blocks = Blocks(H_cc, rng.normal(size=(n_free, 6)), H_pp, rng.normal(size=(n_points, 3)), W)
    order = Order(starts, slots)
    dense = DenseSystem(n_free, order).solve(blocks, factors, 0.1)
    sparse = SparseSystem(n_free, order).solve(blocks, factors, 0.1)
    assert dense is not None
    assert sparse is not None
    np.testing.assert_allclose(sparse, dense, rtol=1e-9, atol=1e-12)


def solved(problem: BundleProblem, monkeypatch: pytest.MonkeyPatch, sparse_from: int) -> BundleResult:
    monkeypatch.setattr(reduced_system, "SPARSE_FROM", sparse_from)
    return BundleConfig(iterations_first=8, iterations_second=5).build()(problem, CAMERA)


@pytest.mark.parametrize("seed", range(2))
def test_a_long_bundle_ends_at_the_same_place_sparsely(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    problem = walk(10 * seed)
    dense, sparse = (solved(problem, monkeypatch, limit) for limit in (1000, 1))
    assert dense.n_iterations == sparse.n_iterations
    np.testing.assert_allclose(sparse.T_cam_world, dense.T_cam_world, atol=1e-7)
    np.testing.assert_allclose(sparse.points_world_m, dense.points_world_m, atol=1e-5)
    np.testing.assert_array_equal(sparse.is_inlier, dense.is_inlier)
    assert sparse.final_cost < 0.5 * sparse.initial_cost
    cost = huber_cost(problem, sparse.T_cam_world, sparse.points_world_m)
    assert sparse.final_cost == pytest.approx(cost, rel=1e-9)


def test_the_sparse_solver_is_chosen_for_many_keyframes() -> None:
    order = Order(np.zeros(2, dtype=np.int64), np.zeros(0, dtype=np.int64))
    assert isinstance(reduced_system.reduced_system(20, order), DenseSystem)
    assert isinstance(reduced_system.reduced_system(500, order), SparseSystem)


def test_it_stops_when_told_and_what_it_has_is_sound() -> None:
    problem = walk(3)
    whole = BundleConfig().build()(problem, CAMERA)
    for allowed in (0, 2):
        asked: list[None] = []

        def stop(allowed: int = allowed, asked: list[None] = asked) -> bool:
            asked.append(None)
            return len(asked) > allowed

        result = BundleConfig().build()(problem, CAMERA, stop)
        assert result.n_iterations == allowed < whole.n_iterations
        assert np.isfinite(result.T_cam_world).all()
        assert (result.final_cost < result.initial_cost) == (allowed > 0)
