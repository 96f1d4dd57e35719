"""Pose-only optimisation under a rolling shutter: the camera moves while the rows of an image are read.

A keypoint on row v was seen τ = ((v + ½)/H − ½) · readout after the middle of the image, from T(τ) = exp(τ ν) T with
the velocity ν = (ρ̇ [m/s], ω [rad/s]) in the camera's frame. A point x of the camera at mid-frame so comes to lie at
exp(τ ν) x, and its derivative by ν is τ times that by the pose: the normal equations of both are the moments
Σ τᵏ GᵀJᵀWJG, k = 0, 1, 2, of one observation's block. The velocity has a prior, for a few rows of a still image tell
nothing of it.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from stillroom.compiled import njit
from stillroom.geometry.arrays import F32, F64, Bool, Floats
from stillroom.geometry.camera import Camera
from stillroom.optimize.observations import (
    MIN_DEPTH_M,
    behind_chi_square,
    chi_square,
    huber,
    intrinsics_of,
    point_information,
    residual,
    retract,
    to_camera,
)
from stillroom.optimize.pose import MIN_OBSERVATIONS, PoseOptimizerConfig, solve_damped

_FIRST_DAMPING = 1e-5
_TINY_STEP = 1e-7
_TINY_DECREASE = 1e-7
_VALUES = 28
"""Of a symmetric block (6, 6) and its slope, and one that makes them a multiple of four."""


class SeenInRows(NamedTuple):
    """One camera's N observations with the times of their rows, as the kernels take them.

    Attributes:
        points_world_m: The points (N, 3) float64 [m].
        observed_px: u, v, u_right (N, 3) float64 [px], as seen at those times.
        weights: Inverse variances (N, 3) float64 [1/px²].
        p_static: How much each counts (N,) float64, 0 to 1.
        after_s: When each was seen, from mid-frame on (N,) float64 [s].
        intrinsics: Those of `intrinsics_of` (6,).
        expected: The velocity expected (6,) float64 [m/s, rad/s].
        information: Inverse variances of that (6,) float64.
    """

    points_world_m: F64
    observed_px: F64
    weights: F64
    p_static: F64
    after_s: F64
    intrinsics: F64
    expected: F64
    information: F64


@njit(nogil=True, cache=True)
def seen_from(T: F64, velocity: F64, point: F64, after_s: float) -> tuple[float, float, float]:
    """Return a world point (3,) [m] in the camera's frame at a time after mid-frame, to the turn's second order."""
    x, y, z = to_camera(T, point[0], point[1], point[2])
    a, b, c = after_s * velocity[3], after_s * velocity[4], after_s * velocity[5]
    # exp(φ) x ≈ x + φ × x + ½ φ × (φ × x)
    dx, dy, dz = b * z - c * y, c * x - a * z, a * y - b * x
    x2 = x + dx + 0.5 * (b * dz - c * dy) + after_s * velocity[0]
    y2 = y + dy + 0.5 * (c * dx - a * dz) + after_s * velocity[1]
    z2 = z + dz + 0.5 * (a * dy - b * dx) + after_s * velocity[2]
    return x2, y2, z2


@njit(nogil=True, cache=True)
def classify_rows(
    T: F64, velocity: F64, seen: SeenInRows, limits: tuple[float, float], chi2: F64, is_inlier: Bool
) -> int:
    """Write χ² (N,) and whether it is within its limit (N,); return how many changed; see `pose.classify`."""
    limit_2d, limit_3d = limits
    changed = 0
    for i in range(len(seen.points_world_m)):
        x, y, z = seen_from(T, velocity, seen.points_world_m[i], seen.after_s[i])
        chi2[i] = chi_square(x, y, z, seen.observed_px[i], seen.weights[i], seen.intrinsics)
        limit = limit_3d if seen.weights[i, 2] > 0.0 else limit_2d
        verdict = chi2[i] < np.inf and chi2[i] <= limit
        changed += verdict != is_inlier[i]
        is_inlier[i] = verdict
    return changed


@njit(nogil=True, cache=True)
def camera_values(x: float, y: float, z: float, information: tuple[float, ...], values: F64) -> None:
    """Write GᵀJᵀWJG, the lower triangle row by row, and then GᵀJᵀWe: as `camera_blocks`, one after the other."""
    a00, a01, a02, a11, a12, a22, g0, g1, g2 = information
    c00, c01, c02 = y * a02 - z * a01, y * a12 - z * a11, y * a22 - z * a12
    c10, c11, c12 = z * a00 - x * a02, z * a01 - x * a12, z * a02 - x * a22
    c20, c21, c22 = x * a01 - y * a00, x * a11 - y * a01, x * a12 - y * a02
    values[0] = a00
    values[1], values[2] = a01, a11
    values[3], values[4], values[5] = a02, a12, a22
    values[6], values[7], values[8], values[9] = c00, c01, c02, y * c02 - z * c01
    values[10], values[11], values[12] = c10, c11, c12
    values[13], values[14] = y * c12 - z * c11, z * c10 - x * c12
    values[15], values[16], values[17] = c20, c21, c22
    values[18], values[19], values[20] = y * c22 - z * c21, z * c20 - x * c22, x * c21 - y * c20
    values[21], values[22], values[23] = g0, g1, g2
    values[24], values[25], values[26] = y * g2 - z * g1, z * g0 - x * g2, x * g1 - y * g0


@njit(nogil=True, cache=True)
def linearize_rows(
    T: F64, velocity: F64, seen: SeenInRows, is_active: Bool, deltas2: tuple[float, float], H: F64, b: F64
) -> float:
    """Write the normal equations of pose and velocity, lower triangle of `H` (12, 12), `b` (12,); return the cost."""
    cost = 0.0
    values = np.zeros(_VALUES)
    sums_0, sums_1, sums_2 = np.zeros(_VALUES), np.zeros(_VALUES), np.zeros(_VALUES)  # Σ τᵏ of them
    for i in range(len(seen.points_world_m)):
        if not is_active[i]:
            continue
        after_s = seen.after_s[i]
        x, y, z = seen_from(T, velocity, seen.points_world_m[i], after_s)
        weight, observed = seen.weights[i], seen.observed_px[i]
        chi2 = chi_square(x, y, z, observed, weight, seen.intrinsics)
        has_right = weight[2] > 0.0
        delta2 = deltas2[1] if has_right else deltas2[0]
        if chi2 == np.inf:
            cost += seen.p_static[i] * huber(behind_chi_square(weight, seen.intrinsics), delta2)[0]
            continue
        rho, factor = huber(chi2, delta2)
        cost += seen.p_static[i] * rho
        error = residual(x, y, z, observed, seen.intrinsics, has_right)
        information = point_information((x, y, z), error, weight, seen.p_static[i] * factor, seen.intrinsics)
        camera_values(x, y, z, information, values)
        after_s2 = after_s * after_s
        for k in range(_VALUES):
            sums_0[k] += values[k]
            sums_1[k] += after_s * values[k]
            sums_2[k] += after_s2 * values[k]
    H[:] = 0.0
    k = 0
    for r in range(6):
        b[r], b[6 + r] = sums_0[21 + r], sums_1[21 + r]
        for c in range(r + 1):
            H[r, c], H[6 + r, 6 + c] = sums_0[k], sums_2[k]
            H[6 + r, c] = H[6 + c, r] = sums_1[k]
            k += 1
    for r in range(6):
        off = velocity[r] - seen.expected[r]
        cost += seen.information[r] * off * off
        H[6 + r, 6 + r] += seen.information[r]
        b[6 + r] += seen.information[r] * off
    return cost


@njit(nogil=True, cache=True)
def damped_step_rows(H: F64, b: F64, damping: float, T: F64, velocity: F64, T_trial: F64, velocity_trial: F64) -> float:
    """Solve (H + λ diag H) δ = −b by Cholesky, write pose and velocity moved; return the pose's |δ|, −1 if it fails."""
    step = np.empty(12)
    if not solve_damped(H, b, damping, step):
        return -1.0
    norm: float = np.sqrt((step[:6] * step[:6]).sum())
    if not norm < np.inf:
        return -1.0
    retract(T, step[:6], T_trial)
    velocity_trial[:] = velocity + step[6:]
    return norm


