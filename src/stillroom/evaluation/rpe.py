"""The relative pose error (Sturm et al., IROS 2012): drift over a fixed interval.

Two conventions are in use and differ in more than the interval. TUM's evaluate_rpe.py, which the papers' m/s and
deg/s come from, takes motions from the later pose to the earlier, looks up the ground truth for each pose by
itself, and drops the pairs that end on the last pose. evo pairs the poses first and takes motions forward
(docs/reference.md#tum-rgb-d-evaluation).
"""

from dataclasses import dataclass

import numpy as np

from stillroom.data.association import TUM_MAX_GAP_S
from stillroom.data.trajectory import Trajectory
from stillroom.errors import TrajectoryError
from stillroom.evaluation.pairing import check_comparable, pair
from stillroom.evaluation.statistics import Statistics
from stillroom.geometry import se3
from stillroom.geometry.arrays import F64, I64


@dataclass(frozen=True)
class RelativeError:
    """How far the motion over an interval lies from the true motion.

    Attributes:
        translation_m: Translation errors over the interval [m]; for an interval of 1 s this is m/s.
        rotation_deg: Rotation errors over the interval [deg]; for an interval of 1 s this is deg/s.
        n_pairs: Number of pairs of poses.
    """

    translation_m: Statistics
    rotation_deg: Statistics
    n_pairs: int


def rpe(estimate: Trajectory, groundtruth: Trajectory, delta_s: float = 1.0) -> RelativeError:
    """Measure drift over a time by the rule of `evaluate_rpe.py --fixed_delta --delta DELTA --delta_unit s`.

    As there, a pose is paired with the one whose time is closest to its own plus the interval, however far off
    that lies in a gap of the estimate (it may be the pose itself); pairs that end on the last pose are left out;
    a pose counts only when the ground truth has one within twice its median step. There, more than 10,000 pairs
    are sampled at random; here all count.

    Raises:
        TrajectoryError: The two cannot be compared (see `check_comparable`), or fewer than two pairs are found.
    """
    check_comparable(estimate, groundtruth)
    times_s, true_times_s = estimate.timestamps_s, groundtruth.timestamps_s
    end = _closest(times_s, times_s + delta_s)
    start = np.flatnonzero(end != len(times_s) - 1)
    end = end[start]
    true_index = _closest(true_times_s, times_s)
    has_truth = np.abs(true_times_s[true_index] - times_s) <= 2 * _median_step_s(true_times_s)
    covered = has_truth[start] & has_truth[end]
    start, end = start[covered], end[covered]
    # Motions backward in time, from end to start: that is TUM's way round.
    return _measure(estimate.T_world_cam, groundtruth.T_world_cam[true_index], end, start, f"{delta_s:g} s")


def rpe_frames(
    estimate: Trajectory, groundtruth: Trajectory, n_frames: int = 30, max_gap_s: float = TUM_MAX_GAP_S
) -> RelativeError:
    """Measure drift over a number of poses, for all pairs i, i + n, as `evo_rpe -d N -u f --all_pairs` does.

    Raises:
        TrajectoryError: The two cannot be compared (see `pair`), or fewer than two pairs are found.
    """
    estimate, groundtruth = pair(estimate, groundtruth, max_gap_s)
    start = np.arange(max(0, len(estimate) - n_frames))
    return _measure(estimate.T_world_cam, groundtruth.T_world_cam, start, start + n_frames, f"{n_frames} frames")


def _measure(T_estimate: F64, T_truth: F64, first: I64, second: I64, interval: str) -> RelativeError:
    """Compare the motions between rows `first` (K,) and `second` (K,) of poses (N, 4, 4)."""
    if len(first) < 2:
        raise TrajectoryError(f"fewer than two pairs of poses lie {interval} apart: the trajectory is too short")
    estimated = se3.inverse(T_estimate[first]) @ T_estimate[second]
    true = se3.inverse(T_truth[first]) @ T_truth[second]
    error = se3.inverse(true) @ estimated
    return RelativeError(
        translation_m=Statistics.of(np.linalg.norm(error[:, :3, 3], axis=1)),
        rotation_deg=Statistics.of(np.degrees(se3.angle_rad(error))),
        n_pairs=len(first),
    )


def _closest(sorted_s: F64, wanted_s: F64) -> I64:
    """Return the index (K,) of the time closest to each wanted time (K,)."""
    if len(sorted_s) == 1:
        return np.zeros(len(wanted_s), dtype=np.int64)
    right = np.clip(np.searchsorted(sorted_s, wanted_s), 1, len(sorted_s) - 1)
    left_is_closer = wanted_s - sorted_s[right - 1] <= sorted_s[right] - wanted_s
    return np.asarray(right - left_is_closer, dtype=np.int64)


def _median_step_s(times_s: F64) -> float:
    return float(np.median(np.diff(times_s))) if len(times_s) > 1 else 0.0
