"""The calibration of a rolling shutter: a run whose poses and map tell how long the rows of an image take."""

from dataclasses import dataclass, replace

import numpy as np

from stillroom.config import SlamConfig
from stillroom.data.result import FrameResult, Tracked
from stillroom.data.semantics import Semantics
from stillroom.datasets.recording import DatasetView
from stillroom.dense.no_dense_map import NoDenseMapConfig
from stillroom.errors import CalibrationError
from stillroom.geometry import se3
from stillroom.geometry.arrays import I32
from stillroom.geometry.camera import LONGEST_READOUT_S, Camera
from stillroom.optimize import observations
from stillroom.optimize.readout import Readout, RowsSeen, agreed, of_frame, velocities
from stillroom.optimize.trajectory_prior import TrajectoryPriorConfig
from stillroom.pipeline.options import RunOptions
from stillroom.pipeline.run import SILENT, RunProgress, run
from stillroom.protocols import Dataset
from stillroom.system import System
from stillroom.tracking.shutter import ROLLING, RollingShutterConfig

FIRST_GUESS_S = 0.02
LEAST_READOUT_S = 1e-4
"""A run with less would take all rows to be read at once, and bend the map where they are not."""
CLOSE_S = 0.0005
UNSETTLED_S = 3e-3
"""A readout that the last run has changed by more than this is none."""
MOST_RUNS = 3
LEAST_FRAMES = 30
LEAST_SPEED_PX_S = 30.0
"""Of images 640 pixels long: below it the rows of a usual readout shift by less than a pixel from first to last."""
MOST_SIGMA_S = 0.005
LOOSE = RollingShutterConfig(turn_rad_s=1.0, speed_m_s=0.2, check=False)
"""The rows speak for themselves: a velocity that fits a wrong readout is no true one."""


@dataclass(frozen=True)
class ShutterCalibration:
    """What a recording says of its camera's shutter.

    Attributes:
        found: The readout, with its uncertainty.
        runs: What each run said, in order; the last is `found`.
    """

    found: Readout
    runs: tuple[Readout, ...]

    @property
    def is_global(self) -> bool:
        """Whether a global shutter explains the recording: no readout within two standard deviations."""
        return self.found.readout_s <= 2.0 * self.found.sigma_s

    @property
    def line(self) -> str:
        """The line for a camera file."""
        readout_s = 0.0 if self.is_global else self.found.readout_s
        return f"readout_s = {readout_s:.4f}  # ± {self.found.sigma_s:.4f}"

    def sentences(self) -> list[str]:
        """Return what was found, in words."""
        found = self.found
        said = (
            f"rows are read in {1e3 * found.readout_s:.1f} ± {1e3 * found.sigma_s:.1f} ms (one standard deviation), "
            f"from {found.n_frames} frames in which images moved by {found.speed_px_s:.0f} px/s"
        )
        return [said, "a global shutter explains this recording as well"] if self.is_global else [said]


def calibrate_shutter(dataset: Dataset, config: SlamConfig, progress: RunProgress = SILENT) -> ShutterCalibration:
    """Estimate the readout of a sequence's camera, without ground truth.

    The method is run with a readout, keyframes and frames are moved to mid-frame with it, and what the map then says of
    the rows corrects it, until it stays.

    Args:
        dataset: The sequence.
        config: What tracks the camera; what moves must be rejected by it.
        progress: Called for each frame.

    Raises:
        CalibrationError: Too few frames are tracked, or the motion does not tell.
        KeyboardInterrupt: The user stopped it.
    """
    tracking = replace(config.tracking, between_keyframes="orb", shutter=ROLLING, rolling=LOOSE)
    config = replace(
        config, tracking=tracking, trajectory=TrajectoryPriorConfig(enabled=False), dense=NoDenseMapConfig()
    )
    before_s, used_s, runs = 0.0, FIRST_GUESS_S, list[Readout]()
    for _ in range(MOST_RUNS):
        runs.append(_said_by_run(WithReadout(dataset, used_s), config, progress))
        before_s, used_s = used_s, min(max(runs[-1].readout_s, LEAST_READOUT_S), LONGEST_READOUT_S)
        if abs(used_s - before_s) < CLOSE_S:
            break
    if abs(used_s - before_s) > max(UNSETTLED_S, 3.0 * runs[-1].sigma_s):
        raise CalibrationError(
            f"{dataset.name}: no readout stays the same from run to run ({1e3 * before_s:.1f} ms, then "
            f"{1e3 * used_s:.1f}); give a longer recording in which the camera turns back and forth "
            "[see troubleshooting: readout]"
        )
    _refuse_what_does_not_tell(dataset, runs[-1])
    return ShutterCalibration(runs[-1], tuple(runs))


