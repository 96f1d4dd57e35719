"""How a frame's pose is found from its matches: from all rows at once, or row by row under a rolling shutter."""

from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np

from stillroom.bounds import bounded
from stillroom.data.frame import Frame
from stillroom.data.map import Map
from stillroom.data.matches import Matches
from stillroom.data.result import Tracked
from stillroom.geometry import se3, twists
from stillroom.geometry.arrays import F32, F64, Bool
from stillroom.geometry.camera import Camera
from stillroom.optimize import observations
from stillroom.optimize.depth_terms import MODELS, RIGHT, DepthTerms, RightCoordinate, Terms, depth_terms
from stillroom.optimize.observations import intrinsics_of
from stillroom.optimize.pose import PoseOptimizerConfig
from stillroom.optimize.rolling_pose import RollingPoseOptimizer, SeenInRows, keypoints_at_mid_frame, linearize_rows
from stillroom.tracking.readout_check import ReadoutCheck, Rows, RowsFound
from stillroom.tracking.undecided import Undecided, as_taken

GLOBAL, ROLLING = "global", "rolling"
TYPICAL_DEPTH = {True: 2.0, False: 1.0}
"""Depth of a keypoint that has none, in a frame without any, by whether lengths are metric [m]; else the unit of length
is the median depth when the map began."""
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
        self, frame: Frame, guess: F64, matches: Matches, position_m: F64, p_static: F32 | None, depth: DepthTerms
    ) -> Fitted:
        """Return the pose near a guess (4, 4).

        Args:
            frame: The frame.
            guess: The guess.
            matches: Its pairs with map points.
            position_m: Where the points of the map are (P, 3) [m, world], by their ids.
            p_static: Weights of its keypoints (N,); None for 1.
            depth: How much depth counts.
        """

    def at_mid_frame(self, frame: Frame, velocity: F64 | None) -> Frame:
        """Return a frame with its keypoints moved by a velocity (6,) to where all rows would be read at its middle."""

    def learn(self, tracked: Tracked, world: Map) -> Tracked:
        """Take notice of a frame that was found, before mapping sees it; return it, as it is found now."""

    def remember(self, tracked: Tracked, world: Map) -> None:
        """Take notice of a frame after mapping."""

    @property
    def found(self) -> RowsFound | None:
        """What the recording says of the camera's readout; None where nothing is asked, or known yet."""

    def put_back(self) -> list[int]:
        """Return keyframes whose keypoints were put back to where they were seen since the last call."""

    def found_again(self, world: Map) -> dict[int, F64]:
        """Find earlier images again where there is reason to; return their `T_world_cam` (4, 4) by image index."""


class GlobalShutter:
    """All rows are taken to be read at once, as in ORB-SLAM2."""

    def __init__(self, config: PoseOptimizerConfig) -> None:
        """Store the optimiser."""
        self._optimize = config.build()

    def expected(self, guess: F64, before: Before | None) -> None:
        """Return that none matters."""
        return

    def fit(
        self, frame: Frame, guess: F64, matches: Matches, position_m: F64, p_static: F32 | None, depth: DepthTerms
    ) -> Fitted:
        """Return the pose."""
        terms = terms_of(frame, matches, depth)
        estimate = self._optimize(
            guess,
            position_m[matches.point_id],
            terms.observed_px,
            terms.weights,
            frame.camera,
            None if p_static is None else p_static[matches.keypoint],
            terms.intrinsics[5],
        )
        return Fitted(estimate.T_cam_world, estimate.is_inlier, None)

    def at_mid_frame(self, frame: Frame, velocity: F64 | None) -> Frame:
        """Return the frame as it is."""
        return frame

    def learn(self, tracked: Tracked, world: Map) -> Tracked:
        """Return the frame."""
        return tracked

    def remember(self, tracked: Tracked, world: Map) -> None:
        """Do nothing."""

    @property
    def found(self) -> None:
        """None."""
        return

    def put_back(self) -> list[int]:
        """Return none."""
        return []

    def found_again(self, world: Map) -> dict[int, F64]:
        """Return none."""
        return {}


@dataclass(frozen=True)
class DepthNoiseConfig:
    """How much a keypoint's depth counts beside its place in the image.

    Attributes:
        right_sigma: Standard deviation of the right coordinate that stands for a depth, as a share of that of the left
            one. ORB-SLAM2 has 1; structured light measures disparity better than that.
        model: right, depth counts by that alone; or sensor, by the noise of the camera's sensor where that is known,
            with `right_sigma` as the least (`optimize.depth_terms`).
        max_turn_rad_s: While the camera turns faster, or nobody knows how fast, depth counts as in ORB-SLAM2: it lags
            behind colour.
        in_time: Whether keypoints get the depth of their own image's time where depth was taken at another, by the
            stamps of both (`tracking.depth_clock`). Where the camera has a `depth_offset_s`, they do in any case.
    """

    right_sigma: float = bounded(1.0, above=0)
    model: str = bounded(RIGHT, one_of=MODELS)
    max_turn_rad_s: float = bounded(0.5, above=0)
    in_time: bool = False

    def after_s(self, frame: Frame) -> float:
        """Return how long after a frame its depth was taken [s], where that is to be corrected; else 0."""
        return frame.image.depth_after_s if self.in_time or frame.camera.depth_offset_s != 0.0 else 0.0

    @property
    def heeds_turn(self) -> bool:
        """Whether it matters how fast the camera turns: depth may count otherwise than in ORB-SLAM2."""
        return self.model != RIGHT or self.right_sigma != 1.0

    def terms(self, turn_rad_s: float, camera: Camera) -> DepthTerms:
        """Return how much depth counts while a camera turns [rad/s]."""
        if turn_rad_s > self.max_turn_rad_s:
            return RightCoordinate()
        return depth_terms(self.model, self.right_sigma, camera)


