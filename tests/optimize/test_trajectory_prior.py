"""The trajectory prior against a dense least-squares of the same cost, written from the formulas, by scipy.

The kernels are compared with plain numpy beside that, and the filter with an estimate of its window as a whole.
"""

import numpy as np
import pytest
from plain_trajectory_prior import smoothed_piece
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from stillroom.geometry import se3
from stillroom.geometry.arrays import F64
from stillroom.geometry.twist_kernels import log_between
from stillroom.optimize.trajectory_kernels import move_chain
from stillroom.optimize.trajectory_prior import WINDOW, TrajectoryFilter, TrajectoryPriorConfig, prior_of, smoothed

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


def filtered(times_s: F64, T: F64, n_inliers: F64, config: TrajectoryPriorConfig = CONFIG) -> tuple[F64, F64]:
    """What the filter says of each pose at once, and `lag` frames later."""
    newest, at_once, later = TrajectoryFilter(config), T.copy(), T.copy()
    for i in range(len(T)):
        window = slice(max(0, i + 1 - newest.reach), i + 1)
        found = newest.add(times_s[window], T[window], n_inliers[window])
        at_once[i] = found[-1]
        settled = slice(max(window.start, i - config.lag), i + 1)
        later[settled] = found[settled.start - window.start :]
    return at_once, later


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


@pytest.mark.parametrize("iterations", [1, 3])
def test_the_kernels_come_to_what_plain_numpy_does(iterations: int) -> None:
    rng = np.random.default_rng(2)
    times_s = np.cumsum(rng.choice([1, 1, 2, 3], 90)) / RATE_HZ + rng.uniform(-0.004, 0.004, 90)
    T, n_inliers = noisy(times_s, 9), rng.uniform(0, 600, 90)
    prior, found = prior_of(n_inliers, CONFIG), T.copy()
    move_chain(times_s, T, prior, iterations, found)
    plain = smoothed_piece(times_s, T, n_inliers, CONFIG, iterations)
    np.testing.assert_allclose(found, plain, atol=1e-12)
    assert off(found, T).max() > 0.005


@pytest.mark.parametrize("turn_rad", [0.0, 1e-9, 1e-4, 0.049, 0.051, 1.0, 3.0, np.pi])
def test_the_motion_between_two_poses(turn_rad: float) -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        axis = rng.normal(size=3)
        twist = np.concatenate((rng.normal(size=3), turn_rad * axis / np.linalg.norm(axis)))
        first, between, found = hand(np.array([0.7]))[0], np.zeros((3, 4)), np.zeros(6)
        log_between(first, first @ exponential(twist[None])[0], between, found)
        np.testing.assert_allclose(between, exponential(twist[None])[0][:3], atol=1e-12)
        # Half a turn has two vectors: the motion is the same.
        np.testing.assert_allclose(exponential(found[None])[0], exponential(twist[None])[0], atol=1e-8)
        assert np.linalg.norm(found[3:]) <= np.pi + 1e-12
        if turn_rad < np.pi:
            np.testing.assert_allclose(found, twist, atol=1e-8)


def test_the_filter_says_what_its_window_does_as_a_whole() -> None:
    """One round a frame, from where the frame before left off, comes to the end of many rounds from the start."""
    times_s = np.arange(80) / RATE_HZ
    rng = np.random.default_rng(4)
    T, n_inliers = noisy(times_s, 5), rng.uniform(50, 500, 80)
    at_once, later = filtered(times_s, T, n_inliers)
    newest, reach, moved = [], TrajectoryFilter(CONFIG).reach, []
    for i in range(30, 80):
        window = slice(i + 1 - reach, i + 1)
        whole = smoothed_piece(times_s[window], T[window], n_inliers[window], CONFIG, 10)
        newest.append((off(at_once[i : i + 1], whole[-1:])[0], off(later[i - 5 : i - 4], whole[-6:-5])[0]))
        moved.append(off(T[i : i + 1], whole[-1:])[0])
    assert np.sqrt(np.mean(np.square(moved))) > 0.001
    assert np.max(newest, axis=0)[0] < 1e-4
    assert np.max(newest, axis=0)[1] < 1e-5


def test_a_pose_told_at_once_or_later_knows_nothing_of_what_comes_after() -> None:
    times_s = np.arange(45) / RATE_HZ
    T, n_inliers = noisy(times_s, 5), np.full(45, 300.0)
    found, at = filtered(times_s, T, n_inliers), 30
    for which, lag in enumerate((0, CONFIG.lag)):
        other = T.copy()
        other[at + lag + 1 :] = np.eye(4)
        np.testing.assert_array_equal(filtered(times_s, other, n_inliers)[which][at], found[which][at])
        other = T.copy()
        other[at + lag, :3, 3] += 0.05
        assert np.abs(filtered(times_s, other, n_inliers)[which][at] - found[which][at]).max() > 1e-4


