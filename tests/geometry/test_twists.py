"""Logarithm, exponential and derivatives of many motions, against scipy's matrix functions and finite differences."""

import numpy as np
import pytest
from scipy.linalg import expm, logm

from stillroom.geometry import se3, twists


def some_twists(seed: int, n: int, angle_rad: float) -> np.ndarray:
    rng = np.random.default_rng(seed)
    phi = rng.normal(size=(n, 3))
    phi *= angle_rad * rng.uniform(0.3, 1.0, (n, 1)) / np.linalg.norm(phi, axis=1, keepdims=True)
    return np.concatenate((rng.normal(size=(n, 3)), phi), axis=1)


def hat(twist: np.ndarray) -> np.ndarray:
    matrix = np.zeros((4, 4))
    matrix[:3, :3] = se3.skew(twist[3:])
    matrix[:3, 3] = twist[:3]
    return matrix


ANGLES = [0.0, 1e-9, 1e-4, 0.049, 0.051, 0.7, 2.0, 3.1]


@pytest.mark.parametrize("angle_rad", ANGLES)
def test_exponential_and_logarithm_are_those_of_matrices(angle_rad: float) -> None:
    r = some_twists(1, 20, angle_rad)
    T = twists.exp(r)
    np.testing.assert_allclose(T, [expm(hat(one)) for one in r], atol=1e-13)
    np.testing.assert_allclose(twists.log(T), r, atol=1e-12)
    np.testing.assert_allclose([twists.of_motion(one) for one in T], r, atol=1e-12)
    if 1e-4 < angle_rad < 3.0:
        expected = np.real(logm(T[0]))
        np.testing.assert_allclose(hat(twists.log(T)[0]), expected, atol=1e-9)


@pytest.mark.parametrize("angle_rad", ANGLES)
def test_right_jacobian_is_the_derivative_of_the_logarithm(angle_rad: float) -> None:
    r = some_twists(2, 10, angle_rad)
    T = twists.exp(r)
    J = twists.inverse_right_jacobian(r)
    for k in range(6):
        step = np.zeros((10, 6))
        step[:, k] = 1e-6
        numeric = (twists.log(T @ twists.exp(step)) - twists.log(T @ twists.exp(-step))) / 2e-6
        np.testing.assert_allclose(J[:, :, k], numeric, atol=3e-8)


def test_adjoint_carries_a_twist_across_a_motion() -> None:
    T, xi = twists.exp(some_twists(3, 8, 2.0)), some_twists(4, 8, 0.5)
    moved = np.einsum("nij,nj->ni", twists.adjoint(T), xi)
    np.testing.assert_allclose(twists.exp(moved) @ T, T @ twists.exp(xi), atol=1e-12)
