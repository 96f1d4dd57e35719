"""Bring an estimate and a ground truth to the same times: gaps, clocks that differ, and truth at a low rate."""

from dataclasses import dataclass, replace

import numpy as np

from stillroom.data.association import TUM_MAX_GAP_S
from stillroom.data.trajectory import Trajectory
from stillroom.errors import ConfigError, TrajectoryError
from stillroom.geometry import se3, twists
from stillroom.geometry.align import align
from stillroom.geometry.arrays import F64

ESTIMATE = "estimate"
"""In place of an offset: it is to be estimated."""

LONGEST_BRIDGED_STEPS = 3.0
"""Ground truth is not interpolated over gaps of more of its median steps than this."""


@dataclass(frozen=True)
class TimeMatching:
    """How poses of an estimate find those of the ground truth that they are compared with.

    Attributes:
        max_gap_s: Poses further apart in time are not compared [s].
        offset_s: Added to the estimate's times [s]; None to estimate it (see `estimate_offset_s`).
        interpolate: Whether the ground truth is interpolated at the estimate's times (see `interpolated`).
    """

    max_gap_s: float = TUM_MAX_GAP_S
    offset_s: float | None = 0.0
    interpolate: bool = False

    def __post_init__(self) -> None:
        """Refuse what cannot be.

        Raises:
            ConfigError: The gap is not a positive number, or the offset not a finite one.
        """
        if not (np.isfinite(self.max_gap_s) and self.max_gap_s > 0):
            raise ConfigError(f"max-gap is {self.max_gap_s}; it must be a positive number of seconds")
        if self.offset_s is not None and not np.isfinite(self.offset_s):
            raise ConfigError(f"offset is {self.offset_s}; it must be a number of seconds, or '{ESTIMATE}'")

    def match(self, estimate: Trajectory, groundtruth: Trajectory) -> tuple[Trajectory, Trajectory]:
        """Return the estimate with its times shifted, and the ground truth, interpolated where that is asked for.

        Raises:
            TrajectoryError: The offset cannot be estimated, or nothing overlaps in time.
        """
        offset_s = estimate_offset_s(estimate, groundtruth) if self.offset_s is None else self.offset_s
        if offset_s:
            estimate = replace(estimate, timestamps_s=estimate.timestamps_s + offset_s)
        return estimate, interpolated(groundtruth, estimate.timestamps_s) if self.interpolate else groundtruth


def interpolated(trajectory: Trajectory, times_s: F64) -> Trajectory:
    """Return a trajectory at other times, along the geodesic of SE(3) between the poses before and after.

    Args:
        trajectory: At least one pose.
        times_s: Times (N,) [s]. Those before the first pose, after the last, or in a gap of more than
            `LONGEST_BRIDGED_STEPS` median steps are left out.

    Raises:
        TrajectoryError: None is left.
    """
    own_s = trajectory.timestamps_s
    is_inside = (times_s >= own_s[0]) & (times_s <= own_s[-1]) if len(own_s) > 1 else np.zeros(len(times_s), np.bool_)
    after = np.clip(np.searchsorted(own_s, times_s, side="right"), 1, max(len(own_s) - 1, 1))
    if is_inside.any():
        gaps_s = own_s[after] - own_s[after - 1]
        is_inside &= gaps_s <= LONGEST_BRIDGED_STEPS * float(np.median(np.diff(own_s)))
    if not is_inside.any():
        raise TrajectoryError(
            "the ground truth has no poses before and after any of the estimate's, so nothing can be interpolated: is "
            "it the same sequence and the same clock? [see troubleshooting: groundtruth-gaps]"
        )
    after, wanted_s = after[is_inside], times_s[is_inside]
    first, second = trajectory.T_world_cam[after - 1], trajectory.T_world_cam[after]
    share = (wanted_s - own_s[after - 1]) / (own_s[after] - own_s[after - 1])
    return Trajectory(wanted_s, first @ twists.exp(share[:, None] * twists.log(se3.inverse(first) @ second)))


# The offset between two clocks, from how fast the camera turned: a turn's speed is the same in every world's axes, and
# for a marker that rides on the camera.


GRID_S = 0.01
SMOOTHED_OVER_S = 0.1
LEAST_TURN_RAD = 0.2
LEAST_OVERLAP = 0.5
LEAST_CORRELATION = 0.5
REFINED_WITHIN_S = 0.1


