"""Pose graphs whose scale is free, against GTSAM's logarithm and scipy's least squares."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from stillroom.geometry import se3, sim3
from stillroom.geometry.groups import SIMILAR
from stillroom.optimize.pose_graph import PoseGraph, PoseGraphConfig

NO_GTSAM = "gtsam is not installed; there is no wheel of it for Windows"
SIGMAS = np.array([0.02] * 3 + [0.01] * 3 + [0.01])
THOROUGH = PoseGraphConfig(iterations=200, min_relative_decrease=1e-14, huber_chi2=1e12)


def drifting_ring(seed: int, n: int, drift: float, noise: float = 1.0) -> tuple[PoseGraph, np.ndarray]:
    """A walk round a circle whose scale drifts evenly, in the end by e to `drift`; two edges across know it."""
    rng = np.random.default_rng(seed)
    angle = np.linspace(0, 2 * np.pi, n, endpoint=False)
    T_true = np.stack([se3.exp(np.array([0, 0, 0, 0, -a, 0])) for a in angle])
    T_true[:, :3, 3] = np.column_stack((4 * np.cos(angle), 0.2 * np.sin(3 * angle), 4 * np.sin(angle)))
    S_true = sim3.of(T_true, np.exp(-drift * np.arange(n) / (n - 1)))  # lengths of each node, in those of the first
    first = np.concatenate((np.arange(n - 1), np.arange(n - 2), [n - 1, n - 2]))
    second = np.concatenate((np.arange(1, n), np.arange(2, n), [0, 1]))
    across = np.arange(len(first)) >= len(first) - 2
    measured = sim3.inverse(S_true[first]) @ S_true[second]
    # Odometry does not notice that its scale drifts.
    measured[~across] = sim3.rigid(measured[~across])
    measured = measured @ sim3.exp(noise * rng.normal(size=(len(first), 7)) * SIGMAS)
    measured[~across] = sim3.rigid(measured[~across])
    S_start = S_true.copy()
    for k in range(1, n):
        S_start[k] = S_start[k - 1] @ measured[k - 1]
    is_fixed = np.zeros(n, dtype=bool)
    is_fixed[0] = True
    information = np.tile(1.0 / SIGMAS**2, (len(first), 1)) * rng.uniform(0.5, 2.0, (len(first), 1))
    information[across] *= 100.0
    return PoseGraph(S_start, is_fixed, first, second, measured, information, SIMILAR), S_true


def residuals(graph: PoseGraph, S: np.ndarray) -> np.ndarray:
    """Whitened errors (E, 7), from GTSAM's logarithm."""
    gtsam = pytest.importorskip("gtsam", reason=NO_GTSAM)
    errors = []
    for i, j, Z, weight in zip(graph.first, graph.second, graph.T_first_second, graph.information, strict=True):
        X = np.linalg.inv(Z) @ np.linalg.inv(S[i]) @ S[j]
        s = np.cbrt(np.linalg.det(X[:3, :3]))
        r = gtsam.Similarity3.Logmap(gtsam.Similarity3(gtsam.Rot3(X[:3, :3] / s), X[:3, 3] / s, s))
        errors.append(np.array([*r[3:6], *r[:3], r[6]]) * np.sqrt(weight))
    return np.array(errors)


@pytest.mark.parametrize("seed", range(2))
def test_the_minimum_is_scipys(seed: int) -> None:
    """From the same start scipy, with derivatives of its own and GTSAM's logarithm, ends where we do."""
    graph, _ = drifting_ring(seed, 10, 0.3)
    result = THOROUGH.build()(graph)
    np.testing.assert_allclose(result.chi2, (residuals(graph, result.T_world_node) ** 2).sum(axis=1), rtol=1e-5)

    def moved(step: np.ndarray) -> np.ndarray:
        S = np.array(graph.T_world_node)
        S[1:] = S[1:] @ sim3.exp(step.reshape(-1, 7))
        return S

    found = least_squares(lambda step: residuals(graph, moved(step)).ravel(), np.zeros(63), xtol=1e-12, ftol=1e-12)
    assert result.final_cost == pytest.approx(2.0 * found.cost, rel=1e-4)
    np.testing.assert_allclose(result.T_world_node, moved(found.x), atol=1e-3)


def test_a_drift_of_scale_is_spread_over_the_ring() -> None:
    graph, S_true = drifting_ring(0, 60, 0.25, noise=0.0)
    result = PoseGraphConfig().build()(graph)
    off = np.abs(np.log(sim3.scale(result.T_world_node) / sim3.scale(S_true)))
    assert np.abs(np.log(sim3.scale(graph.T_world_node) / sim3.scale(S_true))).max() > 0.24
    assert off.max() < 0.01
    positions_m = result.T_world_node[:, :3, 3]
    start_m = np.linalg.norm(graph.T_world_node[:, :3, 3] - S_true[:, :3, 3], axis=1)
    assert start_m.max() > 0.9
    assert np.linalg.norm(positions_m - S_true[:, :3, 3], axis=1).max() < 0.1
    assert result.n_iterations < 20


def test_the_fixed_node_keeps_its_scale() -> None:
    graph, _ = drifting_ring(1, 12, 0.2)
    result = THOROUGH.build()(graph)
    np.testing.assert_array_equal(result.T_world_node[0], graph.T_world_node[0])
    assert result.final_cost < 0.1 * result.initial_cost
