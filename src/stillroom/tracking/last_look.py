"""A last look: when a run ends, every frame is fitted once more to the finished map.

While a run goes on, a frame knows the map that was there: points that nothing but one depth image placed, keyframes
that were adjusted later. What each frame saw of the map is kept, in 20 bytes a match, and its pose is found again from
it when the map is finished, by the same `PoseFit` and from static points only. Under a rolling shutter the velocity
that is expected then comes from the frames before and after. Keyframes alone have placed the points; a second look is
at points that all frames have placed, whose noise is averaged over ten times as many images.
"""

import logging
import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from stillroom.bounds import bounded
from stillroom.data.frame import Frame, Keypoints, ScaleLevels
from stillroom.data.image import MonoImage, RgbdImage
from stillroom.data.map import Map
from stillroom.data.matches import Matches
from stillroom.data.result import FrameSummary, Tracked
from stillroom.geometry import se3
from stillroom.geometry.arrays import F32, F64, I32, U8, U16, Bool
from stillroom.geometry.camera import Camera
from stillroom.optimize.depth_terms import DepthTerms
from stillroom.optimize.points import PointSums, add_camera, placed
from stillroom.optimize.trajectory_prior import LONGEST_STEP_S, TrajectoryPriorConfig, smoothed
from stillroom.protocols import Parts
from stillroom.tracking.shutter import expected_velocities, terms_of
from stillroom.tracking.tracker import Tracker

log = logging.getLogger(__name__)
_NO_RGB, _NO_DEPTH = np.zeros((0, 0, 3), dtype=np.uint8), np.zeros((0, 0), dtype=np.float32)
LEAST_KEYFRAMES = 2
"""A point that one keyframe alone sees lies where that frame's depth put it, and tells nothing new."""


@dataclass(frozen=True)
class LastLookConfig:
    """Whether frames are fitted once more when a run ends.

    Attributes:
        enabled: Whether they are.
        looks: How often; before each look but the first, points are placed once more by all frames that see them.
        min_inliers: Points that must agree with the new pose; with fewer a frame keeps the one it has.
        most_frames: Newest frames of which is kept what they saw, about 9 kB each; earlier ones keep their poses.
    """

    enabled: bool = False
    looks: int = bounded(2, least=1)
    min_inliers: int = bounded(30, least=3)
    most_frames: int = bounded(10_000, least=1)

    def build(self, parts: Parts, tracker: Tracker, prior: TrajectoryPriorConfig) -> "LastLook | NoLastLook":
        """Return what keeps the frames' sights and looks again, or never does.

        Args:
            parts: Camera and map.
            tracker: Finds poses as they are found again, and has learnt how rows are read.
            prior: The prior of smooth motion, where it is in use.
        """
        if not self.enabled:
            return NoLastLook()
        return LastLook(self, parts, tracker, prior)


class Sights(NamedTuple):
    """What one frame saw of the map: M static keypoints that see a point.

    Attributes:
        px: Where, undistorted, as their rows were read (M, 2) [px].
        row: The row of the image as taken (M,).
        octave: Pyramid level (M,).
        depth_m: Depth (M,) [m]; 0 where unknown.
        point_ids: The points (M,), as they were called then.
        p_static: Probability that each is static (M,), in 255ths; None where the sieve gives none.
    """

    px: F32
    row: U16
    octave: U8
    depth_m: F32
    point_ids: I32
    p_static: U8 | None

    @classmethod
    def of(cls, tracked: Tracked) -> "Sights":
        """Return those of a frame."""
        frame, p_static = tracked.frame, tracked.motion.p_static
        kp, chosen = frame.keypoints, np.flatnonzero(tracked.is_matched & tracked.is_static)
        return cls(
            # `px` of a frame under a rolling shutter were moved to mid-frame, with a velocity that may be found better.
            px=frame.camera.undistort(kp.raw_px[chosen]),
            row=np.rint(kp.raw_px[chosen, 1]).astype(np.uint16),
            octave=kp.octave[chosen].astype(np.uint8),
            depth_m=kp.depth_m[chosen],
            point_ids=tracked.point_ids[chosen],
            p_static=None if p_static is None else np.rint(255.0 * p_static[chosen]).astype(np.uint8),
        )


class Seen(NamedTuple):
    """What one frame saw of the map as it is now: keypoints, and those matched with points that are still there."""

    sights: Sights
    matches: Matches


