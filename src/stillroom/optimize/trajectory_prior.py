"""A trajectory moves as cameras move: the poses of all frames as one estimate, under a prior of smooth motion.

The prior is white noise on jerk (Barfoot, State Estimation for Robotics, 2017, section 3.4, on SE(3) as in its section
11.1): the velocity between two frames changes as steadily as a hand's. A frame's own pose counts by the number of map
points that agree with it. The estimate is found by Gauss–Newton on a banded system.
"""

from dataclasses import dataclass

import numpy as np

from stillroom.bounds import bounded
from stillroom.geometry import se3, twists
from stillroom.geometry.arrays import F64, Floats

STEP_S = 1.0 / 30.0
"""The frame rate at which the standard deviations are given."""
LEAST_POSES = 4
LONGEST_STEP_S = 0.25
"""Over a longer gap, such as while tracking was lost, nothing is known of the motion."""
FASTEST_M_S = 5.0
"""A faster step is no motion: the map was corrected there."""
ITERATIONS = 3
WINDOW = 20
"""Earlier frames that a lagged pose is estimated with; what lies further back hardly moves it."""
BAND = 3 * 6 + 6


@dataclass(frozen=True)
class TrajectoryPriorConfig:
    """The prior, and how far a frame's own pose is trusted.

    Attributes:
        enabled: Whether the final trajectory is estimated under it.
        position_m, rotation_rad: Standard deviation of a frame's own pose with which `typical_inliers` points agree.
        typical_inliers: That number of points.
        jerk_m_s3, jerk_rad_s3: Standard deviation of the change of acceleration, at thirty frames a second.
        lag: Frames that come after one before its pose in the lagged trajectory is settled.
    """

    enabled: bool = False
    position_m: float = bounded(0.003, above=0)
    rotation_rad: float = bounded(0.001, above=0)
    typical_inliers: int = bounded(300, least=1)
    jerk_m_s3: float = bounded(12.0, above=0)
    jerk_rad_s3: float = bounded(4.0, above=0)
    lag: int = bounded(5, least=0)


def smoothed(times_s: F64, T: F64, n_inliers: Floats, config: TrajectoryPriorConfig) -> F64:
    """Return poses (N, 4, 4) under the prior; pieces between gaps and jumps are estimated each by itself.

    Args:
        times_s: Times (N,) [s], increasing.
        T: Poses of the camera, T_world_cam (N, 4, 4).
        n_inliers: Map points that agree with each pose (N,).
        config: The prior.
    """
    result = T.copy()
    steps_s, steps_m = np.diff(times_s), np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1)
    jumps = (steps_s > LONGEST_STEP_S) | (steps_s <= 0.0) | (steps_m > FASTEST_M_S * steps_s)
    ends = np.flatnonzero(jumps) + 1
    for piece in np.split(np.arange(len(times_s)), ends):
        if len(piece) >= LEAST_POSES:
            weights = np.maximum(n_inliers[piece], 1.0) / config.typical_inliers
            result[piece] = _smoothed_piece(times_s[piece], T[piece], weights, config)
    return result


def lagged(times_s: F64, T: F64, n_inliers: Floats, config: TrajectoryPriorConfig) -> F64:
    """Return poses (N, 4, 4) each as it would be settled `lag` frames later; arguments as `smoothed`.

    Each is that of its frame in a window of the last frames, which is what a run can know at that moment.
    """
    result = T.copy()
    for i in range(len(T)):
        window = slice(max(0, i - WINDOW), i + config.lag + 1)
        result[i] = smoothed(times_s[window], T[window], n_inliers[window], config)[i - window.start]
    return result


def _smoothed_piece(times_s: F64, T: F64, weights: F64, config: TrajectoryPriorConfig) -> F64:
    from scipy.linalg import solveh_banded

    n, X = len(T), T.copy()
    own = weights[:, None] * np.repeat((config.position_m, config.rotation_rad), 3) ** -2.0
    jerk = _third_differences(times_s)  # (n − 3, 3): of the velocities between frames
    scale = np.sqrt(STEP_S / (0.5 * (times_s[3:] - times_s[:-3]) * (2.0 / 3.0)))
    prior = np.repeat((config.jerk_m_s3, config.jerk_rad_s3), 3)[None] * scale[:, None]
    for _ in range(ITERATIONS):
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
