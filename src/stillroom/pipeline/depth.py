"""The calibration of a depth camera against the colour camera: its scale, and the offset of its clock.

Images tell the offset: depth fits the map where the camera was when depth was taken. They do not tell the scale, for a
room twice as large, seen from twice as far, looks the same; only poses that are known in metres do.
"""

from dataclasses import dataclass, replace

import numpy as np

from stillroom.config import SlamConfig
from stillroom.data.image import RgbdImage
from stillroom.data.result import FrameResult, Tracked
from stillroom.data.semantics import Semantics
from stillroom.data.trajectory import Trajectory
from stillroom.datasets.recording import DatasetView
from stillroom.dense.no_dense_map import NoDenseMapConfig
from stillroom.errors import CalibrationError, TrajectoryError
from stillroom.evaluation.time_matching import interpolated
from stillroom.geometry import se3
from stillroom.geometry.align import align
from stillroom.geometry.arrays import I32
from stillroom.geometry.camera import Camera
from stillroom.optimize.depth_offset import (
    REACH_PX,
    ClockOffset,
    DepthSeen,
    agreed_offset,
    disparity_planes,
    of_frame,
)
from stillroom.optimize.depth_scale import DepthScale, PointsSeen, depth_scale
from stillroom.optimize.readout import velocities
from stillroom.optimize.trajectory_prior import TrajectoryPriorConfig
from stillroom.pipeline.options import RunOptions
from stillroom.pipeline.run import SILENT, RunProgress, run
from stillroom.protocols import Dataset
from stillroom.system import System
from stillroom.tracking.shutter import ROLLING

CLOSE_S = 0.0005
UNSETTLED_S = 3e-3
"""An offset that the last run has changed by more than this is none."""
MOST_RUNS = 4
LEAST_FRAMES = 30
LEAST_SPEED_PX_S = 30.0
"""Of images 640 pixels long."""
MOST_SIGMA_S = 0.005
MOST_SIGMA_SCALE = 0.01


@dataclass(frozen=True)
class DepthCalibration:
    """What a recording says of its depth.

    Attributes:
        camera: The calibration in force, with which it was read.
        offset: Of the clock, beside what is in force; None where the recording does not tell.
        scale: Of depth in force; None where nothing tells.
        untold: Why what is None is not known, in words.
    """

    camera: Camera
    offset: ClockOffset | None
    scale: DepthScale | None
    untold: tuple[str, ...] = ()

    @property
    def is_in_time(self) -> bool:
        """Whether the clock in force explains the recording: nothing to add within two standard deviations."""
        return self.offset is None or abs(self.offset.after_s) <= 2.0 * self.offset.sigma_s

    @property
    def is_to_scale(self) -> bool:
        """Whether the scale in force does, likewise."""
        return self.scale is None or abs(self.scale.scale - 1.0) <= 2.0 * self.scale.sigma

    def lines(self) -> list[str]:
        """Return the lines for a camera file, of what is known."""
        lines = []
        if self.scale is not None:
            scale = self.camera.depth_scale / (1.0 if self.is_to_scale else self.scale.scale)
            lines.append(f"depth_scale = {scale:.4f}  # ± {self.camera.depth_scale * self.scale.sigma:.4f}")
        if self.offset is not None:
            after_s = self.camera.depth_offset_s + (0.0 if self.is_in_time else self.offset.after_s)
            lines.append(f"depth_offset_s = {after_s:.4f}  # ± {self.offset.sigma_s:.4f}")
        return lines

    def sentences(self) -> list[str]:
        """Return what was found, in words."""
        said = []
        if self.scale is not None:
            percent, way = 100.0 * (self.scale.scale - 1.0), "far" if self.scale.scale > 1.0 else "near"
            said.append(
                f"depth reads {abs(percent):.2f} ± {100.0 * self.scale.sigma:.2f} % too {way} (one standard "
                f"deviation), from {self.scale.n_points} points triangulated from the ground truth's poses"
            )
            if self.is_to_scale:
                said.append("the scale in force explains this recording as well")
        if self.offset is not None:
            late = self.offset.after_s < 0.0
            said.append(
                f"depth is stamped {1e3 * abs(self.offset.after_s):.1f} ± {1e3 * self.offset.sigma_s:.1f} ms too "
                f"{'late' if late else 'early'}, from {self.offset.n_frames} frames in which images moved by "
                f"{self.offset.speed_px_s:.0f} px/s"
            )
            if self.is_in_time:
                said.append("the clock in force explains this recording as well")
        return [*said, *self.untold]


