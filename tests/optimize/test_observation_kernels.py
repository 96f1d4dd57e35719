import numpy as np
import pytest
from optimize_problems import (
    CAMERA,
    INTRINSICS,
    camera_jacobian,
    chi_squares,
    huber_rho,
    point_jacobian,
    pose_problem,
    predict,
)

from stillroom.geometry import se3
from stillroom.optimize import observations


def test_intrinsics_are_in_the_order_that_the_kernels_read() -> None:
    assert observations.intrinsics_of(CAMERA).tolist() == INTRINSICS.tolist()


def test_to_camera_and_residual_follow_the_pinhole_formula() -> None:
    problem = pose_problem(1, n=20)
    for point, observed in zip(problem.points, problem.observed, strict=True):
        x = observations.to_camera(problem.T_guess, *point)
        np.testing.assert_allclose(x, se3.transform(problem.T_guess, point[None])[0], rtol=1e-12)
        expected = predict(problem.T_guess, point[None])[0] - observed
        np.testing.assert_allclose(observations.residual(*x, observed, INTRINSICS, True), expected, atol=1e-9)
        np.testing.assert_allclose(
            observations.residual(*x, observed, INTRINSICS, False), [*expected[:2], 0.0], atol=1e-9
        )


def test_chi_square_matches_numpy_and_is_infinite_where_there_is_nothing_to_see() -> None:
    problem = pose_problem(2, n=50)
    expected = chi_squares(problem.T_guess, problem.points, problem.observed, problem.weights)
    camera_points = se3.transform(problem.T_guess, problem.points)
    got = [
        observations.chi_square(*x, observed, weight, INTRINSICS)
        for x, observed, weight in zip(camera_points, problem.observed, problem.weights, strict=True)
    ]
    np.testing.assert_allclose(got, expected, rtol=1e-9)
    observed, weight = problem.observed[0], np.ones(3)
    assert observations.chi_square(0.1, 0.1, -1.0, observed, weight, INTRINSICS) == np.inf
    assert observations.chi_square(0.1, 0.1, 0.0, observed, weight, INTRINSICS) == np.inf
    assert observations.chi_square(np.nan, 0.1, 1.0, observed, weight, INTRINSICS) == np.inf
    assert observations.chi_square(0.1, 0.1, np.nan, observed, weight, INTRINSICS) == np.inf


def test_a_point_behind_costs_more_than_any_error_within_the_image() -> None:
    weight = np.array([0.3, 0.3, 0.3])
    largest = float(weight @ np.array([640.0, 480.0, 640.0]) ** 2)
    assert observations.behind_chi_square(weight, INTRINSICS) == pytest.approx(0.9 * (2 * CAMERA.fx) ** 2)
    assert observations.behind_chi_square(weight, INTRINSICS) > largest


def test_huber_has_the_right_value_and_its_factor_is_the_derivative() -> None:
    for chi2 in (0.0, 3.0, 5.99, 6.5, 400.0):
        rho, factor = observations.huber(chi2, 5.991)
        assert rho == pytest.approx(float(huber_rho(np.array(chi2), np.array(5.991))))
        slope = (observations.huber(chi2 + 1e-4, 5.991)[0] - observations.huber(max(chi2 - 1e-4, 0), 5.991)[0]) / (
            1e-4 + min(chi2, 1e-4)
        )
        assert factor == pytest.approx(slope, rel=1e-5)
        assert observations.huber(chi2, np.inf) == (chi2, 1.0)


@pytest.mark.parametrize("has_right", [True, False])
def test_information_and_camera_blocks_match_numerical_jacobians(has_right: bool) -> None:
    problem = pose_problem(3, n=12)
    rng = np.random.default_rng(0)
    for point, observed in zip(problem.points, problem.observed, strict=True):
        weight = rng.uniform(0.2, 1.0, 3) * [1.0, 1.0, has_right]
        x = se3.transform(problem.T_guess, point[None])[0]
        error = np.array(observations.residual(*x, observed, INTRINSICS, has_right))
        information = observations.point_information(tuple(x), tuple(error), weight, 0.7, INTRINSICS)
        R = problem.T_guess[:3, :3]
        J_point = point_jacobian(problem.T_guess, point) @ R.T  # by the camera-frame point
        a00, a01, a02, a11, a12, a22 = information[:6]
        A = np.array([[a00, a01, a02], [a01, a11, a12], [a02, a12, a22]])
        expected = 0.7 * J_point.T @ np.diag(weight) @ J_point
        np.testing.assert_allclose(A, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())
        expected_g = 0.7 * J_point.T @ (weight * error)
        np.testing.assert_allclose(information[6:], expected_g, rtol=1e-6, atol=1e-6 * np.abs(expected_g).max())

        H, b = np.zeros((6, 6)), np.zeros(6)
        observations.camera_blocks(*x, information, H, b)
        J = camera_jacobian(problem.T_guess, point)
        expected_H = 0.7 * J.T @ np.diag(weight) @ J
        np.testing.assert_allclose(H, np.tril(expected_H), atol=1e-6 * np.abs(expected_H).max())
        expected_b = 0.7 * J.T @ (weight * error)
        np.testing.assert_allclose(b, expected_b, atol=1e-6 * np.abs(expected_b).max())


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-5, 9.9e-4, 1.01e-3, 0.1, 1.0, 3.0])
def test_retract_is_the_left_exponential(size: float) -> None:
    rng = np.random.default_rng(4)
    T = se3.exp(rng.normal(size=6))
    xi = rng.normal(size=6)
    xi[3:] *= size / np.linalg.norm(xi[3:])
    moved = np.empty((4, 4))
    observations.retract(T, xi, moved)
    np.testing.assert_allclose(moved, se3.exp(xi) @ T, atol=2e-13 if size > 1e-5 else 1e-9)


def test_retract_keeps_a_rotation_a_rotation() -> None:
    rng = np.random.default_rng(5)
    T, moved = se3.exp(rng.normal(size=6)), np.empty((4, 4))
    T[:3, :3] += 1e-6 * rng.normal(size=(3, 3))
    for _ in range(200):
        observations.retract(T, 0.1 * rng.normal(size=6), moved)
        T = moved.copy()
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-14)
