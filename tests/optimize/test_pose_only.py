import numpy as np
import pytest
from optimize_problems import (
    CAMERA,
    INTRINSICS,
    camera_jacobian,
    chi_squares,
    huber_rho,
    limits,
    pose_distance,
    pose_problem,
    predict,
)
from scipy.optimize import least_squares

from stillroom.geometry import se3
from stillroom.optimize.pose import (
    PoseOptimizer,
    PoseOptimizerConfig,
    Seen,
    classify,
    damped_step,
    linearize_pose,
)


def seen_of(p, p_static: np.ndarray | None = None) -> Seen:
    likely = np.ones(len(p.points)) if p_static is None else p_static
    return Seen(p.points, p.observed, p.weights, likely, INTRINSICS)


def test_linearize_matches_numpy_with_numerical_jacobians() -> None:
    p = pose_problem(1, n=40)
    is_active = np.random.default_rng(1).random(40) < 0.8
    p.points[5] = se3.transform(se3.inverse(p.T_guess), np.array([[0.1, 0.2, -2.0]]))[0]
    is_active[5] = True
    p_static = np.random.default_rng(2).random(40)
    H, b = np.full((6, 6), 7.0), np.full(6, 7.0)
    cost = linearize_pose(p.T_guess, seen_of(p, p_static), is_active, (5.991, 7.815), H, b)

    chi2 = chi_squares(p.T_guess, p.points, p.observed, p.weights)
    chi2[5] = (p.weights[5] * (2 * CAMERA.fx) ** 2).sum()
    delta2 = limits(p.weights)
    assert cost == pytest.approx((p_static * huber_rho(chi2, delta2))[is_active].sum(), rel=1e-10)
    expected_H, expected_b = np.zeros((6, 6)), np.zeros(6)
    for i in np.flatnonzero(is_active & (np.arange(40) != 5)):
        factor = p_static[i] * (1.0 if chi2[i] <= delta2[i] else np.sqrt(delta2[i] / chi2[i]))
        J = camera_jacobian(p.T_guess, p.points[i])
        error = predict(p.T_guess, p.points[i][None])[0] - p.observed[i]
        expected_H += factor * J.T @ np.diag(p.weights[i]) @ J
        expected_b += factor * J.T @ (p.weights[i] * error)
    np.testing.assert_allclose(H, np.tril(expected_H), atol=1e-6 * np.abs(expected_H).max())
    np.testing.assert_allclose(b, expected_b, atol=1e-6 * np.abs(expected_b).max())


def test_the_gradient_is_that_of_the_cost() -> None:
    p = pose_problem(2, n=60)
    active = np.ones(60, dtype=bool)
    H, b = np.empty((6, 6)), np.empty(6)

    def cost(xi: np.ndarray) -> float:
        T = se3.exp(xi) @ p.T_guess
        return linearize_pose(T, seen_of(p), active, (5.991, 7.815), H, b)

    slopes = [(cost(1e-6 * e) - cost(-1e-6 * e)) / 2e-6 for e in np.eye(6)]
    cost(np.zeros(6))
    np.testing.assert_allclose(2.0 * b, slopes, rtol=1e-5)


def test_damped_step_solves_the_damped_normal_equations() -> None:
    rng = np.random.default_rng(3)
    J = rng.normal(size=(20, 6))
    H, b, T = J.T @ J, 0.1 * rng.normal(size=6), se3.exp(rng.normal(size=6))
    moved = np.empty((4, 4))
    norm = damped_step(np.tril(H), b, 0.3, T, moved)
    xi = -np.linalg.solve(H + 0.3 * np.diag(np.diag(H)), b)
    assert norm == pytest.approx(np.linalg.norm(xi), rel=1e-8)
    np.testing.assert_allclose(moved, se3.exp(xi) @ T, atol=1e-9)
    assert damped_step(np.zeros((6, 6)), np.zeros(6), 0.3, T, moved) == 0.0
    assert damped_step(-H, b, 0.3, T, moved) == -1.0
    assert damped_step(np.full((6, 6), np.nan), b, 0.3, T, moved) == -1.0
    assert damped_step(np.tril(H), np.full(6, np.nan), 0.3, T, moved) == -1.0


def test_classify_matches_numpy_and_counts_changes() -> None:
    p = pose_problem(4)
    chi2, is_inlier = np.empty(300), np.zeros(300, dtype=bool)
    is_inlier[::3] = True
    before = is_inlier.copy()
    changed = classify(p.T_true, seen_of(p), (5.991, 7.815), chi2, is_inlier)
    np.testing.assert_allclose(chi2, chi_squares(p.T_true, p.points, p.observed, p.weights), rtol=1e-8)
    np.testing.assert_array_equal(is_inlier, chi2 <= limits(p.weights))
    assert changed == np.count_nonzero(before != is_inlier)