class LastLook:
    """Keeps what frames saw of a map, and fits their poses to it once more.

    Attributes:
        n_improved: Frames that have a new pose.
        n_forgotten: Frames whose sights were dropped, there being too many.
    """

    def __init__(self, config: LastLookConfig, parts: Parts, tracker: Tracker, prior: TrajectoryPriorConfig) -> None:
        """Start before the first frame; see `LastLookConfig.build`."""
        self.config, self.n_improved, self.n_forgotten = config, 0, 0
        self._timed = parts.clock.timed("last look", self._looked_again)
        self._camera: Camera = parts.camera
        self._world: Map = parts.world
        of_map = parts.world.scales
        # Of the images, which a map of another camera may be looked at with.
        self._scales = ScaleLevels.of(parts.camera, parts.sensor, of_map.factor, of_map.count)
        self._pose, self._depth, self._prior = tracker.pose, tracker.config.depth, prior
        self._limits = tracker.config.pose.chi2_2d, tracker.config.pose.chi2_3d
        self._sights: deque[Sights | None] = deque()

    def keep(self, tracked: Tracked) -> None:
        """Keep what the next frame saw."""
        self._add(None if tracked.T_world_cam is None else Sights.of(tracked))

    def repeat(self) -> None:
        """Keep that the next image repeats the one before."""
        self._add(self._sights[-1] if self._sights else None)

    def again(self, results: Sequence[FrameSummary]) -> list[FrameSummary]:
        """Return the results of all frames that were kept, with poses fitted to the map as it is now.

        Args:
            results: The frames in order, one for each that was kept.
        """
        return self._timed(results)

    def _looked_again(self, results: Sequence[FrameSummary]) -> list[FrameSummary]:
        looked, self.n_improved = list(results), 0
        if self.n_forgotten:
            log.warning(
                "the first %d of %d frames keep their poses: more than 'last_look.most_frames' are not kept for a last "
                "look at the map",
                self.n_forgotten,
                len(results),
            )
        posed = [(i, result.T_reference_cam) for i, result in enumerate(results)]
        known = [(i, T_reference_cam) for i, T_reference_cam in posed if T_reference_cam is not None]
        if not known:
            return looked
        frames = Frames(
            np.array([results[i].timestamp_s for i, _ in known]),
            np.array([self._world.placed_by(results[i].reference_keyframe, noted) for i, noted in known]),
            np.array([float(results[i].n_agreeing_finally) for i, _ in known]),
            self._as_known_now([i for i, _ in known]),
        )
        position_m, is_new = self._world.points.position_m.copy(), np.zeros(len(known), dtype=np.bool_)
        for number in range(self.config.looks):
            motion = frames.motion(self._prior)
            if number > 0:
                position_m = self._placed(frames, motion, position_m)
            is_new |= self._look(frames, motion, position_m)
        for k in np.flatnonzero(is_new):
            i = known[k][0]
            T_reference_cam = self._world.noted_in(results[i].reference_keyframe, frames.T_world_cam[k])
            looked[i] = replace(results[i], T_reference_cam=T_reference_cam, n_looked=int(frames.n_agreeing[k]))
        self.n_improved = int(np.count_nonzero(is_new))
        return looked

    def _add(self, sights: Sights | None) -> None:
        self._sights.append(sights)
        if len(self._sights) > self.config.most_frames:
            self._sights.popleft()
            self.n_forgotten += 1

    def _as_known_now(self, places: list[int]) -> list[Seen | None]:
        """Return what the frames at some places saw of points that are left and tell something, each once a frame."""
        kept = [self._sights[i - self.n_forgotten] if i >= self.n_forgotten else None for i in places]
        known: list[Seen | None] = []
        for k, sights in enumerate(kept):
            if sights is None or (k > 0 and sights is kept[k - 1]):  # one that repeats the one before stays the same
                known.append(None if sights is None else known[k - 1])
                continue
            ids = self._world.current_ids(sights.point_ids)
            ids[self._world.points.n_keyframes[ids] < LEAST_KEYFRAMES] = -1  # a −1 reads the last point, and stays −1
            known.append(Seen(sights, Matches.of(_each_once(ids))))
        return known

    def _look(self, frames: "Frames", motion: "Motion", position_m: F64) -> Bool:
        """Fit all frames to points (P, 3) [m]; return which of them (N,) have a new pose."""
        is_new = np.zeros(len(frames.seen), dtype=np.bool_)
        T_cam_world = se3.inverse(frames.T_world_cam)
        for k, seen in enumerate(frames.seen):
            if seen is None:
                continue
            if k > 0 and seen is frames.seen[k - 1]:  # an image that repeats the one before has its pose
                T_cam_world[k], is_new[k] = T_cam_world[k - 1], is_new[k - 1]
                continue
            if len(seen.matches) < self.config.min_inliers:
                continue
            view = self._view(seen, frames.times_s[k], motion.velocity[k])
            fitted = self._pose.fit(view.frame, T_cam_world[k], seen.matches, position_m, view.p_static, view.depth)
            n_inliers = np.count_nonzero(fitted.is_inlier)
            if n_inliers >= self.config.min_inliers:
                T_cam_world[k], frames.n_agreeing[k], is_new[k] = fitted.T_cam_world, n_inliers, True
        frames.T_world_cam[is_new] = se3.orthonormalize(se3.inverse(T_cam_world[is_new]))
        return is_new

    def _placed(self, frames: "Frames", motion: "Motion", position_m: F64) -> F64:
        """Return where all frames together see the points (P, 3) [m]; the map keeps its own."""
        sums = PointSums.nothing(len(position_m))
        for k, seen in enumerate(frames.seen):
            if seen is None or (k > 0 and seen is frames.seen[k - 1]):
                continue
            view, chosen = self._view(seen, frames.times_s[k], motion.velocity[k]), seen.matches.keypoint
            terms = terms_of(view.frame, seen.matches, view.depth)
            add_camera(
                sums,
                position_m,
                seen.matches.point_id,
                motion.T_cam_world[k],
                terms.observed_px,
                terms.weights,
                np.ones(len(chosen)) if view.p_static is None else view.p_static[chosen].astype(np.float64),
                self._limits,
                terms.intrinsics,
            )
        moved: F64 = placed(sums, position_m)
        return moved

    def _view(self, seen: Seen, time_s: float, velocity: F64) -> "_View":
        """Return what is kept of a frame as pose and points are fitted to it, moved to mid-frame by a velocity."""
        p_static = seen.sights.p_static
        return _View(
            self._pose.at_mid_frame(self._frame(seen.sights, time_s), velocity),
            None if p_static is None else p_static.astype(np.float32) / np.float32(255.0),
            self._depth.terms(math.sqrt(float(velocity[3:] @ velocity[3:])), self._camera),
        )

    def _frame(self, sights: Sights, time_s: float) -> Frame:
        """Return what is kept of a frame as a frame, without its image and descriptors."""
        n, camera = len(sights.px), self._camera
        raw_px = np.empty((n, 2), dtype=np.float32)
        raw_px[:, 0], raw_px[:, 1] = sights.px[:, 0], sights.row
        keypoints = Keypoints(
            px=sights.px,
            raw_px=raw_px,
            octave=sights.octave.astype(np.int32),
            angle_rad=np.zeros(n, dtype=np.float32),
            descriptors=np.zeros((n, 32), dtype=np.uint8),
            depth_m=sights.depth_m,
            right_px=camera.right_coordinate(sights.px[:, 0], sights.depth_m),
        )
        is_metric = self._world.sensor.is_metric
        image = RgbdImage(time_s, _NO_RGB, _NO_DEPTH) if is_metric else MonoImage(time_s, _NO_RGB)
        return Frame(image, camera, self._scales, keypoints, np.ones(n, dtype=np.bool_))


