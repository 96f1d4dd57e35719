"""Pose-only optimisation: one camera against fixed points, robust, with outlier rejection.

After ORB-SLAM2 (Mur-Artal and Tardós 2017, section III-B, motion-only bundle adjustment;
docs/reference.md#orb-slam2-tracking).
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from stillroom.bounds import bounded
from stillroom.compiled import njit
from stillroom.geometry.arrays import F64, Bool, Floats
from stillroom.geometry.camera import Camera
from stillroom.optimize.observations import (
    behind_chi_square,
    camera_blocks,
    chi_square,
    huber,
    intrinsics_of,
    point_information,
    residual,
    retract,
    to_camera,
)

MIN_OBSERVATIONS = 3
_FIRST_DAMPING = 1e-5
_TINY_STEP = 1e-7
_TINY_DECREASE = 1e-7


class Seen(NamedTuple):
    """One camera's N observations, as the kernels take them.

    Attributes:
        points_world_m: The points (N, 3) float64 [m].
        observed_px: u, v, u_right (N, 3) float64 [px].
        weights: Inverse variances (N, 3) float64 [1/px²].
        p_static: How much each counts (N,) float64, 0 to 1.
        intrinsics: Those of `intrinsics_of` (6,).
    """

    points_world_m: F64
    observed_px: F64
    weights: F64
    p_static: F64
    intrinsics: F64


@njit(nogil=True, cache=True)
def classify(T: F64, seen: Seen, limits: tuple[float, float], chi2: F64, is_inlier: Bool) -> int:
    """Write χ² (N,) and whether it is within its limit (N,); return how many changed.

    Args:
        T: The pose T_cam_world (4, 4).
        seen: The observations.
        limits: On χ², without and with a right coordinate.
        chi2, is_inlier: What is written.
    """
    points_world_m, observed_px, weights, _, intrinsics = seen
    limit_2d, limit_3d = limits
    changed = 0
    for i in range(points_world_m.shape[0]):
        x, y, z = to_camera(T, points_world_m[i, 0], points_world_m[i, 1], points_world_m[i, 2])
        chi2[i] = chi_square(x, y, z, observed_px[i], weights[i], intrinsics)
        limit = limit_3d if weights[i, 2] > 0.0 else limit_2d
        verdict = chi2[i] < np.inf and chi2[i] <= limit
        changed += verdict != is_inlier[i]
        is_inlier[i] = verdict
    return changed


@njit(nogil=True, cache=True)
def linearize_pose(T: F64, seen: Seen, is_active: Bool, deltas2: tuple[float, float], H: F64, b: F64) -> float:
    """Write the normal equations of the pose, lower triangle of `H` (6, 6) and `b` (6,); return the robust cost Σpρ.

    Args:
        T: The pose T_cam_world (4, 4).
        seen: The observations.
        is_active: Which of them count (N,).
        deltas2: Huber's squared thresholds, without and with a right coordinate.
        H, b: What is written.
    """
    points_world_m, observed_px, weights, p_static, intrinsics = seen
    delta2_2d, delta2_3d = deltas2
    H[:] = 0.0
    b[:] = 0.0
    cost = 0.0
    for i in range(points_world_m.shape[0]):
        if not is_active[i]:
            continue
        x, y, z = to_camera(T, points_world_m[i, 0], points_world_m[i, 1], points_world_m[i, 2])
        chi2 = chi_square(x, y, z, observed_px[i], weights[i], intrinsics)
        has_right = weights[i, 2] > 0.0
        delta2 = delta2_3d if has_right else delta2_2d
        if chi2 == np.inf:
            cost += p_static[i] * huber(behind_chi_square(weights[i], intrinsics), delta2)[0]
            continue
        rho, factor = huber(chi2, delta2)
        cost += p_static[i] * rho
        error = residual(x, y, z, observed_px[i], intrinsics, has_right)
        information = point_information((x, y, z), error, weights[i], p_static[i] * factor, intrinsics)
        camera_blocks(x, y, z, information, H, b)
    return cost


@njit(nogil=True, cache=True)
def solve_damped(H: F64, b: F64, damping: float, step: F64) -> bool:
    """Solve (H + λ diag H) δ = −b by Cholesky, of the lower triangle of `H` (n, n); return whether it has a solution.

    Args:
        H, b: The normal equations (n, n), (n,).
        damping: λ.
        step: δ (n,), written.
    """
    n = len(b)
    L = np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            s = H[i, j]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            if i > j:
                L[i, j] = s / L[j, j]
                continue
            s += damping * H[i, i] + 1e-9
            if not s > 0.0:
                return False
            L[i, i] = np.sqrt(s)
    for i in range(n):
        step[i] = -b[i]
        for k in range(i):
            step[i] -= L[i, k] * step[k]
        step[i] /= L[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            step[i] -= L[k, i] * step[k]
        step[i] /= L[i, i]
    return True


@njit(nogil=True, cache=True)
def damped_step(H: F64, b: F64, damping: float, T: F64, T_trial: F64) -> float:
    """Solve (H + λ diag H) ξ = −b by Cholesky and write exp(ξ) T into `T_trial` (4, 4); return |ξ|, −1 if it fails."""
    xi = np.empty(6)
    if not solve_damped(H, b, damping, xi):
        return -1.0
    norm: float = np.sqrt((xi * xi).sum())
    if not norm < np.inf:
        return -1.0
    retract(T, xi, T_trial)
    return norm


@njit(nogil=True, cache=True)
def minimize_pose(
    T_start: F64, seen: Seen, is_active: Bool, iterations: int, deltas2: tuple[float, float]
) -> tuple[F64, bool]:
    """Run Levenberg–Marquardt on the active observations; return the pose (4, 4) and whether it converged.

    Args:
        T_start: Where to start, T_cam_world (4, 4).
        seen: The observations.
        is_active: Which of them count (N,).
        iterations: Most steps that are tried.
        deltas2: Huber's squared thresholds, without and with a right coordinate.
    """
    H, b, H_trial, b_trial = np.empty((6, 6)), np.empty(6), np.empty((6, 6)), np.empty(6)
    T, T_trial = T_start, np.empty((4, 4))
    damping = _FIRST_DAMPING
    cost = linearize_pose(T, seen, is_active, deltas2, H, b)
    for _ in range(iterations):
        step = damped_step(H, b, damping, T, T_trial)
        if 0.0 <= step < _TINY_STEP:
            return T, True
        trial_cost = np.inf
        if step >= 0.0:
            trial_cost = linearize_pose(T_trial, seen, is_active, deltas2, H_trial, b_trial)
        if not trial_cost <= cost:
            damping *= 10.0
            continue
        decrease = cost - trial_cost
        T, T_trial = T_trial, np.empty((4, 4))
        H, H_trial, b, b_trial, cost = H_trial, H, b_trial, b, trial_cost
        damping *= 0.1
        if decrease <= _TINY_DECREASE * cost:
            return T, True
    return T, False


@njit(nogil=True, cache=True)
def robust_pose(
    guess: F64, seen: Seen, rounds: int, iterations: int, limits: tuple[float, float], chi2: F64, is_inlier: Bool
) -> F64:
    """Run rounds of `minimize_pose`, a classification after each, as `PoseOptimizer` tells; return the pose (4, 4).

    Args:
        guess: Where to start, T_cam_world (4, 4).
        seen: The observations.
        rounds: Most rounds.
        iterations: Most steps of a round.
        limits: On χ², without and with a right coordinate.
        chi2, is_inlier: What is written, (N,).
    """
    T = guess
    is_inlier[:] = False
    classify(guess, seen, (np.inf, np.inf), chi2, is_inlier)
    for number in range(rounds):
        if np.count_nonzero(is_inlier) < MIN_OBSERVATIONS:
            break
        T, converged = minimize_pose(T, seen, is_inlier, iterations, limits if number < 3 else (np.inf, np.inf))
        changed = classify(T, seen, limits, chi2, is_inlier)
        if converged and changed == 0:
            break
    if np.count_nonzero(is_inlier) < MIN_OBSERVATIONS:
        classify(guess, seen, (-1.0, -1.0), chi2, is_inlier)
        return guess
    return T


@dataclass(frozen=True)
class PoseEstimate:
    """An optimised pose and its inliers.

    Attributes:
        T_cam_world: The pose (4, 4) float64.
        is_inlier: Which observations are inliers (N,) bool.
        chi2: Weighted squared error (N,) float64; infinite behind the camera.
    """

    T_cam_world: F64
    is_inlier: Bool
    chi2: F64

    @property
    def n_inliers(self) -> int:
        """Number of inliers."""
        return int(np.count_nonzero(self.is_inlier))


@dataclass(frozen=True)
class PoseOptimizerConfig:
    """Pose-only optimisation.

    Attributes:
        rounds: Optimisations, each followed by a new classification of every observation.
        iterations: Levenberg–Marquardt iterations a round, at most.
        chi2_2d: Limit on χ² without a right coordinate: 95 % at two degrees of freedom.
        chi2_3d: The same with a right coordinate: three degrees of freedom.
    """

    rounds: int = bounded(4, least=1)
    iterations: int = bounded(10, least=1)
    chi2_2d: float = bounded(5.991, above=0)
    chi2_3d: float = bounded(7.815, above=0)

    def build(self) -> "PoseOptimizer":
        """Return the optimiser."""
        return PoseOptimizer(self)


class PoseOptimizer:
    """Estimates a camera's pose from known points, robust to wrong matches."""

    def __init__(self, config: PoseOptimizerConfig | None = None) -> None:
        self.config = config or PoseOptimizerConfig()

    def __call__(
        self,
        T_cam_world_guess: F64,
        points_world_m: Floats,
        observed_px: Floats,
        weights: Floats,
        camera: Camera,
        p_static: Floats | None = None,
        share_of_u: float = 1.0,
    ) -> PoseEstimate:
        """Optimise the pose and classify every observation.

        Rounds of Levenberg–Marquardt on the present inliers, Huber's kernel in the first three and none later; after
        each round every observation is classified again, so that an outlier may become an inlier. Points behind the
        camera are outliers. With fewer than three usable observations the guess is returned and nothing is an inlier.

        Differs from ORB-SLAM2: a round starts from the last one's pose, not from the guess again, and the rounds end
        when the pose has converged and no classification changed (the inliers then lie within Huber's quadratic part,
        and further rounds would change nothing).

        Args:
            T_cam_world_guess: Where to start (4, 4).
            points_world_m: Points (N, 3) [m], world frame.
            observed_px: u, v, u_right (N, 3) [px], undistorted; u_right is not read where its weight is 0.
            weights: Inverse variances (N, 3) [1/px²]; the third is 0 where there is no right coordinate.
            camera: Intrinsics and bf.
            p_static: How much each observation counts (N,), 0 to 1: the probability that its point is static. It
                weighs the robust cost; whether an observation is an inlier depends on its χ² alone. All 1 by default.
            share_of_u: 1 where the third coordinate is u_right; 0 where it is −bf/z (`optimize.depth_terms`).
        """
        config = self.config
        n = len(points_world_m)
        points, observed, variances = (
            np.ascontiguousarray(array, dtype=np.float64).reshape(-1, 3)
            for array in (points_world_m, observed_px, weights)
        )
        likely = np.ones(n) if p_static is None else np.ascontiguousarray(p_static, dtype=np.float64)
        seen = Seen(points, observed, variances, likely, intrinsics_of(camera, share_of_u))
        chi2, is_inlier = np.empty(n), np.empty(n, dtype=np.bool_)
        guess = np.array(T_cam_world_guess, dtype=np.float64, order="C")
        limits = config.chi2_2d, config.chi2_3d
        T = robust_pose(guess, seen, config.rounds, config.iterations, limits, chi2, is_inlier)
        return PoseEstimate(T, is_inlier, chi2)