def oracle_pose(
    p, T_start: np.ndarray, use: np.ndarray, robust: bool, p_static: float | np.ndarray = 1.0
) -> tuple[np.ndarray, float]:
    """scipy's trust-region minimum of Σpρ; a whole observation is one Huber term, hence √ρ as the residual's length."""

    def residuals(xi: np.ndarray) -> np.ndarray:
        T = se3.exp(xi) @ T_start
        error = np.sqrt(p.weights) * np.where(p.weights > 0, predict(T, p.points) - p.observed, 0.0)
        chi2 = (error**2).sum(axis=1)
        rho = p_static * (huber_rho(chi2, limits(p.weights)) if robust else chi2)
        return (error * np.sqrt(rho / np.maximum(chi2, 1e-300))[:, None])[use].ravel()

    found = least_squares(residuals, np.zeros(6), jac="3-point", xtol=1e-13, ftol=1e-14, gtol=1e-12)
    return se3.exp(found.x) @ T_start, 2.0 * found.cost


@pytest.mark.parametrize("seed", range(6))
def test_one_round_finds_the_minimum_of_the_huber_cost(seed: int) -> None:
    p = pose_problem(seed)
    estimate = PoseOptimizerConfig(rounds=1, iterations=50).build()(p.T_guess, p.points, p.observed, p.weights, CAMERA)
    everything = np.ones(len(p.points), dtype=bool)
    T_oracle, cost = oracle_pose(p, p.T_guess, everything, robust=True)
    # The optimiser stops at a relative decrease of 1e-7; the poses' uncertainty is about 1e-3 m, so 1e-5 is 1 % of it.
    assert huber_rho(estimate.chi2, limits(p.weights)).sum() == pytest.approx(cost, rel=1e-6)
    metres, radians = pose_distance(estimate.T_cam_world, T_oracle)
    assert metres < 1e-5
    assert radians < 1e-5


@pytest.mark.parametrize("seed", range(6))
def test_matches_weigh_as_much_as_their_points_are_likely_to_be_static(seed: int) -> None:
    p = pose_problem(seed)
    p_static = np.random.default_rng(seed).random(len(p.points))
    optimize = PoseOptimizerConfig(rounds=1, iterations=50).build()
    estimate = optimize(p.T_guess, p.points, p.observed, p.weights, CAMERA, p_static)
    T_oracle, cost = oracle_pose(p, p.T_guess, np.ones(len(p.points), dtype=bool), True, p_static)
    assert (p_static * huber_rho(estimate.chi2, limits(p.weights))).sum() == pytest.approx(cost, rel=1e-6)
    assert max(pose_distance(estimate.T_cam_world, T_oracle)) < 1e-5
    plain, ones = (
        optimize(p.T_guess, p.points, p.observed, p.weights, CAMERA, w) for w in (None, np.ones(len(p_static)))
    )
    np.testing.assert_array_equal(plain.T_cam_world, ones.T_cam_world)
    assert max(pose_distance(plain.T_cam_world, estimate.T_cam_world)) > 1e-5, "it makes a difference"


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("wrong", [0.05, 0.4])
def test_the_result_is_the_least_squares_pose_of_its_own_inliers(seed: int, wrong: float) -> None:
    p = pose_problem(100 + seed, wrong=wrong)
    estimate = PoseOptimizer()(p.T_guess, p.points, p.observed, p.weights, CAMERA)
    T_oracle, cost = oracle_pose(p, p.T_true, estimate.is_inlier, robust=False)
    metres, radians = pose_distance(estimate.T_cam_world, T_oracle)
    # Verdicts at the limit may still flip in the last round, a shift of a small part of the pose's 1e-3 m uncertainty.
    assert estimate.chi2[estimate.is_inlier].sum() == pytest.approx(cost, rel=1e-4)
    assert metres < 1e-4
    assert radians < 1e-4
    metres, radians = pose_distance(estimate.T_cam_world, p.T_true)
    assert metres < 5e-3
    assert radians < 2e-3


