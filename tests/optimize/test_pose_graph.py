"""Pose graphs against GTSAM and scipy."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from stillroom.geometry import se3, twists
from stillroom.optimize.pose_graph import PoseGraph, PoseGraphConfig

NO_GTSAM = "gtsam is not installed; there is no wheel of it for Windows"
SIGMAS = np.repeat((0.02, 0.01), 3)
THOROUGH = PoseGraphConfig(iterations=200, min_relative_decrease=1e-14)


def ring(seed: int, n: int = 40, wrong: int = 0) -> tuple[PoseGraph, np.ndarray]:
    """A walk round a circle that drifts, measured between neighbours and twice across; the truth beside it."""
    rng = np.random.default_rng(seed)
    angle = np.linspace(0, 2 * np.pi, n, endpoint=False)
    T_true = np.stack([se3.exp(np.array([0, 0, 0, 0, -a, 0])) for a in angle])
    T_true[:, :3, 3] = np.column_stack((4 * np.cos(angle), 0.2 * np.sin(3 * angle), 4 * np.sin(angle)))
    first = np.concatenate((np.arange(n - 1), np.arange(n - 2), [n - 1, n - 2]))
    second = np.concatenate((np.arange(1, n), np.arange(2, n), [0, 1]))
    if wrong:
        chosen = rng.integers(0, n, (wrong, 2))
        chosen = chosen[np.abs(chosen[:, 0] - chosen[:, 1]) > 2]
        first, second = np.concatenate((first, chosen[:, 0])), np.concatenate((second, chosen[:, 1]))
    noise = rng.normal(size=(len(first), 6)) * SIGMAS
    measured = se3.inverse(T_true[first]) @ T_true[second] @ twists.exp(noise)
    if wrong:
        measured[-len(chosen) :, :3, 3] += rng.uniform(1, 2, (len(chosen), 3))
    T_start = T_true.copy()
    for k in range(1, n):
        T_start[k] = T_start[k - 1] @ measured[k - 1]
    is_fixed = np.zeros(n, dtype=bool)
    is_fixed[0] = True
    information = np.tile(1.0 / SIGMAS**2, (len(first), 1)) * rng.uniform(0.5, 2.0, (len(first), 1))
    return PoseGraph(T_start, is_fixed, first, second, measured, information), T_true


def residuals(graph: PoseGraph, T: np.ndarray) -> np.ndarray:
    """Whitened errors (E, 6), from GTSAM's logarithm."""
    gtsam = pytest.importorskip("gtsam", reason=NO_GTSAM)
    errors = []
    for i, j, Z, weight in zip(graph.first, graph.second, graph.T_first_second, graph.information, strict=True):
        r = gtsam.Pose3.Logmap(gtsam.Pose3(np.linalg.inv(Z) @ np.linalg.inv(T[i]) @ T[j]))
        errors.append(np.concatenate((r[3:], r[:3])) * np.sqrt(weight))  # GTSAM has the rotation first
    return np.array(errors)


def gtsam_minimum(graph: PoseGraph, huber: float | None) -> np.ndarray:
    gtsam = pytest.importorskip("gtsam", reason=NO_GTSAM)
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, T in enumerate(graph.T_world_node):
        values.insert(k, gtsam.Pose3(T))
        if graph.is_fixed[k]:
            factors.add(gtsam.NonlinearEqualityPose3(k, gtsam.Pose3(T)))
    for i, j, Z, weight in zip(graph.first, graph.second, graph.T_first_second, graph.information, strict=True):
        noise = gtsam.noiseModel.Diagonal.Sigmas(1.0 / np.sqrt(np.concatenate((weight[3:], weight[:3]))))
        if huber is not None:
            noise = gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Huber.Create(huber), noise)
        factors.add(gtsam.BetweenFactorPose3(int(i), int(j), gtsam.Pose3(Z), noise))
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(300)
    parameters.setRelativeErrorTol(1e-14)
    parameters.setAbsoluteErrorTol(1e-12)
    found = gtsam.LevenbergMarquardtOptimizer(factors, values, parameters).optimize()
    return np.stack([found.atPose3(k).matrix() for k in range(len(graph.T_world_node))])


def huber_cost(chi2: np.ndarray, limit: float) -> float:
    return float(np.where(chi2 <= limit, chi2, 2 * np.sqrt(limit * chi2) - limit).sum())


