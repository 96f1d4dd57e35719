"""Pose and velocity under a rolling shutter: kernels against plain numpy, scipy's matrix exponential and optimiser."""

from dataclasses import dataclass

import numpy as np
import pytest
from optimize_problems import CAMERA, INTRINSICS, huber_rho, limits, pose_distance, pose_problem
from scipy.linalg import expm
from scipy.optimize import least_squares

from stillroom.geometry import se3
from stillroom.optimize.pose import PoseOptimizerConfig
from stillroom.optimize.rolling_pose import (
    RollingPoseOptimizer,
    SeenInRows,
    at_mid_frame,
    classify_rows,
    damped_step_rows,
    keypoints_at_mid_frame,
    linearize_rows,
    seen_from,
)

READOUT_S = 0.03
SPREAD = np.repeat((0.05, 0.5), 3)
"""Standard deviations of a velocity about the expected one."""
INFORMATION = SPREAD**-2.0
LIMITS = 5.991, 7.815


@dataclass
class RowsProblem:
    T_true: np.ndarray
    T_guess: np.ndarray
    velocity: np.ndarray
    points: np.ndarray
    observed: np.ndarray
    weights: np.ndarray
    after_s: np.ndarray
    is_wrong: np.ndarray

    def seen(self, expected: np.ndarray | None = None, p_static: np.ndarray | None = None) -> SeenInRows:
        likely = np.ones(len(self.points)) if p_static is None else p_static
        expected = np.zeros(6) if expected is None else expected
        return SeenInRows(
            self.points, self.observed, self.weights, likely, self.after_s, INTRINSICS, expected, INFORMATION
        )


def moved(twist: np.ndarray) -> np.ndarray:
    """exp of twists (…, 6), ρ and φ, as matrices (…, 4, 4), by scipy."""
    generator = np.zeros((*twist.shape[:-1], 4, 4))
    a, b, c = np.moveaxis(twist[..., 3:], -1, 0)
    generator[..., 0, 1], generator[..., 0, 2], generator[..., 1, 2] = -c, b, -a
    generator[..., 1, 0], generator[..., 2, 0], generator[..., 2, 1] = c, -b, a
    generator[..., :3, 3] = twist[..., :3]
    return expm(generator)


def points_seen(T: np.ndarray, velocity: np.ndarray, points: np.ndarray, after_s: np.ndarray) -> np.ndarray:
    """The points (N, 3) in the camera's frame, each at its time, by scipy's exponential."""
    T_at = moved(after_s[:, None] * velocity) @ T
    return np.einsum("nij,nj->ni", T_at[:, :3, :3], points) + T_at[:, :3, 3]


def predicted(T: np.ndarray, velocity: np.ndarray, points: np.ndarray, after_s: np.ndarray) -> np.ndarray:
    x, y, z = points_seen(T, velocity, points, after_s).T
    u = CAMERA.fx * x / z + CAMERA.cx
    return np.stack((u, CAMERA.fy * y / z + CAMERA.cy, u - CAMERA.bf / z), axis=1)


def rows_problem(seed: int, n: int = 300, wrong: float = 0.2, noise: float = 1.0, speed: float = 1.0) -> RowsProblem:
    """A camera that moves while it reads: `pose_problem`, with what it sees moved by the rows' times."""
    p = pose_problem(seed, n, wrong, noise)
    rng = np.random.default_rng([seed, 5])
    velocity = speed * np.concatenate((rng.uniform(-0.3, 0.3, 3), rng.uniform(-0.8, 0.8, 3)))
    # Where a point is seen decides its time, which decides where it is seen: the row at mid-frame is near enough.
    middle = predicted(p.T_true, np.zeros(6), p.points, np.zeros(n))
    after_s = (middle[:, 1] / CAMERA.height - 0.5) * READOUT_S
    observed = p.observed + predicted(p.T_true, velocity, p.points, after_s) - middle
    observed[p.weights[:, 2] == 0.0, 2] = -1.0
    return RowsProblem(p.T_true, p.T_guess, velocity, p.points, observed, p.weights, after_s, p.is_wrong)


