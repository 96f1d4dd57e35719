"""The trajectory prior against a dense least-squares of the same cost, written from the formulas, by scipy."""

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from stillroom.geometry import se3
from stillroom.geometry.arrays import F64
from stillroom.optimize.trajectory_prior import WINDOW, TrajectoryPriorConfig, lagged, smoothed

CONFIG = TrajectoryPriorConfig(enabled=True)
RATE_HZ = 30.0
NODES, WEIGHTS = np.polynomial.legendre.leggauss(8)


def exponential(twist: F64) -> F64:
    """exp of twists (N, 6): the translation is ∫ exp(s φ) ρ ds, by quadrature."""
    T = np.tile(np.eye(4), (len(twist), 1, 1))
    T[:, :3, :3] = Rotation.from_rotvec(twist[:, 3:]).as_matrix()
    T[:, :3, 3] = np.einsum("nij,nj->ni", mean_rotation(twist[:, 3:]), twist[:, :3])
    return T


def logarithm(T: F64) -> F64:
    phi = Rotation.from_matrix(T[:, :3, :3]).as_rotvec()
    rho = np.linalg.solve(mean_rotation(phi), T[:, :3, 3:])[:, :, 0]
    return np.concatenate((rho, phi), axis=1)


def mean_rotation(phi: F64) -> F64:
    shares = 0.5 * (NODES + 1.0)
    parts = zip(WEIGHTS, shares, strict=True)
    return np.asarray(sum(0.5 * w * Rotation.from_rotvec(s * phi).as_matrix() for w, s in parts))


def hand(times_s: F64) -> F64:
    """A camera that sways and turns, T_world_cam (N, 4, 4)."""
    swings, speeds = np.array([0.2, 0.1, 0.1, 0.2, 0.3, 0.1]), np.array([1.1, 1.7, 0.9, 2.3, 1.9, 3.1])
    return exponential(swings * np.sin(speeds * times_s[:, None] + np.arange(6)))


def noisy(times_s: F64, seed: int = 0) -> F64:
    rng = np.random.default_rng(seed)
    spread = np.repeat((CONFIG.position_m, CONFIG.rotation_rad), 3)
    return hand(times_s) @ exponential(spread * rng.normal(size=(len(times_s), 6)))


def oracle(times_s: F64, T: F64, n_inliers: F64, config: TrajectoryPriorConfig = CONFIG) -> F64:
    """The minimum of the cost of Barfoot's white noise on jerk, dense, with scipy's numerical derivatives."""
    n, steps_s = len(T), np.diff(times_s)
    own = np.repeat((config.position_m, config.rotation_rad), 3) / np.sqrt(n_inliers / config.typical_inliers)[:, None]
    middle_s = times_s[:-1] + 0.5 * steps_s
    jerk = np.repeat((config.jerk_m_s3, config.jerk_rad_s3), 3)

    def residuals(x: F64) -> F64:
        X = T @ exponential(x.reshape(n, 6))
        away = logarithm(np.linalg.inv(T) @ X) / own
        velocity = logarithm(np.linalg.inv(X[:-1]) @ X[1:]) / steps_s[:, None]
        changes = []
        for k in range(n - 3):
            # The second derivative of the parabola through three velocities.
            curved = 2.0 * np.polyfit(middle_s[k : k + 3] - middle_s[k], velocity[k : k + 3], 2)[0]
            changes.append(curved / jerk * np.sqrt(steps_s[k : k + 3].mean() * RATE_HZ))
        return np.concatenate((away.ravel(), np.ravel(changes)))

    found = least_squares(residuals, np.zeros(6 * n), x_scale=np.tile(CONFIG.position_m, 6 * n), xtol=1e-12)
    return np.asarray(T @ exponential(found.x.reshape(n, 6)))


def off(T: F64, other: F64) -> F64:
    return np.asarray(np.linalg.norm(logarithm(np.linalg.inv(T) @ other), axis=1))


@pytest.mark.parametrize("steps", ["equal", "unequal"])
def test_the_estimate_is_the_minimum_of_the_cost(steps: str) -> None:
    rng = np.random.default_rng(1)
    times_s = np.arange(14) / RATE_HZ
    if steps == "unequal":
        times_s = np.cumsum(rng.choice([1, 1, 2, 3], 14)) / RATE_HZ + rng.uniform(-0.004, 0.004, 14)
    T, n_inliers = noisy(times_s), rng.uniform(20, 600, 14)
    found, exact = smoothed(times_s, T, n_inliers, CONFIG), oracle(times_s, T, n_inliers)
    moved = off(T, exact)
    assert moved.max() > 0.002
    assert off(found, exact).max() < 0.01 * moved.max()


def test_noise_goes_and_motion_stays() -> None:
    times_s = np.arange(300) / RATE_HZ
    T, truth = noisy(times_s, 2), hand(times_s)
    found = smoothed(times_s, T, np.full(300, 300.0), CONFIG)
    before, after = (np.sqrt(np.mean(off(truth, poses) ** 2)) for poses in (T, found))
    assert after < 0.6 * before
    shaken = [np.linalg.norm(np.diff(poses[:, :3, 3], n=2, axis=0), axis=1).mean() for poses in (T, found, truth)]
    assert shaken[0] > 5.0 * shaken[2]
    assert shaken[1] < 1.5 * shaken[2]