@dataclass(frozen=True)
class RollingShutterConfig:
    """What is expected of the camera's velocity while a frame is read; see `tracking.shutter`.

    Attributes:
        turn_rad_s: How far the turn of a frame may differ from that since the last one: one standard deviation. A
            hand's tremor changes it from frame to frame.
        speed_m_s: The same of the speed. It shows in the rows as a turn does, and is known better from the poses.
        check: Whether rows are read as one, with a warning, where the recording says that its camera's shutter is a
            global one after all; see `tracking.readout_check`.
    """

    turn_rad_s: float = bounded(0.1, above=0)
    speed_m_s: float = bounded(0.02, above=0)
    check: bool = True


class RollingShutter:
    """Rows are read one after the other: pose and velocity of a frame are found together.

    Unless the recording says that they are read at once, from when on all rows are.
    """

    def __init__(self, config: RollingShutterConfig, pose: PoseOptimizerConfig, readout_s: float) -> None:
        """Store what is expected, and the readout of the camera [s]."""
        deviations = np.repeat((config.speed_m_s, config.turn_rad_s), 3)
        self._optimize = RollingPoseOptimizer(pose, deviations**-2.0)
        self._as_one, self._optimize_as_one = GlobalShutter(pose), pose.build()
        self._check = ReadoutCheck(readout_s) if config.check else None
        self._limits = pose.chi2_2d, pose.chi2_3d
        self._undecided, self._put_back = Undecided(), list[int]()
        self._decided: Camera | None = None  # since the last frame, for this camera
        self._depth: DepthTerms = RightCoordinate()  # of the last pose
        self._n_keyframes = 0  # when the last frame was found

    @property
    def found(self) -> RowsFound | None:
        """What the recording says of the camera's readout; None where nothing is asked, or known yet."""
        return None if self._check is None else self._check.found

    @property
    def _is_global(self) -> bool:
        return self._check is not None and self._check.as_one

    def expected(self, guess: F64, before: Before | None) -> F64 | None:
        """Return the velocity that leads from the frame before to the guess; None where rows are read as one."""
        return None if self._is_global else expected_velocity(guess, before)

    def fit(
        self, frame: Frame, guess: F64, matches: Matches, position_m: F64, p_static: F32 | None, depth: DepthTerms
    ) -> Fitted:
        """Return the pose, and how far the velocity differs from the one that was expected."""
        self._depth = depth
        if self._is_global:
            return self._as_one.fit(frame, guess, matches, position_m, p_static, depth)
        terms = terms_of(frame, matches, depth)
        estimate = self._optimize(
            guess,
            np.zeros(6),
            position_m[matches.point_id],
            terms.observed_px,
            terms.weights,
            frame.camera.rows_after_s(frame.keypoints.raw_px[matches.keypoint, 1]),
            frame.camera,
            None if p_static is None else p_static[matches.keypoint],
            terms.intrinsics[5],
        )
        return Fitted(estimate.T_cam_world, estimate.is_inlier, estimate.velocity)

    def at_mid_frame(self, frame: Frame, velocity: F64 | None) -> Frame:
        """Return the frame with its keypoints moved; `raw_px` stays where they are in the image."""
        if velocity is None or self._is_global or not velocity.any():
            return frame
        kp, camera = frame.keypoints, frame.camera
        typical_m = TYPICAL_DEPTH[frame.image.sensor.is_metric]
        timing, intrinsics = (float(camera.height), camera.readout_s), intrinsics_of(camera)
        px, right_px = keypoints_at_mid_frame(
            kp.px, kp.depth_m, kp.raw_px[:, 1], typical_m, timing, velocity, intrinsics
        )
        moved = replace(kp, px=px, right_px=right_px)
        so_far = velocity if frame.velocity is None else frame.velocity + velocity
        return replace(frame, keypoints=moved, velocity=so_far)

    def learn(self, tracked: Tracked, world: Map) -> Tracked:
        """Ask the rows of a frame when they were read; where they say at once, find the frames until now again."""
        check, frame = self._check, tracked.frame
        self._n_keyframes = len(world.keyframes)
        if check is None or tracked.T_world_cam is None:
            return tracked
        was_as_one, matches = check.as_one, Matches.of(tracked.point_ids)
        check.add(_rows_of(tracked, matches, world, self._limits, check.asks_next))
        if was_as_one:
            return tracked
        if check.is_settled:
            self._undecided.clear()
            return tracked
        taken = replace(frame, keypoints=as_taken(frame.keypoints, frame.camera), velocity=None)
        self._undecided.add(tracked, matches, terms_of(taken, matches, self._depth))
        if not check.as_one:
            return tracked
        self._decided = frame.camera
        self._put_back = self._undecided.put_back(self._optimize_as_one, frame.camera, world)
        guess = se3.inverse(tracked.T_world_cam)
        fitted = self._as_one.fit(taken, guess, matches, world.points.position_m, tracked.motion.p_static, self._depth)
        return replace(tracked, frame=taken, T_world_cam=se3.orthonormalize(se3.inverse(fitted.T_cam_world)))

    def remember(self, tracked: Tracked, world: Map) -> None:
        """Take notice of a keyframe whose keypoints were moved, as long as that may have been wrong."""
        keyframe = tracked.reference_keyframe
        if keyframe >= self._n_keyframes:  # added since; earlier runs have keyframes of the same stamp
            self._undecided.became_keyframe(keyframe, tracked)

    def put_back(self) -> list[int]:
        """Return keyframes whose keypoints were put back to where they were seen since the last call."""
        keyframes, self._put_back = self._put_back, []
        return keyframes

    def found_again(self, world: Map) -> dict[int, F64]:
        """Find earlier images again after the verdict; return their `T_world_cam` (4, 4) by image index."""
        camera, self._decided = self._decided, None
        return {} if camera is None else self._undecided.found_again(self._optimize_as_one, camera, world)


