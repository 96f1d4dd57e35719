"""How a frame's pose is found from its matches: from all rows at once, or row by row under a rolling shutter."""

from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np

from stillroom.bounds import bounded
from stillroom.data.frame import Frame
from stillroom.data.matches import Matches
from stillroom.geometry import se3, twists
from stillroom.geometry.arrays import F32, F64, Bool
from stillroom.optimize import observations
from stillroom.optimize.observations import intrinsics_of
from stillroom.optimize.pose import PoseOptimizerConfig
from stillroom.optimize.rolling_pose import RollingPoseOptimizer, at_mid_frame

GLOBAL, ROLLING = "global", "rolling"
FASTEST_TURN_RAD_S = 6.0
"""A motion model that expects the camera to turn faster has lost it."""


class Before(NamedTuple):
    """The frame before, as known now: its pose `T_world_cam` (4, 4), and how long ago it was [s]."""

    T_world_cam: F64
    ago_s: float


class Fitted(NamedTuple):
    """A pose that was found.

    Attributes:
        T_cam_world: The pose (4, 4).
        is_inlier: Which matches (M,) agree with it.
        velocity: By how much the velocity differs from the one that the frame was moved with (6,) [m/s, rad/s]; None
            where none is found.
    """

    T_cam_world: F64
    is_inlier: Bool
    velocity: F64 | None


class PoseFit(Protocol):
    """Finds the pose of a frame from its matches with the map.

    A frame is moved to mid-frame with the velocity that is expected, before it is matched; each pose that is found
    corrects it. Sieves so see keypoints where the map's points are.
    """

    def expected(self, guess: F64, before: Before | None) -> F64 | None:
        """Return the velocity (6,) [m/s, rad/s] expected at a guess (4, 4) of the pose; None where none matters."""

    def fit(
        self, frame: Frame, guess: F64, matches: Matches, position_m: F64, p_static: F32 | None, right_sigma: float
    ) -> Fitted:
        """Return the pose near a guess (4, 4).

        Args:
            frame: The frame.
            guess: The guess.
            matches: Its pairs with map points.
            position_m: Where the points of the map are (P, 3) [m, world], by their ids.
            p_static: Weights of its keypoints (N,); None for 1.
            right_sigma: Standard deviation of right coordinates, as a share of that of the left ones.
        """

    def at_mid_frame(self, frame: Frame, velocity: F64 | None) -> Frame:
        """Return a frame with its keypoints moved by a velocity (6,) to where all rows would be read at its middle."""


class GlobalShutter:
    """All rows are taken to be read at once, as in ORB-SLAM2."""

    def __init__(self, config: PoseOptimizerConfig) -> None:
        """Store the optimiser."""
        self._optimize = config.build()

    def expected(self, guess: F64, before: Before | None) -> None:
        """Return that none matters."""
        return

    def fit(
        self, frame: Frame, guess: F64, matches: Matches, position_m: F64, p_static: F32 | None, right_sigma: float
    ) -> Fitted:
        """Return the pose."""
        kp = frame.keypoints
        right_px = kp.right_px[matches.keypoint]
        estimate = self._optimize(
            guess,
            position_m[matches.point_id],
            observations.observed_px(kp.px[matches.keypoint], right_px),
            weights_of(frame, matches, right_sigma),
            frame.camera,
            None if p_static is None else p_static[matches.keypoint],
        )
        return Fitted(estimate.T_cam_world, estimate.is_inlier, None)

    def at_mid_frame(self, frame: Frame, velocity: F64 | None) -> Frame:
        """Return the frame as it is."""
        return frame


@dataclass(frozen=True)
class DepthNoiseConfig:
    """How much a keypoint's depth counts beside its place in the image.

    Attributes:
        right_sigma: Standard deviation of the right coordinate that stands for a depth, as a share of that of the left
            one. ORB-SLAM2 has 1; structured light measures disparity better than that.
        max_turn_rad_s: While the camera turns faster, it is 1: depth lags behind colour.
    """

    right_sigma: float = bounded(1.0, above=0)
    max_turn_rad_s: float = bounded(0.5, above=0)

    def right_sigma_at(self, turn_rad_s: float) -> float:
        """Return that deviation while the camera turns at a speed [rad/s]."""
        return self.right_sigma if turn_rad_s <= self.max_turn_rad_s else 1.0