class NoLastLook:
    """The null object: keeps nothing, and leaves poses as they are."""

    n_improved, n_forgotten = 0, 0

    def keep(self, tracked: Tracked) -> None:
        """Do nothing."""

    def repeat(self) -> None:
        """Do nothing."""

    def again(self, results: Sequence[FrameSummary]) -> list[FrameSummary]:
        """Return the results as they are."""
        return list(results)


class Motion(NamedTuple):
    """How the camera moves: its poses (N, 4, 4), T_cam_world, and its velocities (N, 6) [m/s, rad/s]."""

    T_cam_world: F64
    velocity: F64


@dataclass
class Frames:
    """The N frames that have a pose.

    Attributes:
        times_s: Their times (N,) [s].
        T_world_cam: Their poses (N, 4, 4), as known by now.
        n_agreeing: Points that each pose was found from (N,) float64.
        seen: What each saw; None where it was not kept.
    """

    times_s: F64
    T_world_cam: F64
    n_agreeing: F64
    seen: list[Seen | None]

    def motion(self, prior: TrajectoryPriorConfig) -> Motion:
        """Return how the camera moves, under the prior where it is in use; 0 next to no frame."""
        times_s, T = self.times_s, self.T_world_cam
        if prior.enabled:
            T = smoothed(times_s, T, self.n_agreeing, prior)
        T_cam_world = se3.inverse(T)
        is_near = np.concatenate(([False], np.diff(times_s) <= LONGEST_STEP_S, [False]))
        first, last = np.arange(len(T)) - is_near[:-1], np.arange(len(T)) + is_near[1:]
        return Motion(T_cam_world, expected_velocities(T_cam_world[last], T[first], times_s[last] - times_s[first]))


class _View(NamedTuple):
    """What the fits of poses and points take of a frame."""

    frame: Frame
    p_static: F32 | None
    depth: DepthTerms


def _each_once(point_ids: I32) -> I32:
    """Return the points that keypoints see (N,), −1 for none, each once: some were fused since."""
    once = np.full_like(point_ids, -1)
    _, first = np.unique(point_ids, return_index=True)
    once[first] = point_ids[first]
    return once