def chi_squares(p: RowsProblem, T: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    error = np.where(p.weights > 0, predicted(T, velocity, p.points, p.after_s) - p.observed, 0.0)
    in_front = points_seen(T, velocity, p.points, p.after_s)[:, 2] > 1e-3
    return np.where(in_front, (p.weights * error**2).sum(axis=1), np.inf)


@pytest.mark.parametrize("seed", range(3))
def test_a_point_is_seen_where_the_exponential_takes_it(seed: int) -> None:
    p = rows_problem(seed)
    found = np.array([seen_from(p.T_true, p.velocity, x, t) for x, t in zip(p.points, p.after_s, strict=True)])
    exact = points_seen(p.T_true, p.velocity, p.points, p.after_s)
    turn = np.abs(p.after_s) * np.linalg.norm(p.velocity[3:])
    # What is left out: the turn's third order, and half of turn times way.
    way_m = np.abs(p.after_s) * np.linalg.norm(p.velocity[:3])
    allowed = turn**3 / 5.0 * np.linalg.norm(exact, axis=1) + 0.6 * turn * way_m
    assert (np.linalg.norm(found - exact, axis=1) <= allowed + 1e-12).all()
    assert np.linalg.norm(exact - se3.transform(p.T_true, p.points), axis=1).max() > 0.02


def test_classification_matches_numpy_and_counts_changes() -> None:
    p = rows_problem(4)
    p.points[7] = se3.transform(se3.inverse(p.T_true), np.array([[0.1, 0.2, -2.0]]))[0]
    chi2, is_inlier = np.empty(300), np.zeros(300, dtype=bool)
    is_inlier[::3] = True
    before = is_inlier.copy()
    changed = classify_rows(p.T_true, p.velocity, p.seen(), LIMITS, chi2, is_inlier)
    expected = chi_squares(p, p.T_true, p.velocity)
    assert np.isinf(chi2[7])
    assert not is_inlier[7]
    near = expected < 1e4
    np.testing.assert_allclose(chi2[near], expected[near], rtol=0.01, atol=0.05)
    clear = np.abs(expected - limits(p.weights)) > 0.1
    np.testing.assert_array_equal(is_inlier[clear], (expected <= limits(p.weights))[clear])
    assert changed == np.count_nonzero(before != is_inlier)


@pytest.mark.parametrize(("speed", "within"), [(0.0, 1e-6), (1.0, 0.03)])
def test_normal_equations_match_numerical_jacobians_of_the_exact_model(speed: float, within: float) -> None:
    """Exact where the camera is at rest; else the turn within half a readout, a hundredth, is left out of them."""
    p = rows_problem(1, n=40, speed=speed)
    is_active = np.random.default_rng(1).random(40) < 0.8
    p_static = np.random.default_rng(2).random(40)
    expected = np.array([0.1, -0.05, 0.02, 0.3, -0.2, 0.1])
    H, b = np.full((12, 12), 7.0), np.full(12, 7.0)
    cost = linearize_rows(p.T_guess, p.velocity, p.seen(expected, p_static), is_active, LIMITS, H, b)

    chi2 = chi_squares(p, p.T_guess, p.velocity)
    away = p.velocity - expected
    rho = (p_static * huber_rho(chi2, limits(p.weights)))[is_active].sum() + (INFORMATION * away**2).sum()
    assert cost == pytest.approx(rho, rel=1e-9 if speed == 0.0 else 1e-3)
    H_numeric, b_numeric = np.zeros((12, 12)), np.zeros(12)
    for i in np.flatnonzero(is_active):
        factor = p_static[i] * min(1.0, np.sqrt(limits(p.weights)[i] / chi2[i]))
        J = jacobian_at(p, i)
        error = predicted(p.T_guess, p.velocity, p.points[i][None], p.after_s[i : i + 1])[0] - p.observed[i]
        H_numeric += factor * J.T @ np.diag(p.weights[i]) @ J
        b_numeric += factor * J.T @ (p.weights[i] * error)
    H_numeric[6:, 6:] += np.diag(INFORMATION)
    b_numeric[6:] += INFORMATION * away
    scale = np.sqrt(np.diag(H_numeric))
    np.testing.assert_allclose(H / np.outer(scale, scale), np.tril(H_numeric) / np.outer(scale, scale), atol=within)
    np.testing.assert_allclose(b / scale, b_numeric / scale, atol=within * np.abs(b_numeric / scale).max())


def jacobian_at(p: RowsProblem, i: int) -> np.ndarray:
    """Derivative (3, 12) of one prediction by a left twist of the pose, and by the velocity."""
    columns = []
    for k in range(12):
        step = np.zeros(12)
        step[k] = 1e-6 if k < 6 else 1e-5
        ends = [
            predicted(moved(s * step[:6]) @ p.T_guess, p.velocity + s * step[6:], p.points[i][None], p.after_s[[i]])[0]
            for s in (1.0, -1.0)
        ]
        columns.append((ends[0] - ends[1]) / (2.0 * step[k]))
    return np.stack(columns, axis=1)


def test_damped_step_solves_the_damped_normal_equations() -> None:
    rng = np.random.default_rng(3)
    J = rng.normal(size=(40, 12))
    H, b, T, velocity = J.T @ J, 0.1 * rng.normal(size=12), se3.exp(rng.normal(size=6)), rng.normal(size=6)
    T_moved, velocity_moved = np.empty((4, 4)), np.empty(6)
    norm = damped_step_rows(np.tril(H), b, 0.3, T, velocity, T_moved, velocity_moved)
    step = -np.linalg.solve(H + 0.3 * np.diag(np.diag(H)), b)
    assert norm == pytest.approx(np.linalg.norm(step[:6]), rel=1e-7)
    np.testing.assert_allclose(T_moved, moved(step[:6]) @ T, atol=1e-8)
    np.testing.assert_allclose(velocity_moved, velocity + step[6:], atol=1e-8)
    assert damped_step_rows(-H, b, 0.3, T, velocity, T_moved, velocity_moved) == -1.0
    assert damped_step_rows(np.full((12, 12), np.nan), b, 0.3, T, velocity, T_moved, velocity_moved) == -1.0


def optimizer(**config: int) -> RollingPoseOptimizer:
    return RollingPoseOptimizer(PoseOptimizerConfig(**config), INFORMATION)


@pytest.mark.parametrize("seed", range(4))
def test_pose_and_velocity_are_those_of_scipys_minimum(seed: int) -> None:
    p = rows_problem(seed, n=150)
    expected = 0.5 * p.velocity
    found = optimizer(rounds=1, iterations=50)(p.T_guess, expected, p.points, p.observed, p.weights, p.after_s, CAMERA)

    def residuals(x: np.ndarray) -> np.ndarray:
        T, velocity = moved(x[:6]) @ p.T_guess, expected + x[6:]
        error = np.sqrt(p.weights) * (predicted(T, velocity, p.points, p.after_s) - p.observed)
        chi2 = (error**2).sum(axis=1)
        rho = huber_rho(chi2, limits(p.weights))
        robust = error * np.sqrt(rho / np.maximum(chi2, 1e-300))[:, None]
        return np.concatenate((robust.ravel(), x[6:] / SPREAD))

    oracle = least_squares(residuals, np.zeros(12), x_scale=np.r_[np.full(6, 0.01), SPREAD], xtol=1e-12, ftol=1e-12)
    H = oracle.jac.T @ oracle.jac
    sigma = np.sqrt(np.diag(np.linalg.inv(H)))
    metres, radians = pose_distance(found.T_cam_world, moved(oracle.x[:6]) @ p.T_guess)
    # The kernel's second-order model and step: a tenth of what the estimate is uncertain by.
    assert metres < 0.1 * np.linalg.norm(sigma[:3])
    assert radians < 0.1 * np.linalg.norm(sigma[3:6])
    assert (np.abs(found.velocity - expected - oracle.x[6:]) < 0.1 * sigma[6:]).all()


def test_pose_and_velocity_are_found_among_wrong_matches() -> None:
    off_m, off_rad_s, still_m = [], [], []
    for seed in range(12):
        p = rows_problem(seed, wrong=0.3)
        asked = (p.points, p.observed, p.weights)
        expected = p.velocity + 0.5 * SPREAD * np.random.default_rng(seed).normal(size=6)
        found = optimizer()(p.T_guess, expected, *asked, p.after_s, CAMERA)
        off_m.append(pose_distance(found.T_cam_world, p.T_true)[0])
        off_rad_s.append(np.linalg.norm(found.velocity[3:] - p.velocity[3:]))
        still = PoseOptimizerConfig().build()(p.T_guess, *asked, CAMERA)
        still_m.append(pose_distance(still.T_cam_world, p.T_true)[0])
        assert found.is_inlier[p.is_wrong].mean() < 0.03
        assert found.is_inlier[~p.is_wrong].mean() > 0.9
    assert np.median(off_rad_s) < 0.2
    assert np.median(off_m) < 0.6 * np.median(still_m), "taking all rows at once must cost more than it spares"


def test_where_all_rows_are_read_at_once_the_pose_is_that_of_the_usual_optimiser() -> None:
    p = rows_problem(3, speed=0.0)
    expected = np.array([0.1, 0.0, -0.2, 0.3, 0.0, -0.1])
    found = optimizer()(p.T_guess, expected, p.points, p.observed, p.weights, np.zeros(300), CAMERA)
    usual = PoseOptimizerConfig().build()(p.T_guess, p.points, p.observed, p.weights, CAMERA)
    assert pose_distance(found.T_cam_world, usual.T_cam_world)[0] < 1e-6
    np.testing.assert_array_equal(found.is_inlier, usual.is_inlier)
    np.testing.assert_allclose(found.velocity, expected, atol=1e-9)


def test_too_few_points_leave_pose_and_velocity_as_they_were() -> None:
    p = rows_problem(5, n=4)
    expected = np.full(6, 0.1)
    found = optimizer()(p.T_guess, expected, p.points[:2], p.observed[:2], p.weights[:2], p.after_s[:2], CAMERA)
    np.testing.assert_array_equal(found.T_cam_world, p.T_guess)
    np.testing.assert_array_equal(found.velocity, expected)
    assert not found.is_inlier.any()


@pytest.mark.parametrize("seed", range(3))
def test_keypoints_are_moved_to_where_the_middle_of_the_frame_sees_them(seed: int) -> None:
    p = rows_problem(seed, wrong=0.0, noise=0.0)
    depth_m = points_seen(p.T_true, p.velocity, p.points, p.after_s)[:, 2]
    px = predicted(p.T_true, p.velocity, p.points, p.after_s)[:, :2]
    middle = predicted(p.T_true, np.zeros(6), p.points, p.after_s)[:, :2]
    found = at_mid_frame(px, depth_m, 2.0, p.after_s, p.velocity, INTRINSICS)
    assert np.abs(found - middle).max() < 0.06
    assert np.abs(px - middle).max() > 2.0
    unknown = at_mid_frame(px, np.zeros(len(px)), 2.0, p.after_s, p.velocity, INTRINSICS)
    np.testing.assert_array_equal(
        unknown, at_mid_frame(px, np.full(len(px), 2.0), 9.0, p.after_s, p.velocity, INTRINSICS)
    )


@pytest.mark.parametrize("known", [0.0, 0.6, 1.0])
def test_keypoints_at_mid_frame_have_the_depth_of_the_others_where_theirs_is_unknown(known: float) -> None:
    rng = np.random.default_rng(6)
    px = rng.uniform(0, 480, (51, 2)).astype(np.float32)
    depth_m = np.where(rng.random(51) < known, rng.uniform(1, 4, 51), 0.0).astype(np.float32)
    velocity = np.array([0.3, -0.1, 0.2, 0.4, -0.8, 0.5])
    found, right_px = keypoints_at_mid_frame(px, depth_m, px[:, 1], 2.0, (480.0, READOUT_S), velocity, INTRINSICS)
    is_known = depth_m > 0
    typical_m = np.median(depth_m[is_known]) if is_known.any() else 2.0
    assert is_known.mean() == pytest.approx(known, abs=0.2)
    after_s = ((px[:, 1].astype(np.float64) + 0.5) / 480 - 0.5) * READOUT_S
    expected = at_mid_frame(px, np.where(is_known, depth_m, np.float32(typical_m)), 1.0, after_s, velocity, INTRINSICS)
    np.testing.assert_array_equal(found, expected.astype(np.float32))
    assert np.abs(found - px).max() > 1.0
    np.testing.assert_allclose(right_px[is_known], found[is_known, 0] - CAMERA.bf / depth_m[is_known], rtol=1e-6)
    assert (right_px[~is_known] == -1.0).all()