@njit(nogil=True, cache=True)
def robust_rows(
    guess: F64, velocity: F64, seen: SeenInRows, rounds: int, iterations: int, limits: tuple[float, float], chi2: F64,
    is_inlier: Bool,
) -> tuple[F64, F64]:  # fmt: skip
    """Run rounds of Levenberg–Marquardt, each with a classification, as `PoseOptimizer`; return pose and velocity."""
    H, b, H_trial, b_trial = np.empty((12, 12)), np.empty(12), np.empty((12, 12)), np.empty(12)
    T, T_trial = guess.copy(), np.empty((4, 4))
    v, v_trial = velocity.copy(), np.empty(6)
    is_inlier[:] = False
    classify_rows(T, v, seen, (np.inf, np.inf), chi2, is_inlier)
    for number in range(rounds):
        if np.count_nonzero(is_inlier) < MIN_OBSERVATIONS:
            break
        deltas2 = limits if number < 3 else (np.inf, np.inf)
        damping, converged = _FIRST_DAMPING, False
        cost = linearize_rows(T, v, seen, is_inlier, deltas2, H, b)
        for _ in range(iterations):
            step = damped_step_rows(H, b, damping, T, v, T_trial, v_trial)
            if 0.0 <= step < _TINY_STEP:
                converged = True
                break
            trial_cost = np.inf
            if step >= 0.0:
                trial_cost = linearize_rows(T_trial, v_trial, seen, is_inlier, deltas2, H_trial, b_trial)
            if not trial_cost <= cost:
                if trial_cost - cost <= _TINY_DECREASE * cost:  # as far as the derivatives, to the first order, lead
                    converged = True
                    break
                damping *= 10.0
                continue
            decrease = cost - trial_cost
            T, T_trial = T_trial, T
            v, v_trial = v_trial, v
            H, H_trial, b, b_trial, cost = H_trial, H, b_trial, b, trial_cost
            damping *= 0.1
            if decrease <= _TINY_DECREASE * cost:
                converged = True
                break
        changed = classify_rows(T, v, seen, limits, chi2, is_inlier)
        if converged and changed == 0:
            break
    if np.count_nonzero(is_inlier) < MIN_OBSERVATIONS:
        classify_rows(guess, velocity, seen, (-1.0, -1.0), chi2, is_inlier)
        return guess, velocity
    return T, v


