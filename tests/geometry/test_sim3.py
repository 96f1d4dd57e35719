"""Similarities against scipy's matrix functions, GTSAM and finite differences."""

import numpy as np
import pytest
from scipy.linalg import expm

from stillroom.geometry import se3, sim3, twists

NO_GTSAM = "gtsam is not installed; there is no wheel of it for Windows"
ANGLES = [0.0, 1e-9, 1e-4, 0.7, 2.0, 3.1]
SCALES = [0.0, 1e-10, 1e-4, 0.3, 2.5]


def some_tangents(seed: int, n: int, angle_rad: float, sigma: float) -> np.ndarray:
    rng = np.random.default_rng(seed)
    phi = rng.normal(size=(n, 3))
    phi *= angle_rad * rng.uniform(0.3, 1.0, (n, 1)) / np.linalg.norm(phi, axis=1, keepdims=True)
    return np.concatenate((rng.normal(size=(n, 3)), phi, sigma * rng.uniform(-1.0, 1.0, (n, 1))), axis=1)


def hat(xi: np.ndarray) -> np.ndarray:
    matrix = np.zeros((4, 4))
    matrix[:3, :3] = se3.skew(xi[3:6]) + xi[6] * np.eye(3)
    matrix[:3, 3] = xi[:3]
    return matrix


@pytest.mark.parametrize("angle_rad", ANGLES)
@pytest.mark.parametrize("sigma", SCALES)
def test_exponential_and_logarithm_are_those_of_matrices(angle_rad: float, sigma: float) -> None:
    r = some_tangents(1, 20, angle_rad, sigma)
    S = sim3.exp(r)
    np.testing.assert_allclose(S, [expm(hat(one)) for one in r], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(sim3.log(S), r, atol=1e-11)
    np.testing.assert_allclose(sim3.scale(S), np.exp(r[:, 6]), rtol=1e-14)


@pytest.mark.parametrize("angle_rad", ANGLES)
@pytest.mark.parametrize("sigma", SCALES)
def test_exponential_and_logarithm_are_gtsams(angle_rad: float, sigma: float) -> None:
    """GTSAM's similarity is p ↦ s (R p + t), its tangent (rotation, translation, log of scale)."""
    gtsam = pytest.importorskip("gtsam", reason=NO_GTSAM)
    r = some_tangents(2, 10, angle_rad, sigma)
    for xi, S in zip(r, sim3.exp(r), strict=True):
        theirs = gtsam.Similarity3.Expmap(np.concatenate((xi[3:6], xi[:3], xi[6:])))
        point = np.array([0.3, -1.0, 2.0])
        np.testing.assert_allclose(theirs.transformFrom(point), S[:3, :3] @ point + S[:3, 3], rtol=1e-7, atol=1e-7)
        s = float(np.exp(xi[6]))
        ours = gtsam.Similarity3(gtsam.Rot3(S[:3, :3] / s), S[:3, 3] / s, s)
        logged = gtsam.Similarity3.Logmap(ours)
        np.testing.assert_allclose(sim3.log(S[None])[0], [*logged[3:6], *logged[:3], logged[6]], atol=1e-6)


@pytest.mark.parametrize("angle_rad", ANGLES)
@pytest.mark.parametrize("sigma", SCALES)
def test_right_jacobian_is_the_derivative_of_the_logarithm(angle_rad: float, sigma: float) -> None:
    r = some_tangents(3, 10, angle_rad, sigma)
    S = sim3.exp(r)
    J = sim3.inverse_right_jacobian(r)
    for k in range(7):
        step = np.zeros((10, 7))
        step[:, k] = 1e-6
        numeric = (sim3.log(S @ sim3.exp(step)) - sim3.log(S @ sim3.exp(-step))) / 2e-6
        np.testing.assert_allclose(J[:, :, k], numeric, atol=1e-7)


def test_adjoint_carries_a_tangent_across_a_similarity() -> None:
    S, xi = sim3.exp(some_tangents(4, 8, 2.0, 0.8)), some_tangents(5, 8, 0.5, 0.4)
    moved = np.einsum("nij,nj->ni", sim3.adjoint(S), xi)
    np.testing.assert_allclose(sim3.exp(moved) @ S, S @ sim3.exp(xi), atol=1e-12)


def test_inverse_and_parts() -> None:
    S = sim3.exp(some_tangents(6, 8, 3.0, 1.5))
    np.testing.assert_allclose(sim3.inverse(S) @ S, np.broadcast_to(np.eye(4), S.shape), atol=1e-12)
    np.testing.assert_allclose(sim3.inverse(S[0]) @ S[0], np.eye(4), atol=1e-12)
    np.testing.assert_allclose(sim3.of(sim3.rigid(S), sim3.scale(S)), S, rtol=1e-14)
    R = sim3.rigid(S)[:, :3, :3]
    np.testing.assert_allclose(R @ np.swapaxes(R, 1, 2), np.broadcast_to(np.eye(3), R.shape), atol=1e-14)


@pytest.mark.parametrize("angle_rad", ANGLES)
def test_at_scale_one_they_are_the_rigid_motions(angle_rad: float) -> None:
    xi = some_tangents(7, 10, angle_rad, 0.0)
    T = twists.exp(xi[:, :6])
    np.testing.assert_allclose(sim3.exp(xi), T, atol=1e-13)
    np.testing.assert_allclose(sim3.log(T)[:, :6], twists.log(T), atol=1e-12)
    np.testing.assert_allclose(sim3.adjoint(T)[:, :6, :6], twists.adjoint(T), atol=1e-13)
    J = sim3.inverse_right_jacobian(xi)
    np.testing.assert_allclose(J[:, :6, :6], twists.inverse_right_jacobian(xi[:, :6]), atol=1e-11)