def calibrate_depth(dataset: Dataset, config: SlamConfig, progress: RunProgress = SILENT) -> DepthCalibration:
    """Estimate the scale of a sequence's depth from its ground truth, and without it the offset of the depth clock.

    The method is run with an offset, and what depth then says against the map corrects it, until it stays.

    Args:
        dataset: The sequence.
        config: What tracks the camera; what moves must be rejected by it.
        progress: Called for each frame.

    Raises:
        CalibrationError: Neither is told, or too few frames are tracked.
        KeyboardInterrupt: The user stopped it.
    """
    tracking = replace(config.tracking, between_keyframes="orb", shutter=ROLLING)
    config = replace(
        config, tracking=tracking, trajectory=TrajectoryPriorConfig(enabled=False), dense=NoDenseMapConfig()
    )
    before_s, used_s, runs = 0.0, 0.0, list[ClockOffset]()
    for _ in range(MOST_RUNS):
        said = _said_by_run(WithDepthClock(dataset, used_s), config, progress)
        found = said.offset(config.seed)
        runs.append(replace(found, after_s=used_s + found.after_s))
        before_s, used_s = used_s, runs[-1].after_s
        if abs(used_s - before_s) < CLOSE_S or _why_not_told(dataset, runs[-1]):
            break
    why_no_offset = _why_not_told(dataset, runs[-1])
    if not why_no_offset and abs(used_s - before_s) > max(UNSETTLED_S, 3.0 * runs[-1].sigma_s):
        why_no_offset = f"none stays the same from run to run: {1e3 * before_s:.1f} ms, then {1e3 * used_s:.1f}"
    scale, why_no_scale = _scale_of(dataset, said)
    untold = []
    if why_no_scale:
        untold.append(f"the scale of depth is not told ({why_no_scale})")
    if why_no_offset:
        untold.append(f"the offset of the depth clock is not told ({why_no_offset})")
    if len(untold) == 2:
        raise CalibrationError(
            f"{dataset.name}: {'; '.join(untold)}; move the camera to and fro, and turn it, in a room where little "
            "moves [see troubleshooting: depth-clock]"
        )
    return DepthCalibration(dataset.camera, None if why_no_offset else runs[-1], scale, tuple(untold))


class WithDepthClock(DatasetView):
    """A sequence whose depth was taken later than it is known to have been."""

    def __init__(self, inner: Dataset, after_s: float) -> None:
        """Show `inner` with an offset of the depth clock [s] beside the one in force."""
        super().__init__(inner)
        self._after_s = after_s

    @property
    def camera(self) -> Camera:
        """The calibration, with that offset."""
        camera = self._inner.camera
        return replace(camera, depth_offset_s=camera.depth_offset_s + self._after_s)

    def load(self, index: int) -> RgbdImage:
        """Return image `index`, with the time of its depth."""
        image = self._inner.load(index)
        assert isinstance(image, RgbdImage), f"depth of a {image.sensor.words} image has no clock"
        return replace(image, depth_after_s=image.depth_after_s + self._after_s)


class _Depths:
    """Observes what each frame saw of the map, and the depth around it."""

    def __init__(self, system: System) -> None:
        """Observe a run of a system."""
        self._system = system
        self._seen: list[tuple[DepthSeen, I32]] = []
        self.point_ids: list[I32] = []

    def on_frame(self, tracked: Tracked, semantics: Semantics, result: FrameResult) -> None:
        """Keep the keypoints that see a point."""
        frame, chosen = tracked.frame, np.flatnonzero(tracked.point_ids >= 0)
        # A keyframe has made points of its own depth, which agree with whatever clock is in use.
        if tracked.T_world_cam is None or result.is_keyframe:
            return
        kp, camera = frame.keypoints, frame.camera
        px = kp.px[chosen].astype(np.float64)
        reach = camera.in_pixels(REACH_PX)
        seen = DepthSeen(
            frame.timestamp_s,
            frame.image.depth_after_s,
            np.zeros((len(chosen), 3)),
            px,
            frame.scales.inverse_variances[kp.octave[chosen]],
            disparity_planes(px, frame.image.depth_m, camera.lens, camera.bf, reach),
        )
        self._seen.append((seen, tracked.point_ids[chosen]))

    def against_the_map(self) -> list[DepthSeen]:
        """Return what was seen, with the points as the map has them now."""
        world, result = self._system.map, []
        self.point_ids = []
        for seen, point_ids in self._seen:
            ids = world.current_ids(point_ids)
            known = ids >= 0
            self.point_ids.append(ids[known])
            points_m = world.points.position_m[ids[known]].astype(np.float64)
            parts = seen.px[known], seen.inverse_variances[known], seen.planes[known]
            result.append(DepthSeen(seen.time_s, seen.after_s, points_m, *parts))
        return result


