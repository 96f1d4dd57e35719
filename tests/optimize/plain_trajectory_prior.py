"""The trajectory prior in plain numpy and scipy: what the kernels must come to."""

import numpy as np
from scipy.linalg import solveh_banded

from stillroom.geometry import se3, twists
from stillroom.geometry.arrays import F64
from stillroom.optimize.trajectory_prior import STEP_S, TrajectoryPriorConfig

BAND = 3 * 6 + 6


def smoothed_piece(times_s: F64, T: F64, n_inliers: F64, config: TrajectoryPriorConfig, iterations: int = 3) -> F64:
    """Return poses (N, 4, 4) under the prior, of N frames without a gap among them."""
    weights = np.maximum(n_inliers, 1.0) / config.typical_inliers
    n, X = len(T), T.copy()
    own = weights[:, None] * np.repeat((config.position_m, config.rotation_rad), 3) ** -2.0
    jerk = _third_differences(times_s)  # (n − 3, 3): of the velocities between frames
    scale = np.sqrt(STEP_S / (0.5 * (times_s[3:] - times_s[:-3]) * (2.0 / 3.0)))
    prior = np.repeat((config.jerk_m_s3, config.jerk_rad_s3), 3)[None] * scale[:, None]
    for _ in range(iterations):
        off = twists.log(se3.inverse(T) @ X)
        steps = se3.inverse(X[:-1]) @ X[1:]
        speed = twists.log(steps) / np.diff(times_s)[:, None]
        # A velocity changes by (δ of the later pose − that of the earlier one, seen from the later) over the time.
        behind = twists.adjoint(se3.inverse(steps)) / np.diff(times_s)[:, None, None]
        ahead = 1.0 / np.diff(times_s)
        residual = np.einsum("kj,kja->ka", jerk, np.stack([speed[:-2], speed[1:-1], speed[2:]], axis=1)) / prior
        J = np.zeros((n - 3, 4, 6, 6))
        identity = np.eye(6)
        for j in range(3):
            J[:, j] -= jerk[:, j, None, None] * behind[j : n - 3 + j]
            J[:, j + 1] += (jerk[:, j] * ahead[j : n - 3 + j])[:, None, None] * identity
        J /= prior[:, None, :, None]
        banded, slope = _normal_equations(J, residual, own, off)
        step = solveh_banded(banded, -slope.ravel(), lower=True, overwrite_ab=True, check_finite=False)
        X = X @ twists.exp(step.reshape(n, 6))
    return X


def _third_differences(times_s: F64) -> F64:
    """Return the weights (N − 3, 3) that make of three velocities between four frames their change of acceleration."""
    middle_s = 0.5 * (times_s[1:] + times_s[:-1])
    first, second = middle_s[1:-1] - middle_s[:-2], middle_s[2:] - middle_s[1:-1]
    whole = 0.5 * (middle_s[2:] - middle_s[:-2])
    return np.stack((1.0 / first, -1.0 / first - 1.0 / second, 1.0 / second), axis=1) / whole[:, None]


def _normal_equations(J: F64, residual: F64, own: F64, off: F64) -> tuple[F64, F64]:
    """Return the normal equations, the lower band (24, 6N) and the slope (N, 6).

    Args:
        J: Derivatives (N − 3, 4, 6, 6) of the prior's residuals by four poses.
        residual: Those (N − 3, 6).
        own: Inverse variances of the frames' own poses (N, 6).
        off: How far they are now from them (N, 6).
    """
    n = len(own)
    slope = own * off
    banded = np.zeros((BAND, 6 * n))
    banded[0] = own.ravel()
    for a in range(4):
        slope[a : n - 3 + a] += np.einsum("kra,kr->ka", J[:, a], residual)
        for b in range(a + 1):
            block = np.einsum("kri,krj->kij", J[:, a], J[:, b])  # rows of pose a, columns of pose b
            columns = 6 * (np.arange(n - 3) + b)
            for i in range(6):
                for j in range(6):
                    below = 6 * (a - b) + i - j
                    if below >= 0:
                        banded[below, columns + j] += block[:, i, j]
    return banded, slope
