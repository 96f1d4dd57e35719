"""How smooth a trajectory is: its jitter, its error faster and slower than one second, and how much motion is left."""

from dataclasses import dataclass

import numpy as np

from stillroom.data.trajectory import Trajectory
from stillroom.errors import TrajectoryError
from stillroom.evaluation.time_matching import interpolated
from stillroom.evaluation.trajectory_errors import Statistics
from stillroom.geometry import se3, twists
from stillroom.geometry.align import align
from stillroom.geometry.arrays import F64, Bool

WINDOW_S = 1.0
LONGEST_STEP = 1.5
"""Times the median step between images: three of them further apart than that have no second difference."""
MIN_POSES = 5
FAST_HZ = 1.0
SHORTEST_S = 3.0
"""Over less time a spectrum does not tell what is faster than `FAST_HZ` from what leaks from slower motion."""


@dataclass(frozen=True)
class Smoothness:
    """The error of a trajectory over time, after alignment, against the truth at the images' own times.

    Attributes:
        jitter_m: Second differences of the position error, image to image [m].
        jitter_deg: The same of the rotation error: differences between the errors of neighbouring steps [deg]. Like
            relative errors, they mean something only where the truth is the camera's own.
        slow_m: The position error averaged over a second around each image: what drifts [m].
        fast_m: What is left of it: what jumps and shakes [m].
        fast_power: Power of the estimated motion above 1 Hz as a share of the true one's. Well below 1, the camera's
            own motion was smoothed away; well above, it shakes. None where no three seconds follow each other.
    """

    jitter_m: Statistics
    jitter_deg: Statistics
    slow_m: Statistics
    fast_m: Statistics
    fast_power: float | None = None


def smoothness(estimate: Trajectory, groundtruth: Trajectory) -> Smoothness:
    """Measure how smooth a trajectory is; the truth is interpolated (SE(3)) at its times.

    It is aligned by SE(3); where it is up to scale, by Sim(3).

    Raises:
        TrajectoryError: Fewer than five poses have truth around them, or no three of them follow each other.
    """
    truth = interpolated(groundtruth, estimate.timestamps_s)
    known = np.isin(estimate.timestamps_s, truth.timestamps_s)
    T, times_s = estimate.T_world_cam[known], estimate.timestamps_s[known]
    if len(times_s) < MIN_POSES:
        raise TrajectoryError(f"only {len(times_s)} poses have truth around them; {MIN_POSES} are needed")
    aligned = align(T[:, :3, 3], truth.positions_m, not estimate.is_metric).poses(T)
    error_m = aligned[:, :3, 3] - truth.positions_m
    together = _follow_each_other(times_s)
    if not together.any():
        raise TrajectoryError("no three poses follow each other from image to image")
    slow_m = _averaged(error_m, times_s)
    return Smoothness(
        jitter_m=_norms(_second_differences(error_m)[together]),
        jitter_deg=_norms(np.degrees(np.diff(_step_errors_rad(T, truth.T_world_cam), axis=0)[together])),
        slow_m=_norms(slow_m),
        fast_m=_norms(error_m - slow_m),
        fast_power=_fast_power(times_s, aligned[:, :3, 3], truth.positions_m),
    )


def _norms(errors: F64) -> Statistics:
    return Statistics.of(np.linalg.norm(errors, axis=1))


def _step_errors_rad(T: F64, T_true: F64) -> F64:
    """Return the rotation errors (N − 1, 3) of the steps between images; no alignment of the worlds is needed."""
    steps, true = (se3.inverse(poses[:-1]) @ poses[1:] for poses in (T, T_true))
    return np.asarray(twists.log(se3.inverse(true) @ steps)[:, 3:])


def _second_differences(errors: F64) -> F64:
    return np.asarray(errors[2:] - 2.0 * errors[1:-1] + errors[:-2])


def _follow_each_other(times_s: F64) -> Bool:
    """Return which neighbours of three (N − 2,) have no gap between them."""
    steps_s = np.diff(times_s)
    close = steps_s <= LONGEST_STEP * np.median(steps_s)
    together: Bool = close[1:] & close[:-1]
    return together


def _fast_power(times_s: F64, positions_m: F64, true_m: F64) -> float | None:
    """Return the power of positions (N, 3) above `FAST_HZ` as a share of the true ones'; see `Smoothness`."""
    step_s = float(np.median(np.diff(times_s)))
    ends = np.flatnonzero(np.diff(times_s) > LONGEST_STEP * step_s) + 1
    power = np.zeros(2)
    for piece in np.split(np.arange(len(times_s)), ends):
        even_s = np.arange(times_s[piece[0]], times_s[piece[-1]], step_s)
        if len(even_s) * step_s < SHORTEST_S:
            continue
        is_fast = np.fft.rfftfreq(len(even_s), step_s) > FAST_HZ
        for which, path_m in enumerate((positions_m, true_m)):
            even_m = np.stack([np.interp(even_s, times_s[piece], path_m[piece, axis]) for axis in range(3)], axis=1)
            windowed = (even_m - even_m.mean(axis=0)) * np.hanning(len(even_s))[:, None]
            power[which] += (np.abs(np.fft.rfft(windowed, axis=0)[is_fast]) ** 2).sum() / len(even_s)
    return float(power[0] / power[1]) if power[1] > 0.0 else None


def _averaged(errors: F64, times_s: F64) -> F64:
    """Return the mean of the errors (N, 3) within half a second before and after each."""
    start = np.searchsorted(times_s, times_s - 0.5 * WINDOW_S, side="left")
    end = np.searchsorted(times_s, times_s + 0.5 * WINDOW_S, side="right")
    sums = np.concatenate((np.zeros((1, 3)), np.cumsum(errors, axis=0)))
    return np.asarray((sums[end] - sums[start]) / (end - start)[:, None])