def _rows_of(tracked: Tracked, matches: Matches, world: Map, limits: tuple[float, float], with_equations: bool) -> Rows:
    """Return a frame's pose, and where they are asked for the equations of it and of the twist of its rows, there."""
    assert tracked.T_world_cam is not None
    frame = tracked.frame
    moved_with = np.zeros(6) if frame.velocity is None else frame.camera.readout_s * frame.velocity
    submap = int(world.keyframes.submap[tracked.reference_keyframe])
    H, b = _equations_of(tracked, matches, world, limits) if with_equations else (np.zeros((0, 0)), np.zeros(0))
    return Rows(frame.timestamp_s, tracked.T_world_cam, len(world.jumps), submap, H, b, moved_with)


def _equations_of(tracked: Tracked, matches: Matches, world: Map, limits: tuple[float, float]) -> tuple[F64, F64]:
    """Return the normal equations (12, 12), (12,) of a frame's pose and of the twist of its rows, at its pose."""
    assert tracked.T_world_cam is not None
    frame = tracked.frame
    kp, camera, n = frame.keypoints, frame.camera, len(matches)
    H, b = np.empty((12, 12)), np.empty(12)
    terms = terms_of(frame, matches, RightCoordinate())
    seen = SeenInRows(
        world.points.position_m[matches.point_id],
        terms.observed_px,
        terms.weights,
        np.ones(n),
        (kp.raw_px[matches.keypoint, 1].astype(np.float64) + 0.5) / camera.height - 0.5,
        terms.intrinsics,
        np.zeros(6),
        np.zeros(6),
    )
    linearize_rows(se3.inverse(tracked.T_world_cam), np.zeros(6), seen, np.ones(n, dtype=np.bool_), limits, H, b)
    return H, b


def terms_of(frame: Frame, matches: Matches, depth: DepthTerms) -> Terms:
    """Return the terms of matched keypoints (M)."""
    kp = frame.keypoints
    observed_px, weights = observations.of_keypoints(
        matches.keypoint, kp.px, kp.octave, kp.right_px, frame.scales.inverse_variances
    )
    return depth(observed_px, weights, frame.camera)


def turn_rad_s(guess: F64, before: Before | None) -> float:
    """Return how fast the camera turns from the frame before to a guess (4, 4) [rad/s]; infinite where unknown."""
    if before is None or not before.ago_s > 0.0:
        return float("inf")
    return float(np.linalg.norm(twists.of_motion(guess @ before.T_world_cam)[3:])) / before.ago_s


def expected_velocity(guess: F64, before: Before | None) -> F64:
    """Return the velocity (6,) [m/s, rad/s] from the frame before to a guess (4, 4); 0 where there is none."""
    if before is None or not before.ago_s > 0.0:
        return np.zeros(6)
    velocity: F64 = twists.of_motion(guess @ before.T_world_cam) / before.ago_s
    return velocity if np.linalg.norm(velocity[3:]) <= FASTEST_TURN_RAD_S else np.zeros(6)


def expected_velocities(T_cam_world: F64, T_world_before: F64, ago_s: F64) -> F64:
    """Return the velocities (N, 6) [m/s, rad/s] from earlier poses to later ones (N, 4, 4); 0 where no time passed."""
    passed = np.where(ago_s > 0.0, ago_s, np.inf)
    velocity: F64 = twists.log(T_cam_world @ T_world_before) / passed[:, None]
    velocity[np.linalg.norm(velocity[:, 3:], axis=1) > FASTEST_TURN_RAD_S] = 0.0
    return velocity