@pytest.mark.parametrize("seed", range(5))
def test_wrong_matches_are_told_apart(seed: int) -> None:
    p = pose_problem(200 + seed, wrong=0.3)
    estimate = PoseOptimizer()(p.T_guess, p.points, p.observed, p.weights, CAMERA)
    assert not np.any(estimate.is_inlier & p.is_wrong)
    assert np.mean(estimate.is_inlier[~p.is_wrong]) > 0.9  # 95 % expected of chi-square
    assert estimate.n_inliers == np.count_nonzero(estimate.is_inlier)
    np.testing.assert_array_equal(estimate.is_inlier, estimate.chi2 <= limits(p.weights))


def test_a_match_that_looks_wrong_at_the_guess_comes_back() -> None:
    p = pose_problem(7, wrong=0.0, noise=0.1, angle=0.05)
    at_guess = chi_squares(p.T_guess, p.points, p.observed, p.weights) <= limits(p.weights)
    assert np.mean(at_guess) < 0.1
    estimate = PoseOptimizer()(p.T_guess, p.points, p.observed, p.weights, CAMERA)
    assert estimate.is_inlier.all()


def test_exact_observations_give_the_exact_pose() -> None:
    p = pose_problem(8, wrong=0.0, noise=0.0)
    estimate = PoseOptimizer()(p.T_guess, p.points, p.observed, p.weights, CAMERA)
    assert max(pose_distance(estimate.T_cam_world, p.T_true)) < 1e-8


@pytest.mark.parametrize("count", [0, 1, 2])
def test_too_few_observations_return_the_guess_and_no_inlier(count: int) -> None:
    p = pose_problem(9, n=count)
    estimate = PoseOptimizer()(p.T_guess, p.points, p.observed, p.weights, CAMERA)
    np.testing.assert_array_equal(estimate.T_cam_world, p.T_guess)
    assert estimate.n_inliers == 0
    assert estimate.is_inlier.shape == estimate.chi2.shape == (count,)


def test_points_behind_the_camera_are_outliers_and_do_no_harm() -> None:
    p = pose_problem(10, wrong=0.0)
    behind = se3.transform(p.T_true, p.points)
    behind[:60, 2] *= -1.0
    p.points[:] = se3.transform(se3.inverse(p.T_true), behind)
    estimate = PoseOptimizer()(p.T_guess, p.points, p.observed, p.weights, CAMERA)
    assert not estimate.is_inlier[:60].any()
    assert np.mean(estimate.is_inlier[60:]) > 0.9
    assert max(pose_distance(estimate.T_cam_world, p.T_true)) < 5e-3


def test_nothing_but_points_behind_returns_the_guess() -> None:
    p = pose_problem(11)
    turned = np.diag([-1.0, 1.0, -1.0, 1.0]) @ p.T_true
    estimate = PoseOptimizer()(turned, p.points, p.observed, p.weights, CAMERA)
    np.testing.assert_array_equal(estimate.T_cam_world, turned)
    assert estimate.n_inliers == 0


def test_numbers_that_are_not_finite_stay_outside() -> None:
    p = pose_problem(12, wrong=0.0)
    p.points[0] = np.nan
    p.points[1] = np.inf
    p.observed[2, 0] = np.nan
    p.observed[p.weights[:, 2] == 0, 2] = np.nan  # there is no right coordinate: must not be read
    p.weights[3] = np.nan
    estimate = PoseOptimizer()(p.T_guess, p.points, p.observed, p.weights, CAMERA)
    assert np.isfinite(estimate.T_cam_world).all()
    assert not np.isnan(estimate.chi2).any()
    assert not estimate.is_inlier[:4].any()
    assert np.mean(estimate.is_inlier[4:]) > 0.9


@pytest.mark.parametrize("seed", range(20))
def test_pure_nonsense_gives_finite_numbers(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(3, 12))
    T = se3.exp(rng.normal(size=6))
    points = rng.normal(size=(n, 3)) * 10.0 ** rng.uniform(-3, 3)
    estimate = PoseOptimizer()(T, points, 1e3 * rng.normal(size=(n, 3)), rng.random((n, 3)), CAMERA)
    assert np.isfinite(estimate.T_cam_world).all()
    np.testing.assert_allclose(estimate.T_cam_world[:3, :3] @ estimate.T_cam_world[:3, :3].T, np.eye(3), atol=1e-9)


def test_the_same_point_many_times_is_no_trouble() -> None:
    p = pose_problem(13, n=1, wrong=0.0)
    many = [np.repeat(array, 50, axis=0) for array in (p.points, p.observed, p.weights)]
    estimate = PoseOptimizer()(p.T_guess, *many, CAMERA)
    assert np.isfinite(estimate.T_cam_world).all()
    assert estimate.is_inlier.all()  # one pixel can always be met
