"""All figures of one trajectory together."""

from collections.abc import Callable
from dataclasses import dataclass, replace

from stillroom.data.association import TUM_MAX_GAP_S
from stillroom.data.trajectory import Trajectory
from stillroom.errors import TrajectoryError
from stillroom.evaluation.ate import ate
from stillroom.evaluation.rpe import RelativeError, rpe, rpe_frames
from stillroom.evaluation.statistics import Statistics, improvement_percent

AS_GIVEN = "as given"
AT_CAMERA = "moved to the camera"


@dataclass(frozen=True)
class Comparison:
    """An estimate read against one ground truth.

    Attributes:
        groundtruth: Which ground truth, in words that follow "ground truth".
        n_compared: Poses compared.
        ate_se3_m, ate_sim3_m: Absolute errors after rigid alignment, and after one that may scale [m].
        scale: The scale that Sim(3) alignment found.
        still_camera_m: ATE RMSE, SE(3), of a camera that never moved, over the same poses [m].
        rpe_1s: Drift over 1 s [m/s, deg/s], TUM's rule; None for a trajectory too short for it.
        rpe_30_frames: Drift over 30 poses [m, deg], evo's rule; None for a trajectory too short for it.
    """

    groundtruth: str
    n_compared: int
    ate_se3_m: Statistics
    ate_sim3_m: Statistics
    scale: float
    still_camera_m: float
    rpe_1s: RelativeError | None
    rpe_30_frames: RelativeError | None


@dataclass(frozen=True)
class Improvement:
    """How far RMSEs lie below a baseline's, (1 − β/α)·100 [%]; None where there is nothing to compare."""

    baseline: str
    ate_percent: float | None
    rpe_translation_percent: float | None
    rpe_rotation_percent: float | None


@dataclass(frozen=True)
class Evaluation:
    """All figures of one trajectory.

    Attributes:
        n_tracked: Frames with a pose.
        n_given: Frames that the run was given; None where only a trajectory file is known.
        as_given: Figures against the ground truth as the data set gives it; this is the ATE that tables quote.
        at_camera: Figures against the ground truth moved to the camera, where the given one is of another body
            (Bonn: a marker). Relative errors there mean something only with this one
            (docs/reference.md#bonn-ground-truth).
        improvement: Against a baseline run, where one was named.
    """

    n_tracked: int
    n_given: int | None
    as_given: Comparison
    at_camera: Comparison | None = None
    improvement: Improvement | None = None

    @property
    def coverage(self) -> float | None:
        """Share of the given frames that have a pose, 0 to 1; None where the number given is not known."""
        return self.n_tracked / self.n_given if self.n_given else None

    @property
    def for_rpe(self) -> Comparison:
        """The comparison whose relative errors are to be read."""
        return self.at_camera or self.as_given

    def against(self, baseline: "Evaluation", name: str) -> "Evaluation":
        """Return the same figures with their improvement over a baseline's, which goes by a name."""
        ate_percent = improvement_percent(baseline.as_given.ate_se3_m.rmse, self.as_given.ate_se3_m.rmse)
        ours, theirs = self.for_rpe.rpe_1s, baseline.for_rpe.rpe_1s
        if ours is None or theirs is None:
            return replace(self, improvement=Improvement(name, ate_percent, None, None))
        improvement = Improvement(
            baseline=name,
            ate_percent=ate_percent,
            rpe_translation_percent=improvement_percent(theirs.translation_m.rmse, ours.translation_m.rmse),
            rpe_rotation_percent=improvement_percent(theirs.rotation_deg.rmse, ours.rotation_deg.rmse),
        )
        return replace(self, improvement=improvement)


def evaluate(
    estimate: Trajectory,
    groundtruth: Trajectory,
    *,
    groundtruth_camera: Trajectory | None = None,
    n_given: int | None = None,
    max_gap_s: float = TUM_MAX_GAP_S,
) -> Evaluation:
    """Measure a trajectory in every way that tables quote.

    Args:
        estimate: Poses of the camera, one for each tracked frame.
        groundtruth: True poses as the data set gives them.
        groundtruth_camera: True poses of the camera itself, where those given are of another body.
        n_given: Frames that the run was given.
        max_gap_s: Largest gap in time of a pair of poses [s].

    Raises:
        TrajectoryError: They cannot be compared.
    """
    return Evaluation(
        n_tracked=len(estimate),
        n_given=n_given,
        as_given=compare(estimate, groundtruth, AS_GIVEN, max_gap_s),
        at_camera=None if groundtruth_camera is None else compare(estimate, groundtruth_camera, AT_CAMERA, max_gap_s),
    )


def compare(estimate: Trajectory, groundtruth: Trajectory, name: str, max_gap_s: float = TUM_MAX_GAP_S) -> Comparison:
    """Read an estimate against one ground truth, which goes by a name.

    Raises:
        TrajectoryError: They cannot be compared.
    """
    absolute = ate(estimate, groundtruth, max_gap_s)
    return Comparison(
        groundtruth=name,
        n_compared=absolute.n_compared,
        ate_se3_m=absolute.se3_m,
        ate_sim3_m=absolute.sim3_m,
        scale=absolute.scale,
        still_camera_m=absolute.still_camera_m,
        rpe_1s=_or_none(lambda: rpe(estimate, groundtruth)),
        rpe_30_frames=_or_none(lambda: rpe_frames(estimate, groundtruth, 30, max_gap_s)),
    )


def _or_none(measure: Callable[[], RelativeError]) -> RelativeError | None:
    """Return what is measured, or None where the trajectory is too short: an ATE alone is still worth having."""
    try:
        return measure()
    except TrajectoryError:
        return None