@dataclass(frozen=True)
class RollingShutterConfig:
    """What is expected of the camera's velocity while a frame is read; see `tracking.shutter`.

    Attributes:
        turn_rad_s: How far the turn of a frame may differ from that since the last one: one standard deviation. A
            hand's tremor changes it from frame to frame.
        speed_m_s: The same of the speed. It shows in the rows as a turn does, and is known better from the poses.
    """

    turn_rad_s: float = bounded(0.1, above=0)
    speed_m_s: float = bounded(0.02, above=0)


class RollingShutter:
    """Rows are read one after the other: pose and velocity of a frame are found together."""

    def __init__(self, config: RollingShutterConfig, pose: PoseOptimizerConfig) -> None:
        """Store what is expected."""
        deviations = np.repeat((config.speed_m_s, config.turn_rad_s), 3)
        self._optimize = RollingPoseOptimizer(pose, deviations**-2.0)

    def expected(self, guess: F64, before: Before | None) -> F64:
        """Return the velocity that leads from the frame before to the guess."""
        return expected_velocity(guess, before)

    def fit(
        self, frame: Frame, guess: F64, matches: Matches, position_m: F64, p_static: F32 | None, right_sigma: float
    ) -> Fitted:
        """Return the pose, and how far the velocity differs from the one that was expected."""
        kp = frame.keypoints
        right_px = kp.right_px[matches.keypoint]
        estimate = self._optimize(
            guess,
            np.zeros(6),
            position_m[matches.point_id],
            observations.observed_px(kp.px[matches.keypoint], right_px),
            weights_of(frame, matches, right_sigma),
            frame.camera.rows_after_s(kp.raw_px[matches.keypoint, 1]),
            frame.camera,
            None if p_static is None else p_static[matches.keypoint],
        )
        return Fitted(estimate.T_cam_world, estimate.is_inlier, estimate.velocity)

    def at_mid_frame(self, frame: Frame, velocity: F64 | None) -> Frame:
        """Return the frame with its keypoints moved; `raw_px` stays where they are in the image."""
        if velocity is None or not velocity.any():
            return frame
        kp, camera = frame.keypoints, frame.camera
        known = kp.depth_m[kp.depth_m > 0]
        typical_m = float(np.median(known)) if len(known) else 2.0
        after_s = camera.rows_after_s(kp.raw_px[:, 1])
        px = at_mid_frame(kp.px, kp.depth_m, typical_m, after_s, velocity, intrinsics_of(camera)).astype(np.float32)
        moved = replace(kp, px=px, right_px=camera.right_coordinate(px[:, 0], kp.depth_m))
        return replace(frame, keypoints=moved)


def weights_of(frame: Frame, matches: Matches, right_sigma: float) -> F64:
    """Return the inverse variances (M, 3) [1/px²] of matched keypoints."""
    kp = frame.keypoints
    octave, right_px = kp.octave[matches.keypoint], kp.right_px[matches.keypoint]
    weights: F64 = observations.weights(octave, right_px, frame.scales.inverse_variances)
    weights[:, 2] /= right_sigma**2
    return weights


def turn_rad_s(guess: F64, before: Before | None) -> float:
    """Return how fast the camera turns from the frame before to a guess (4, 4) [rad/s]; 0 where there is none."""
    if before is None or not before.ago_s > 0.0:
        return 0.0
    return float(se3.angle_rad(guess @ before.T_world_cam)) / before.ago_s


def expected_velocity(guess: F64, before: Before | None) -> F64:
    """Return the velocity (6,) [m/s, rad/s] from the frame before to a guess (4, 4); 0 where there is none."""
    if before is None:
        return np.zeros(6)
    velocity: F64 = expected_velocities(guess[None], before.T_world_cam[None], np.array([before.ago_s]))[0]
    return velocity


def expected_velocities(T_cam_world: F64, T_world_before: F64, ago_s: F64) -> F64:
    """Return the velocities (N, 6) [m/s, rad/s] from earlier poses to later ones (N, 4, 4); 0 where no time passed."""
    passed = np.where(ago_s > 0.0, ago_s, np.inf)
    velocity: F64 = twists.log(T_cam_world @ T_world_before) / passed[:, None]
    velocity[np.linalg.norm(velocity[:, 3:], axis=1) > FASTEST_TURN_RAD_S] = 0.0
    return velocity