@dataclass(frozen=True)
class _Said:
    """What a run saw.

    Attributes:
        dataset: What it ran on.
        trajectory: Its poses.
        seen: What each frame saw, with the points as the finished map has them.
        point_ids: Which points they are.
    """

    dataset: Dataset
    trajectory: Trajectory
    seen: list[DepthSeen]
    point_ids: list[I32]

    def offset(self, seed: int) -> ClockOffset:
        """Return what frames agree on, beside the offset in force.

        Raises:
            CalibrationError: Too few of them tell.
        """
        times_s, poses = self.trajectory.timestamps_s, self.trajectory.T_world_cam
        place = {float(time_s): i for i, time_s in enumerate(times_s)}
        T_cam_world, velocity, said = se3.inverse(poses), velocities(times_s, poses), []
        for seen in self.seen:
            i = place.get(seen.time_s, -1)
            if i < 0 or not np.isfinite(velocity[i]).all():
                continue
            frame = of_frame(seen, T_cam_world[i], velocity[i], self.dataset.camera)
            if frame is not None:
                said.append(frame)
        if len(said) < LEAST_FRAMES:
            raise CalibrationError(
                f"{self.dataset.name}: only {len(said)} frames tell of depth, {LEAST_FRAMES} are needed; give a longer "
                "recording, or see why tracking is lost"
            )
        return agreed_offset(said, seed)

    def scale(self, truth: Trajectory) -> DepthScale | None:
        """Return the scale of depth, by the true poses of the camera.

        Raises:
            TrajectoryError: They do not reach the images.
        """
        true = interpolated(truth, np.array([seen.time_s for seen in self.seen]))
        place = {float(time_s): i for i, time_s in enumerate(true.timestamps_s)}
        velocity = velocities(true.timestamps_s, true.T_world_cam)
        found = self.trajectory.positions_m[np.isin(self.trajectory.timestamps_s, true.timestamps_s)]
        rigid = align(found, true.positions_m, with_scale=False)
        chosen = [(seen, ids, place[seen.time_s]) for seen, ids in zip(self.seen, self.point_ids, strict=True)
                  if seen.time_s in place and np.isfinite(velocity[place[seen.time_s]]).all()]  # fmt: skip
        if not chosen:
            return None
        frames = np.array([i for _, _, i in chosen])
        ids, point = np.unique(np.concatenate([ids for _, ids, _ in chosen]), return_inverse=True)
        points_m = np.zeros((len(ids), 3))
        points_m[point] = rigid.points(np.concatenate([seen.points_world_m for seen, _, _ in chosen]))
        parts = PointsSeen(
            np.repeat(np.arange(len(chosen)), [len(one) for _, one, _ in chosen]),
            point.astype(np.int64),
            np.concatenate([seen.px for seen, _, _ in chosen]),
            np.concatenate([seen.inverse_variances for seen, _, _ in chosen]),
            np.concatenate([seen.planes for seen, _, _ in chosen]),
            se3.inverse(true.T_world_cam[frames]),
            velocity[frames],
            np.array([seen.after_s for seen, _, _ in chosen]),
        )
        return depth_scale(parts, points_m, self.dataset.camera)


def _said_by_run(dataset: WithDepthClock, config: SlamConfig, progress: RunProgress) -> _Said:
    observers: list[_Depths] = []

    def observe(system: System) -> _Depths:
        observers.append(_Depths(system))
        return observers[-1]

    outcome = run(dataset, config, RunOptions(root=None, pictures=0, observe=observe), progress)
    if outcome.interrupted:
        raise KeyboardInterrupt
    seen = observers[0].against_the_map()
    return _Said(dataset, outcome.system.trajectory(), seen, observers[0].point_ids)


def _why_not_told(dataset: Dataset, found: ClockOffset) -> str:
    """Return why the motion does not tell the offset; empty where it does."""
    least_px_s = LEAST_SPEED_PX_S * dataset.camera.pixel_scale
    if found.speed_px_s < least_px_s:
        return f"images move by {found.speed_px_s:.0f} px/s, {least_px_s:.0f} are needed"
    if found.sigma_s > MOST_SIGMA_S:
        return f"it would be {1e3 * found.after_s:.0f} ± {1e3 * found.sigma_s:.0f} ms"
    return ""


def _scale_of(dataset: Dataset, said: _Said) -> tuple[DepthScale | None, str]:
    """Return the scale of depth, and why there is none."""
    truth = dataset.groundtruth_at_camera or dataset.groundtruth
    if truth is None:
        return None, "images do not show it, and there is no ground truth, which does"
    try:
        found = said.scale(truth)
    except TrajectoryError as error:
        return None, str(error)
    if found is None:
        return None, "too few points are seen from places far enough from each other"
    if found.sigma > MOST_SIGMA_SCALE:
        return None, f"depth would read {found.scale:.3f} ± {found.sigma:.3f} of the truth"
    return found, ""