@njit(nogil=True, cache=True)
def at_mid_frame(px: Floats, depth_m: Floats, typical_m: float, after_s: F64, velocity: F64, intrinsics: F64) -> F64:
    """Return where keypoints (N, 2) [px] would be seen at mid-frame: exp(−τ ν) of each at its depth (N,) [m]."""
    moved = np.empty((len(px), 2))
    fx, fy, cx, cy = intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]
    for i in range(len(px)):
        z = float(depth_m[i]) if depth_m[i] > 0.0 else typical_m
        x, y = (px[i, 0] - cx) / fx * z, (px[i, 1] - cy) / fy * z
        t = -after_s[i]
        x, y, zz = x + t * velocity[0], y + t * velocity[1], z + t * velocity[2]
        a, b, c = t * velocity[3], t * velocity[4], t * velocity[5]
        dx, dy, dz = b * zz - c * y, c * x - a * zz, a * y - b * x
        x2 = x + dx + 0.5 * (b * dz - c * dy)
        y2 = y + dy + 0.5 * (c * dx - a * dz)
        z2 = max(zz + dz + 0.5 * (a * dy - b * dx), MIN_DEPTH_M)
        moved[i, 0], moved[i, 1] = fx * x2 / z2 + cx, fy * y2 / z2 + cy
    return moved