def test_steady_motion_is_left_as_it_is() -> None:
    twist = np.array([0.3, -0.1, 0.2, 0.4, 0.2, -0.6])
    times_s = np.cumsum(np.random.default_rng(4).uniform(0.02, 0.05, 40))
    T = exponential(times_s[:, None] * twist)
    np.testing.assert_allclose(smoothed(times_s, T, np.full(40, 300.0), CONFIG), T, atol=1e-9)


def test_a_pose_with_few_points_is_trusted_less() -> None:
    times_s = np.arange(40) / RATE_HZ
    T, n_inliers = hand(times_s), np.full(40, 300.0)
    T[20] = T[20] @ exponential(np.array([[0.02, 0.0, 0.0, 0.0, 0.0, 0.0]]))[0]
    few = n_inliers.copy()
    few[20] = 15.0
    left = [off(smoothed(times_s, T, n, CONFIG)[20:21], hand(times_s)[20:21])[0] for n in (n_inliers, few)]
    assert left[1] < 0.6 * left[0]


def test_pieces_between_gaps_are_estimated_each_by_itself() -> None:
    times_s = np.arange(50) / RATE_HZ
    times_s[20:] += 0.4
    times_s[47:] += 0.4
    T, n_inliers = noisy(times_s, 3), np.random.default_rng(3).uniform(50, 500, 50)
    found = smoothed(times_s, T, n_inliers, CONFIG)
    for piece in (slice(0, 20), slice(20, 47)):
        np.testing.assert_array_equal(found[piece], smoothed(times_s[piece], T[piece], n_inliers[piece], CONFIG))
    np.testing.assert_array_equal(found[47:], T[47:])  # three poses have no third difference
    assert (off(found[:47], T[:47]) > 0).all()


def test_a_lagged_pose_knows_nothing_of_what_comes_later() -> None:
    times_s = np.arange(45) / RATE_HZ
    T, n_inliers = noisy(times_s, 5), np.full(45, 300.0)
    found = lagged(times_s, T, n_inliers, CONFIG)
    at = 30
    other = T.copy()
    other[at + CONFIG.lag + 1 :] = np.eye(4)
    np.testing.assert_array_equal(lagged(times_s, other, n_inliers, CONFIG)[at], found[at])
    other = T.copy()
    other[at + CONFIG.lag, :3, 3] += 0.05
    assert np.abs(lagged(times_s, other, n_inliers, CONFIG)[at] - found[at]).max() > 1e-4


def test_a_jump_of_the_map_is_no_motion() -> None:
    """A loop moved the map by half a metre between two frames: the poses on either side know nothing of each other."""
    times_s = np.arange(60) / RATE_HZ
    T, n_inliers = noisy(times_s, 6), np.full(60, 300.0)
    jumped = T.copy()
    jumped[30:, :3, 3] += (0.5, 0.0, 0.0)
    found = smoothed(times_s, jumped, n_inliers, CONFIG)
    np.testing.assert_allclose(found[:30], smoothed(times_s[:30], T[:30], n_inliers[:30], CONFIG), atol=1e-9)
    np.testing.assert_allclose(found[30:], smoothed(times_s[30:], jumped[30:], n_inliers[30:], CONFIG), atol=1e-9)


def test_with_a_long_window_and_lag_a_lagged_pose_is_the_smoothed_one() -> None:
    times_s = np.arange(WINDOW) / RATE_HZ
    T, n_inliers = noisy(times_s, 6), np.full(WINDOW, 300.0)
    patient = TrajectoryPriorConfig(enabled=True, lag=WINDOW)
    found = lagged(times_s, T, n_inliers, patient)
    np.testing.assert_allclose(found, smoothed(times_s, T, n_inliers, patient), atol=1e-12)


def test_a_lag_costs_little_and_none_costs_more() -> None:
    times_s = np.arange(200) / RATE_HZ
    T, truth, n_inliers = noisy(times_s, 7), hand(times_s), np.full(200, 300.0)

    def error(poses: F64) -> float:
        return float(np.sqrt(np.mean(off(truth, poses)[WINDOW:-10] ** 2)))

    by_lag = [error(lagged(times_s, T, n_inliers, TrajectoryPriorConfig(enabled=True, lag=lag))) for lag in (0, 5)]
    final = error(smoothed(times_s, T, n_inliers, CONFIG))
    assert final <= by_lag[1] * 1.02
    assert by_lag[1] < 0.85 * by_lag[0]


@pytest.mark.parametrize("n", [0, 1, 3])
def test_too_few_poses_stay_as_they_are(n: int) -> None:
    times_s = np.arange(n) / RATE_HZ
    T = hand(times_s) if n else np.zeros((0, 4, 4))
    np.testing.assert_array_equal(smoothed(times_s, T, np.full(n, 300.0), CONFIG), T)
    np.testing.assert_array_equal(lagged(times_s, T, np.full(n, 300.0), CONFIG), T)


def test_poses_stay_rigid() -> None:
    times_s = np.arange(100) / RATE_HZ
    found = smoothed(times_s, noisy(times_s, 8), np.full(100, 300.0), CONFIG)
    np.testing.assert_allclose(found @ se3.inverse(found), np.tile(np.eye(4), (100, 1, 1)), atol=1e-12)