@pytest.mark.parametrize("seed", range(3))
def test_least_squares_minimum_is_gtsams(seed: int) -> None:
    graph, T_true = ring(seed)
    result = PoseGraphConfig(iterations=200, min_relative_decrease=1e-14, huber_chi2=1e12).build()(graph)
    T = gtsam_minimum(graph, None)
    chi2 = (residuals(graph, result.T_world_node) ** 2).sum(axis=1)
    np.testing.assert_allclose(result.chi2, chi2, rtol=1e-6, atol=1e-9)
    assert result.final_cost == pytest.approx(chi2.sum(), rel=1e-9)
    assert result.final_cost <= (residuals(graph, T) ** 2).sum() * (1 + 1e-6)
    assert np.linalg.norm(result.T_world_node[:, :3, 3] - T[:, :3, 3], axis=1).max() < 1e-3
    drift = np.linalg.norm(graph.T_world_node[:, :3, 3] - T_true[:, :3, 3], axis=1).max()
    assert np.linalg.norm(result.T_world_node[:, :3, 3] - T_true[:, :3, 3], axis=1).max() < 0.5 * drift


def test_the_gradient_vanishes_for_scipy_too() -> None:
    """From our minimum scipy, with derivatives of its own, finds nothing better."""
    graph, _ = ring(5, n=12)
    T = PoseGraphConfig(iterations=200, min_relative_decrease=1e-14, huber_chi2=1e12).build()(graph).T_world_node

    def errors(step: np.ndarray) -> np.ndarray:
        moved = T.copy()
        moved[1:] = T[1:] @ twists.exp(step.reshape(-1, 6))
        return residuals(graph, moved).ravel()

    found = least_squares(errors, np.zeros(6 * 11), xtol=1e-15, ftol=1e-15, gtol=1e-12)
    assert found.cost >= 0.5 * (errors(np.zeros(66)) ** 2).sum() * (1 - 1e-9)
    assert np.abs(found.x).max() < 1e-5


@pytest.mark.parametrize("seed", range(3))
def test_hubers_minimum_is_gtsams_and_wrong_edges_lose(seed: int) -> None:
    graph, T_true = ring(seed, wrong=3)
    config = PoseGraphConfig(iterations=500, min_relative_decrease=1e-14)
    result = config.build()(graph)
    T = gtsam_minimum(graph, np.sqrt(config.huber_chi2))
    ours, theirs = ((residuals(graph, poses) ** 2).sum(axis=1) for poses in (result.T_world_node, T))
    assert result.final_cost == pytest.approx(huber_cost(ours, config.huber_chi2), rel=1e-9)
    assert result.final_cost <= huber_cost(theirs, config.huber_chi2) * (1 + 1e-5)
    plain = PoseGraphConfig(iterations=200, huber_chi2=1e12).build()(graph)
    error, plain_error = (
        np.linalg.norm(found.T_world_node[:, :3, 3] - T_true[:, :3, 3], axis=1).mean() for found in (result, plain)
    )
    assert error < 0.5 * plain_error


def test_fixed_nodes_stay_and_unreached_ones_too() -> None:
    graph, _ = ring(1)
    lonely = np.concatenate((graph.T_world_node, se3.exp(np.ones(6))[None]))
    graph = PoseGraph(
        lonely, np.append(graph.is_fixed, False), graph.first, graph.second, graph.T_first_second, graph.information
    )
    result = THOROUGH.build()(graph)
    np.testing.assert_array_equal(result.T_world_node[0], graph.T_world_node[0])
    np.testing.assert_allclose(result.T_world_node[-1], lonely[-1], atol=1e-12)
    assert result.final_cost < result.initial_cost


def test_it_stops_when_told_and_never_ends_above_its_start() -> None:
    graph, _ = ring(2)
    asked = []

    def stop() -> bool:
        asked.append(None)
        return len(asked) > 2

    result = THOROUGH.build()(graph, stop)
    assert result.n_iterations == 2
    assert result.final_cost <= result.initial_cost
    still = THOROUGH.build()(graph, lambda: True)
    np.testing.assert_array_equal(still.T_world_node, graph.T_world_node)


def test_poses_remain_poses_after_half_a_turn_of_error() -> None:
    """A start that is turned round entirely ends at the truth, with rotations that are rotations."""
    graph, T_true = ring(4)
    T_start = T_true @ se3.exp(np.array([0, 0, 0, 0, 2.5, 0]))
    T_start[0] = T_true[0]
    graph = PoseGraph(T_start, graph.is_fixed, graph.first, graph.second, graph.T_first_second, graph.information)
    result = PoseGraphConfig(iterations=200, huber_chi2=1e12).build()(graph)
    R = result.T_world_node[:, :3, :3]
    np.testing.assert_allclose(R @ np.swapaxes(R, 1, 2), np.broadcast_to(np.eye(3), R.shape), atol=1e-9)
    assert np.linalg.norm(result.T_world_node[:, :3, 3] - T_true[:, :3, 3], axis=1).max() < 0.5
