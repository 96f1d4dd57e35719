"""The figures of a trajectory as it was known earlier: when an image was processed, or a few frames later."""

from dataclasses import dataclass

from stillroom.data.trajectory import Trajectory
from stillroom.errors import TrajectoryError
from stillroom.evaluation.smoothness import smoothness
from stillroom.evaluation.time_matching import TimeMatching
from stillroom.evaluation.trajectory_errors import ate


@dataclass(frozen=True)
class Earlier:
    """What poses were worth before later images improved them.

    Attributes:
        ate_m: ATE RMSE, by the alignment that the estimate asks for, ground truth as given [m].
        jitter_m: RMS of the second difference of the position error [m], against the ground truth of the camera where
            there is one; None where too few poses follow each other.
        n_compared: Poses compared.
    """

    ate_m: float
    jitter_m: float | None
    n_compared: int


def earlier(
    estimate: Trajectory, groundtruth: Trajectory, groundtruth_camera: Trajectory | None, matching: TimeMatching
) -> Earlier:
    """Compute those figures.

    Args:
        estimate: Poses of the camera, one for each frame that was tracked then.
        groundtruth: True poses as the data set gives them.
        groundtruth_camera: True poses of the camera itself, where those given are of another body.
        matching: How poses find each other in time.

    Raises:
        TrajectoryError: They cannot be compared.
    """
    absolute = ate(*matching.match(estimate, groundtruth), matching.max_gap_s)
    try:
        jitter_m = smoothness(estimate, groundtruth_camera or groundtruth).jitter_m.rmse
    except TrajectoryError:  # too few poses follow each other
        jitter_m = None
    return Earlier(absolute.judged_m.rmse, jitter_m, absolute.n_compared)