@njit(nogil=True, cache=True)
def keypoints_at_mid_frame(
    px: F32, depth_m: F32, raw_y_px: F32, typical_m: float, timing: tuple[float, float], velocity: F64, intrinsics: F64
) -> tuple[F32, F32]:
    """Return where keypoints would be seen at mid-frame (N, 2) [px], and their right coordinates (N,) [px].

    Args:
        px: Where they are seen (N, 2) [px].
        depth_m: Their depth (N,) [m]; 0 where unknown. Those lie at the median of the others.
        raw_y_px: Their rows in the image as taken (N,).
        typical_m: The depth where that of none is known [m].
        timing: Rows of an image, and how long they take to be read [s].
        velocity: Of the camera (6,) [m/s, rad/s].
        intrinsics: Those of `intrinsics_of` (6,).
    """
    height, readout_s = timing
    known = depth_m[depth_m > 0]
    if len(known) > 0:
        typical_m = float(np.median(known))
    after_s = ((raw_y_px.astype(np.float64) + 0.5) / height - 0.5) * readout_s
    moved = at_mid_frame(px, depth_m, typical_m, after_s, velocity, intrinsics).astype(np.float32)
    right_px, bf = np.full(len(px), -1.0, np.float32), np.float32(intrinsics[4])
    for i in range(len(px)):
        if depth_m[i] > 0:
            right_px[i] = moved[i, 0] - bf / depth_m[i]
    return moved, right_px


@dataclass(frozen=True)
class RollingPoseEstimate:
    """An optimised pose and velocity.

    Attributes:
        T_cam_world: The pose at mid-frame (4, 4) float64.
        velocity: Of the camera while the frame was read (6,) [m/s, rad/s], in its own frame.
        is_inlier: Which observations are inliers (N,) bool.
    """

    T_cam_world: F64
    velocity: F64
    is_inlier: Bool


class RollingPoseOptimizer:
    """Estimates pose and velocity of a frame from known points, robust to wrong matches."""

    def __init__(self, config: PoseOptimizerConfig, information: F64) -> None:
        """Take the inverse variances (6,) of a velocity about the expected one [s²/m², s²/rad²]."""
        self.config, self._information = config, np.ascontiguousarray(information, dtype=np.float64)

    def __call__(
        self,
        guess: F64,
        expected: F64,
        points_world_m: Floats,
        observed_px: Floats,
        weights: Floats,
        after_s: Floats,
        camera: Camera,
        p_static: Floats | None = None,
        share_of_u: float = 1.0,
    ) -> RollingPoseEstimate:
        """Optimise both and classify every observation; otherwise as `PoseOptimizer`.

        Args:
            guess: Where to start (4, 4), T_cam_world at mid-frame.
            expected: The velocity expected (6,) [m/s, rad/s].
            points_world_m: Points (N, 3) [m], world frame.
            observed_px: u, v, u_right (N, 3) [px], undistorted, as seen at their rows' times.
            weights: Inverse variances (N, 3) [1/px²]; the third is 0 where there is no right coordinate.
            after_s: When each was seen, from mid-frame on (N,) [s].
            camera: Intrinsics and bf.
            p_static: How much each observation counts (N,), 0 to 1; all 1 by default.
            share_of_u: 1 where the third coordinate is u_right; 0 where it is −bf/z (`optimize.depth_terms`).
        """
        config, n = self.config, len(points_world_m)
        points, observed, variances = (
            np.ascontiguousarray(array, dtype=np.float64).reshape(-1, 3)
            for array in (points_world_m, observed_px, weights)
        )
        likely = np.ones(n) if p_static is None else np.ascontiguousarray(p_static, dtype=np.float64)
        times_s, velocity = np.ascontiguousarray(after_s, dtype=np.float64), np.array(expected, dtype=np.float64)
        intrinsics = intrinsics_of(camera, share_of_u)
        seen = SeenInRows(points, observed, variances, likely, times_s, intrinsics, velocity, self._information)
        chi2, is_inlier = np.empty(n), np.empty(n, dtype=np.bool_)
        start = np.array(guess, dtype=np.float64, order="C")
        limits = config.chi2_2d, config.chi2_3d
        T, found = robust_rows(start, velocity, seen, config.rounds, config.iterations, limits, chi2, is_inlier)
        return RollingPoseEstimate(T, found, is_inlier)
