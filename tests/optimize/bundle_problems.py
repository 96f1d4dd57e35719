"""Random bundles, and a plain numpy version of the normal equations with numerical Jacobians."""

from dataclasses import dataclass, replace

import numpy as np
from optimize_problems import CAMERA, camera_jacobian, chi_squares, huber_rho, limits, point_jacobian, predict

from stillroom.geometry import se3
from stillroom.optimize.bundle import BundleProblem


@dataclass
class Bundle:
    problem: BundleProblem
    T_true: np.ndarray
    points_true: np.ndarray
    is_wrong: np.ndarray


def bundle(
    seed: int,
    keyframes: int = 6,
    fixed: int = 2,
    points: int = 80,
    share: float = 0.6,
    wrong: float = 0.05,
    noise: float = 1.0,
    rough: float = 1.0,
) -> Bundle:
    """Keyframes that look at a box of points, each seeing a share of them; observations in random order."""
    rng = np.random.default_rng(seed)
    world = np.column_stack(
        (rng.uniform(-2.5, 2.5, points), rng.uniform(-1.5, 1.5, points), rng.uniform(2.5, 6.0, points))
    )
    T = np.stack(
        [se3.exp(np.concatenate((0.3 * rng.normal(size=3), 0.08 * rng.normal(size=3)))) for _ in range(keyframes)]
    )
    count = int(share * keyframes * points)
    keyframe, point = np.divmod(rng.permutation(keyframes * points)[:count], points)
    sigma = 1.2 ** rng.integers(0, 8, count)
    exact = np.stack([predict(T[k], world[p][None])[0] for k, p in zip(keyframe, point, strict=True)])
    observed = exact + noise * rng.normal(size=(count, 3)) * sigma[:, None]
    weights = np.repeat(1.0 / sigma[:, None] ** 2, 3, axis=1)
    has_right = rng.random(count) < 0.8
    weights[~has_right, 2] = 0.0
    observed[~has_right, 2] = -1.0
    is_wrong = rng.random(count) < wrong
    shift = rng.uniform(20, 60, (count, 2)) * rng.choice([-1.0, 1.0], (count, 2)) * sigma[:, None]
    observed[is_wrong, :2] += shift[is_wrong]
    is_fixed = np.zeros(keyframes, dtype=bool)
    is_fixed[rng.permutation(keyframes)[:fixed]] = True
    T_start = T.copy()
    for k in np.flatnonzero(~is_fixed):
        T_start[k] = se3.exp(rough * np.concatenate((0.03 * rng.normal(size=3), 0.01 * rng.normal(size=3)))) @ T[k]
    problem = BundleProblem(
        T_start,
        is_fixed,
        world + rough * 0.02 * rng.normal(size=world.shape),
        keyframe.astype(np.int32),
        point.astype(np.int32),
        observed,
        weights,
    )
    return Bundle(problem, T, world, is_wrong)


def with_start(problem: BundleProblem, T: np.ndarray, points: np.ndarray) -> BundleProblem:
    return replace(problem, T_cam_world=T, points_world_m=points)


def bundle_chi_squares(problem: BundleProblem, T: np.ndarray, points: np.ndarray) -> np.ndarray:
    """χ² of every observation (O,)."""
    chi2 = np.empty(len(problem.obs_point))
    for k in range(len(T)):
        of = problem.obs_keyframe == k
        chi2[of] = chi_squares(T[k], points[problem.obs_point[of]], problem.observed_px[of], problem.weights[of])
    return chi2


def huber_cost(problem: BundleProblem, T: np.ndarray, points: np.ndarray, use: np.ndarray | None = None) -> float:
    chi2 = bundle_chi_squares(problem, T, points)
    behind = 4 * CAMERA.fx**2 * problem.weights.sum(axis=1)
    rho = huber_rho(np.where(np.isfinite(chi2), chi2, behind), limits(problem.weights))
    return float(rho.sum() if use is None else rho[use].sum())


def dense_normal_equations(problem: BundleProblem, use: np.ndarray, robust: bool) -> tuple[np.ndarray, np.ndarray, int]:
    """JᵀWJ and JᵀWe over [free cameras, points], from numerical Jacobians; and where the points begin."""
    free = np.flatnonzero(~problem.is_fixed)
    begin = 6 * len(free)
    size = begin + 3 * len(problem.points_world_m)
    H, b = np.zeros((size, size)), np.zeros(size)
    chi2 = bundle_chi_squares(problem, problem.T_cam_world, problem.points_world_m)
    for o in np.flatnonzero(use & np.isfinite(chi2)):
        k, p = int(problem.obs_keyframe[o]), int(problem.obs_point[o])
        T, point, weight = problem.T_cam_world[k], problem.points_world_m[p], problem.weights[o]
        delta2 = float(limits(weight[None])[0])
        factor = np.sqrt(delta2 / chi2[o]) if robust and chi2[o] > delta2 else 1.0
        J = np.zeros((3, size))
        J[:, begin + 3 * p : begin + 3 * p + 3] = point_jacobian(T, point)
        if not problem.is_fixed[k]:
            slot = int(np.searchsorted(free, k))
            J[:, 6 * slot : 6 * slot + 6] = camera_jacobian(T, point)
        H += factor * J.T @ np.diag(weight) @ J
        b += factor * J.T @ (weight * (predict(T, point[None])[0] - problem.observed_px[o]))
    return H, b, begin
