"""What a measured depth tells of a camera or a point: the third coordinate of an observation, and its variance.

ORB-SLAM2 takes a depth z for a match in a second camera, at u_right = u − bf/z, as uncertain as u itself: one virtual
baseline stands for every sensor. But a depth camera measures z, with a noise of its own that does not grow with the
level on which a keypoint was found, and an error of u is none of it. So where the sensor is known, the third coordinate
is −bf/z alone, with the deviation bf σ(z)/z² (docs/reference.md#noise-of-depth).
"""

from typing import NamedTuple, Protocol

import numpy as np

from stillroom.geometry.arrays import F64
from stillroom.geometry.camera import Camera
from stillroom.geometry.depth_noise import SENSORS, DepthNoise
from stillroom.optimize.observations import intrinsics_of

RIGHT, SENSOR = "right", "sensor"
MODELS = (RIGHT, SENSOR)


class Terms(NamedTuple):
    """Observations as the kernels take them.

    Attributes:
        observed_px: u, v and the third coordinate (N, 3) [px].
        weights: Inverse variances (N, 3) [1/px²]; the third is 0 where there is no depth.
        intrinsics: Those of `intrinsics_of` (6,), which say what the third coordinate is.
    """

    observed_px: F64
    weights: F64
    intrinsics: F64


class DepthTerms(Protocol):
    """Says how much depth counts."""

    def __call__(self, observed_px: F64, weights: F64, camera: Camera) -> Terms:
        """Return the terms of observations (N, 3) u, v, u_right [px] with ORB-SLAM2's weights (N, 3) [1/px²]."""


class RightCoordinate:
    """Depth as the right coordinate of a virtual stereo pair (ORB-SLAM2)."""

    def __init__(self, sigma: float = 1.0) -> None:
        """Take the deviation of right coordinates, as a share of that of the left ones."""
        self._sigma = sigma

    def __call__(self, observed_px: F64, weights: F64, camera: Camera) -> Terms:
        """Return the observations as they are, with the weights of right coordinates."""
        weighted = weights
        if self._sigma != 1.0:
            weighted = weights.copy()
            weighted[:, 2] /= self._sigma**2
        return Terms(observed_px, weighted, intrinsics_of(camera))


class MeasuredDepth:
    """Depth with the noise of its sensor, beside what a keypoint's own place leaves uncertain of it."""

    def __init__(self, noise: DepthNoise, least_sigma: float) -> None:
        """Take the sensor, and the least deviation of disparity, as a share of that of the left coordinates."""
        self._noise, self._least = noise, least_sigma

    def __call__(self, observed_px: F64, weights: F64, camera: Camera) -> Terms:
        """Return the observations with −bf/z, and its weight."""
        is_known = weights[:, 2] > 0.0
        disparity_px = np.where(is_known, observed_px[:, 0] - observed_px[:, 2], 1.0)
        depth_m = camera.bf / disparity_px
        sensor_px = self._noise.sigma_m(depth_m) * disparity_px / depth_m
        observed, weighted = observed_px.copy(), weights.copy()
        observed[:, 2] = -disparity_px
        variance = sensor_px**2 + self._least**2 / weights[:, 0]
        weighted[:, 2] = np.where(is_known, 1.0 / variance, 0.0)
        return Terms(observed, weighted, intrinsics_of(camera, share_of_u=0.0))


def depth_terms(model: str, right_sigma: float, camera: Camera) -> DepthTerms:
    """Return how depth counts with a camera.

    Args:
        model: right, as the right coordinate of a stereo pair; or sensor, with the noise of the camera's sensor, where
            that is known.
        right_sigma: The deviation of a right coordinate, or the least of a measured disparity, as a share of that of
            the left coordinate.
        camera: The calibration, which says what measures depth.
    """
    noise = SENSORS.get(camera.depth_noise)
    return RightCoordinate(right_sigma) if model == RIGHT or noise is None else MeasuredDepth(noise, right_sigma)