def estimate_offset_s(estimate: Trajectory, groundtruth: Trajectory) -> float:
    """Return what is to be added to an estimate's times [s] so that they are those of the ground truth.

    The speeds of rotation, or of translation where nothing turns, are correlated; the offset of the highest
    correlation is refined so that the absolute error (ATE, SE(3), or Sim(3) of an estimate that is up to scale) is
    smallest. Clocks may differ by any amount as long as one trajectory covers half of the other.

    Raises:
        TrajectoryError: There are too few poses, or the speeds do not resemble each other at any offset.
    """
    if min(len(estimate), len(groundtruth)) < 3:
        raise TrajectoryError("an offset cannot be estimated from fewer than three poses; give --offset in seconds")
    turns = min(_travelled(t, turning=True)[-1] for t in (estimate, groundtruth)) >= LEAST_TURN_RAD
    own_step_s = max(float(np.median(np.diff(t.timestamps_s))) for t in (estimate, groundtruth))
    ours, truths = (_speeds(t, turns, max(SMOOTHED_OVER_S, own_step_s)) for t in (estimate, groundtruth))
    correlation, lag = _best_lag(ours, truths)
    if correlation < LEAST_CORRELATION:
        raise TrajectoryError(
            f"the offset cannot be estimated: the speeds of both trajectories resemble each other nowhere (correlation "
            f"{correlation:.2f}); give --offset in seconds [see troubleshooting: groundtruth-gaps]"
        )
    rough_s = float(groundtruth.timestamps_s[0] - estimate.timestamps_s[0]) + lag * GRID_S

    def error_m(correction_s: float) -> float:
        times_s = estimate.timestamps_s + rough_s + correction_s
        try:
            truth = interpolated(groundtruth, times_s)
        except TrajectoryError:
            return np.inf
        source_m = estimate.positions_m[np.isin(times_s, truth.timestamps_s)]
        moved_m = align(source_m, truth.positions_m, not estimate.is_metric).points(source_m)
        return float(np.sqrt(np.mean(np.sum((moved_m - truth.positions_m) ** 2, axis=1))))

    from scipy.optimize import minimize_scalar

    # The correction, not the offset: of one near 1e9 s the search would see no step.
    bounds = (-REFINED_WITHIN_S, REFINED_WITHIN_S)
    return rough_s + float(minimize_scalar(error_m, bounds=bounds, method="bounded", options={"xatol": 1e-4}).x)


def _travelled(trajectory: Trajectory, turning: bool) -> F64:
    """Return how far (N,) the camera has turned [rad] or moved [m] by each pose."""
    T = trajectory.T_world_cam
    if turning:
        steps = se3.angle_rad(se3.inverse(T[:-1]) @ T[1:])
    else:
        steps = np.linalg.norm(np.diff(trajectory.positions_m, axis=0), axis=1)
    return np.concatenate(([0.0], np.cumsum(steps)))


def _speeds(trajectory: Trajectory, turning: bool, over_s: float) -> F64:
    """Return mean speeds over a time, on a grid that starts with the trajectory."""
    times_s = trajectory.timestamps_s - trajectory.timestamps_s[0]
    grid_s = np.arange(0.0, times_s[-1] + GRID_S, GRID_S)
    travelled = _travelled(trajectory, turning)
    ahead, behind = (np.interp(grid_s + side * over_s, times_s, travelled) for side in (0.5, -0.5))
    return np.asarray((ahead - behind) / over_s, dtype=np.float64)


def _best_lag(first: F64, second: F64) -> tuple[float, int]:
    """Return the highest normalised correlation, and the place in `second` at which `first` then starts."""
    from scipy.signal import correlate

    ones_first, ones_second = np.ones_like(first), np.ones_like(second)
    n = correlate(ones_second, ones_first, method="fft")
    sum_1, sum_2 = (correlate(*pair, method="fft") for pair in ((ones_second, first), (second, ones_first)))
    squares_1 = correlate(ones_second, first**2, method="fft")
    squares_2 = correlate(second**2, ones_first, method="fft")
    products = correlate(second, first, method="fft")
    n = np.maximum(np.rint(n), 1.0)
    variances = np.maximum(squares_1 - sum_1**2 / n, 0.0) * np.maximum(squares_2 - sum_2**2 / n, 0.0)
    covariances = products - sum_1 * sum_2 / n
    is_enough = (n >= LEAST_OVERLAP * min(len(first), len(second))) & (variances > 1e-12 * variances.max())
    correlations = np.where(is_enough, covariances / np.sqrt(np.where(is_enough, variances, 1.0)), -1.0)
    best = int(np.argmax(correlations))
    return float(correlations[best]), best - (len(first) - 1)