def test_told_at_once_a_trajectory_shakes_less_and_is_no_worse() -> None:
    times_s = np.arange(400) / RATE_HZ
    T, truth, n_inliers = noisy(times_s, 10), hand(times_s), np.full(400, 300.0)
    at_once = filtered(times_s, T, n_inliers)[0]
    shaken = [np.sqrt(np.mean(np.diff((poses - truth)[WINDOW:, :3, 3], n=2, axis=0) ** 2)) for poses in (T, at_once)]
    assert shaken[1] < 0.6 * shaken[0]
    errors = [np.sqrt(np.mean(off(truth, poses)[WINDOW:] ** 2)) for poses in (T, at_once)]
    assert errors[1] < errors[0]


def test_the_filter_follows_a_map_that_moves_all_at_once() -> None:
    times_s = np.arange(60) / RATE_HZ
    T, n_inliers, jump = noisy(times_s, 6), np.full(60, 300.0), exponential(np.array([[0.5, 0.1, 0, 0.2, 0.3, 0.1]]))[0]
    one, other = TrajectoryFilter(CONFIG), TrajectoryFilter(CONFIG)
    for i in range(60):
        window = slice(max(0, i + 1 - one.reach), i + 1)
        moved = jump @ T[window] if i >= 40 else T[window]
        still = one.add(times_s[window], T[window], n_inliers[window])
        found = other.add(times_s[window], moved, n_inliers[window])
        np.testing.assert_allclose(found, jump @ still if i >= 40 else still, atol=1e-9)


def test_the_filter_can_begin_again_at_any_frame() -> None:
    """After a relocalization it is given fewer frames than before."""
    times_s = np.arange(40) / RATE_HZ
    T, n_inliers = noisy(times_s, 7), np.full(40, 300.0)
    began, again = TrajectoryFilter(CONFIG), TrajectoryFilter(CONFIG)
    began.add(times_s[:26], T[:26], n_inliers[:26])
    for i in range(30, 40):
        np.testing.assert_allclose(
            began.add(times_s[30 : i + 1], T[30 : i + 1], n_inliers[30 : i + 1]),
            again.add(times_s[30 : i + 1], T[30 : i + 1], n_inliers[30 : i + 1]),
            atol=1e-5,
        )


def test_a_jump_of_the_map_is_no_motion() -> None:
    """A loop moved the map by half a metre between two frames: the poses on either side know nothing of each other."""
    times_s = np.arange(60) / RATE_HZ
    T, n_inliers = noisy(times_s, 6), np.full(60, 300.0)
    jumped = T.copy()
    jumped[30:, :3, 3] += (0.5, 0.0, 0.0)
    found = smoothed(times_s, jumped, n_inliers, CONFIG)
    np.testing.assert_allclose(found[:30], smoothed(times_s[:30], T[:30], n_inliers[:30], CONFIG), atol=1e-9)
    np.testing.assert_allclose(found[30:], smoothed(times_s[30:], jumped[30:], n_inliers[30:], CONFIG), atol=1e-9)


def test_a_lag_costs_little_and_none_costs_more() -> None:
    times_s = np.arange(200) / RATE_HZ
    T, truth, n_inliers = noisy(times_s, 7), hand(times_s), np.full(200, 300.0)

    def error(poses: F64) -> float:
        return float(np.sqrt(np.mean(off(truth, poses)[WINDOW:-10] ** 2)))

    by_lag = [error(filtered(times_s, T, n_inliers)[which]) for which in (0, 1)]
    final = error(smoothed(times_s, T, n_inliers, CONFIG))
    assert final <= by_lag[1] * 1.02
    assert by_lag[1] < 0.85 * by_lag[0]


@pytest.mark.parametrize("n", [0, 1, 3])
def test_too_few_poses_stay_as_they_are(n: int) -> None:
    times_s = np.arange(n) / RATE_HZ
    T = hand(times_s) if n else np.zeros((0, 4, 4))
    np.testing.assert_array_equal(smoothed(times_s, T, np.full(n, 300.0), CONFIG), T)
    for found in filtered(times_s, T, np.full(n, 300.0)):
        np.testing.assert_array_equal(found, T)


def test_poses_stay_rigid() -> None:
    times_s = np.arange(100) / RATE_HZ
    found = smoothed(times_s, noisy(times_s, 8), np.full(100, 300.0), CONFIG)
    np.testing.assert_allclose(found @ se3.inverse(found), np.tile(np.eye(4), (100, 1, 1)), atol=1e-12)
