"""A trajectory moves as cameras move: the poses of all frames as one estimate, under a prior of smooth motion.

The prior is white noise on jerk (Barfoot, State Estimation for Robotics, 2017, section 3.4, on SE(3) as in its section
11.1): the velocity between two frames changes as steadily as a hand's. A frame's own pose counts by the number of map
points that agree with it. The estimate is found by Gauss–Newton on a banded system (`optimize/trajectory_kernels.py`):
of all frames when a run ends, and of the newest ones after each frame.
"""

from dataclasses import dataclass

import numpy as np

from stillroom.bounds import bounded
from stillroom.geometry.arrays import F64, Floats
from stillroom.optimize.trajectory_kernels import Prior, follow, move_pieces

STEP_S = 1.0 / 30.0
"""The frame rate at which the standard deviations are given."""
LONGEST_STEP_S = 0.25
"""Over a longer gap, such as while tracking was lost, nothing is known of the motion."""
FASTEST_M_S = 5.0
"""A faster step is no motion: the map was corrected there."""
ITERATIONS = 3
ROUNDS_AT_ONCE = 1
"""Rounds after a new frame: the others start from where the frame before left them."""
WINDOW = 20
"""Frames before it that a lagged pose is estimated with; what lies further back hardly moves it."""


@dataclass(frozen=True)
class TrajectoryPriorConfig:
    """The prior, and how far a frame's own pose is trusted.

    Attributes:
        enabled: Whether trajectories are estimated under it: those reported at once, and the final one.
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
    own, X = np.ascontiguousarray(T, dtype=np.float64), np.array(T, dtype=np.float64, order="C")
    move_pieces(np.ascontiguousarray(times_s), own, prior_of(n_inliers, config), ITERATIONS, X)
    return X


class TrajectoryFilter:
    """The poses of the newest frames under the prior, frame after frame: what can be known at each moment."""

    def __init__(self, config: TrajectoryPriorConfig) -> None:
        """Start before the first frame."""
        self.config = config
        self._T_own_cam: F64 = np.zeros((0, 4, 4))

    @property
    def reach(self) -> int:
        """Number of frames that are estimated together."""
        return WINDOW + self.config.lag + 1

    def add(self, times_s: F64, T: F64, n_inliers: Floats) -> F64:
        """Take a new frame, and return the poses of the newest frames (N, 4, 4), its own the last one.

        Args:
            times_s: Times of the newest frames (N,) [s], increasing: those of the call before and the new one, without
                the oldest when there are more than `reach`.
            T: Their poses, T_world_cam (N, 4, 4), as known now: a map that was corrected has moved them.
            n_inliers: Map points that agree with each (N,).
        """
        T_own_cam, n_known = np.tile(np.eye(4), (len(T), 1, 1)), min(len(self._T_own_cam), len(T) - 1)
        T_own_cam[len(T) - 1 - n_known : -1] = self._T_own_cam[len(self._T_own_cam) - n_known :]
        self._T_own_cam = T_own_cam
        X: F64 = follow(times_s, T, prior_of(n_inliers, self.config), ROUNDS_AT_ONCE, T_own_cam)
        return X


def prior_of(n_inliers: Floats, config: TrajectoryPriorConfig) -> Prior:
    """Return a prior as the kernels take it, for frames with which some map points (N,) agree."""
    weights = np.maximum(n_inliers, 1.0) / config.typical_inliers
    own: F64 = weights[:, None] * _six(config.position_m**-2.0, config.rotation_rad**-2.0)
    return Prior(own, _six(config.jerk_m_s3, config.jerk_rad_s3), STEP_S, LONGEST_STEP_S, FASTEST_M_S)


def _six(of_translation: float, of_rotation: float) -> F64:
    return np.array((of_translation,) * 3 + (of_rotation,) * 3)