class WithReadout(DatasetView):
    """A sequence whose camera has another readout."""

    def __init__(self, inner: Dataset, readout_s: float) -> None:
        """Show `inner` with a readout [s]."""
        super().__init__(inner)
        self._readout_s = readout_s

    @property
    def camera(self) -> Camera:
        """The calibration, with that readout."""
        return replace(self._inner.camera, readout_s=self._readout_s)

    @property
    def groundtruth(self) -> None:
        """None: nothing is evaluated."""
        return

    @property
    def groundtruth_at_camera(self) -> None:
        """None, likewise."""
        return


class _Rows:
    """Observes what each frame saw of the map, and where in the image."""

    def __init__(self, system: System) -> None:
        """Observe a run of a system."""
        self._system = system
        self._seen: list[tuple[RowsSeen, I32]] = []

    def on_frame(self, tracked: Tracked, semantics: Semantics, result: FrameResult) -> None:
        """Keep the keypoints that see a point."""
        frame, chosen = tracked.frame, np.flatnonzero(tracked.point_ids >= 0)
        # A keyframe has made points of its own depth, which agree with whatever readout is in use.
        if tracked.T_world_cam is None or result.is_keyframe:
            return
        kp, camera = frame.keypoints, frame.camera
        px = camera.undistort(kp.raw_px[chosen])
        right_px = camera.right_coordinate(px[:, 0], kp.depth_m[chosen])
        seen = RowsSeen(
            frame.timestamp_s,
            np.zeros((len(chosen), 3)),
            observations.observed_px(px, right_px),
            observations.weights(kp.octave[chosen], right_px, frame.scales.inverse_variances),
            camera.rows_after_s(kp.raw_px[chosen, 1]) / camera.readout_s,
        )
        self._seen.append((seen, tracked.point_ids[chosen]))

    def against_the_map(self) -> list[RowsSeen]:
        """Return what was seen, with the points as the map has them now."""
        world, result = self._system.map, []
        for seen, point_ids in self._seen:
            ids = world.current_ids(point_ids)
            known = ids >= 0
            parts = seen.observed_px[known], seen.weights[known], seen.share[known]
            result.append(RowsSeen(seen.time_s, world.points.position_m[ids[known]].astype(np.float64), *parts))
        return result


def _said_by_run(dataset: WithReadout, config: SlamConfig, progress: RunProgress) -> Readout:
    observers: list[_Rows] = []

    def observe(system: System) -> _Rows:
        observers.append(_Rows(system))
        return observers[-1]

    outcome = run(dataset, config, RunOptions(root=None, pictures=0, observe=observe), progress)
    if outcome.interrupted:
        raise KeyboardInterrupt
    trajectory = outcome.system.trajectory()
    place = {float(time_s): i for i, time_s in enumerate(trajectory.timestamps_s)}
    T_cam_world = se3.inverse(trajectory.T_world_cam)
    velocity = velocities(trajectory.timestamps_s, trajectory.T_world_cam)
    camera, said = dataset.camera, []
    for seen in observers[0].against_the_map():
        i = place.get(seen.time_s, -1)
        if i < 0 or not np.isfinite(velocity[i]).all():
            continue
        frame = of_frame(seen, T_cam_world[i], velocity[i], camera, camera.readout_s)
        if frame is not None:
            said.append(frame)
    if len(said) < LEAST_FRAMES:
        raise CalibrationError(
            f"{dataset.name}: only {len(said)} frames tell of the shutter, {LEAST_FRAMES} are needed; give a longer "
            "recording, or see why tracking is lost"
        )
    return agreed(said, config.seed)


def _refuse_what_does_not_tell(dataset: Dataset, found: Readout) -> None:
    least_px_s = LEAST_SPEED_PX_S * dataset.camera.pixel_scale
    why = ""
    if found.speed_px_s < least_px_s:
        why = f"images move by {found.speed_px_s:.0f} px/s, {least_px_s:.0f} are needed"
    elif found.sigma_s > MOST_SIGMA_S:
        why = f"it would be {1e3 * found.readout_s:.0f} ± {1e3 * found.sigma_s:.0f} ms"
    elif found.readout_s < -2.0 * found.sigma_s or found.readout_s > LONGEST_READOUT_S:
        why = f"it would be {1e3 * found.readout_s:.1f} ms, which no shutter has that reads from the top row down"
    if why:
        raise CalibrationError(
            f"{dataset.name}: the motion does not tell the readout ({why}); turn the camera back and forth, quickly, "
            "in a room where little moves [see troubleshooting: readout]"
        )
