"""The absolute and the relative errors of a trajectory (Sturm et al., IROS 2012), and statistics of them."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np

from stillroom.data.association import TUM_MAX_GAP_S, associate, closest
from stillroom.data.trajectory import Trajectory
from stillroom.errors import TrajectoryError
from stillroom.geometry import se3
from stillroom.geometry.align import align
from stillroom.geometry.arrays import F64, I64, Floats

# Which poses of an estimate are compared with which of the ground truth, and when they cannot be.


MAX_SHARE_BESIDE = 0.1
MIN_PAIRS = 3
"""An alignment of fewer poses is meaningless: they always fit."""


def pair(
    estimate: Trajectory, groundtruth: Trajectory, max_gap_s: float = TUM_MAX_GAP_S
) -> tuple[Trajectory, Trajectory]:
    """Return the poses of both that belong together, row by row, in order of time.

    Raises:
        TrajectoryError: Either is empty or not finite, they do not overlap in time, or fewer than three poses
            find a partner.
    """
    check_comparable(estimate, groundtruth, max_gap_s)
    i, j = associate(estimate.timestamps_s, groundtruth.timestamps_s, max_gap_s)
    if len(i) < MIN_PAIRS:
        true_s = np.sort(groundtruth.timestamps_s)
        apart_s = np.abs(true_s[closest(true_s, estimate.timestamps_s)] - estimate.timestamps_s)
        raise TrajectoryError(
            f"only {len(i)} of the estimate's {len(estimate)} poses lie within {max_gap_s:g} s of a pose of the "
            f"ground truth, and {MIN_PAIRS} are needed; the closest ones are {float(np.median(apart_s)):.3g} s away "
            "(median): --interpolate, --max-gap and --offset help where it is the same sequence "
            "[see troubleshooting: groundtruth-gaps]"
        )
    return (
        replace(estimate, timestamps_s=estimate.timestamps_s[i], T_world_cam=estimate.T_world_cam[i]),
        Trajectory(groundtruth.timestamps_s[j], groundtruth.T_world_cam[j]),
    )


def check_comparable(estimate: Trajectory, groundtruth: Trajectory, max_gap_s: float = TUM_MAX_GAP_S) -> None:
    """Refuse trajectories that are empty, not finite, or of different times.

    Raises:
        TrajectoryError: They are so.
    """
    _check("estimate", estimate)
    _check("ground truth", groundtruth)
    starts, ends = zip(*((t.timestamps_s.min(), t.timestamps_s.max()) for t in (estimate, groundtruth)), strict=True)
    if max(starts) > min(ends) + max_gap_s:
        raise TrajectoryError(
            f"no overlap in time: the estimate lies in {starts[0]:.3f}–{ends[0]:.3f} s, the ground truth in "
            f"{starts[1]:.3f}–{ends[1]:.3f} s; give --offset, or 'estimate' for it, where it is the same sequence by "
            "another clock [see troubleshooting: groundtruth-gaps]"
        )


def _check(name: str, trajectory: Trajectory) -> None:
    if len(trajectory) == 0:
        raise TrajectoryError(f"{name}: no poses in it, so nothing can be compared")
    finite = np.isfinite(trajectory.timestamps_s) & np.isfinite(trajectory.T_world_cam).all(axis=(1, 2))
    if not finite.all():
        row = int(np.argmin(finite))
        raise TrajectoryError(
            f"{name}: pose {row} (from 0) at {trajectory.timestamps_s[row]:.6f} s is not finite; remove it"
        )


# What is free when a trajectory is laid upon the truth.


class Alignment(StrEnum):
    """The kind of motion by which a trajectory is aligned with the truth before it is compared."""

    SE3 = "SE(3)"
    SIM3 = "Sim(3)"

    @classmethod
    def of(cls, estimate: Trajectory) -> "Alignment":
        """Return the one that suits a trajectory: Sim(3) where it is known up to scale only."""
        return cls.SE3 if estimate.is_metric else cls.SIM3


def in_metres(estimate: Trajectory, groundtruth: Trajectory, max_gap_s: float = TUM_MAX_GAP_S) -> Trajectory:
    """Return a trajectory that is up to scale with the scale at which it fits the truth best; a metric one as it is.

    Raises:
        TrajectoryError: The two cannot be compared (see `pair`).
    """
    if estimate.is_metric:
        return estimate
    ours, truth = pair(estimate, groundtruth, max_gap_s)
    return estimate.scaled(align(ours.positions_m, truth.positions_m, with_scale=True).scale)


# The six numbers that TUM's tools print of a list of errors, and the spread of one figure over several runs.


@dataclass(frozen=True)
class Statistics:
    """Errors in six numbers, in the unit of the errors. `std` divides by N, as TUM's tools and evo do."""

    rmse: float
    mean: float
    median: float
    std: float
    min: float
    max: float

    @classmethod
    def of(cls, errors: Floats) -> "Statistics":
        """Sum up errors (N,), N ≥ 1."""
        return cls(
            rmse=float(np.sqrt(np.mean(np.square(errors)))),
            mean=float(np.mean(errors)),
            median=float(np.median(errors)),
            std=float(np.std(errors)),
            min=float(np.min(errors)),
            max=float(np.max(errors)),
        )


@dataclass(frozen=True)
class Spread:
    """One figure over several runs: a result must be reported with it (docs/reference.md#comparing-figures)."""

    median: float
    mean: float
    min: float
    max: float
    n_runs: int

    @classmethod
    def of(cls, figures: Sequence[float]) -> "Spread":
        """Sum up the figures of at least one run."""
        values = np.asarray(figures, dtype=np.float64)
        return cls(
            median=float(np.median(values)),
            mean=float(np.mean(values)),
            min=float(np.min(values)),
            max=float(np.max(values)),
            n_runs=len(values),
        )


def improvement_percent(baseline: float, figure: float) -> float | None:
    """Return how far a figure lies below a baseline's, (1 − β/α)·100 [%]; None where the baseline is 0."""
    return (1.0 - figure / baseline) * 100.0 if baseline else None


# The relative pose error (Sturm et al., IROS 2012): drift over a fixed interval.
#
# Two conventions are in use and differ in more than the interval. TUM's evaluate_rpe.py, which the papers' m/s and
# deg/s come from, takes motions from the later pose to the earlier, looks up the ground truth for each pose by
# itself, and drops the pairs that end on the last pose. evo pairs the poses first and takes motions forward
# (docs/reference.md#tum-rgb-d-evaluation).


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


class SparseTruthError(TrajectoryError):
    """The ground truth has too few poses for relative errors: they would be those of other moments."""


def require_dense(estimate: Trajectory, groundtruth: Trajectory, max_gap_s: float = TUM_MAX_GAP_S) -> None:
    """Refuse a ground truth whose poses lie too far in time from the estimate's, for want of rate rather than by a gap.

    A motion that is measured between moments up to half a step of the ground truth beside those of the estimate has
    the camera's motion in that time as its error.

    Raises:
        SparseTruthError: More than a tenth of the estimate's poses have none within `max_gap_s` [s].
    """
    true_s, times_s = groundtruth.timestamps_s, estimate.timestamps_s
    step_s = _median_step_s(true_s)
    gaps_s = np.abs(true_s[closest(true_s, times_s)] - times_s)
    gaps_s = gaps_s[gaps_s <= 2 * step_s]
    if np.sum(gaps_s > max_gap_s) > MAX_SHARE_BESIDE * len(gaps_s):
        raise SparseTruthError(
            f"the ground truth has a pose every {step_s:.3g} s (median), up to {gaps_s.max():.3g} s beside those of "
            "the estimate, whose motion meanwhile would count as error; --interpolate, or a larger --max-gap "
            "[see troubleshooting: groundtruth-gaps]"
        )


def rpe(
    estimate: Trajectory, groundtruth: Trajectory, delta_s: float = 1.0, max_gap_s: float = TUM_MAX_GAP_S
) -> RelativeError:
    """Measure drift over a time by the rule of `evaluate_rpe.py --fixed_delta --delta DELTA --delta_unit s`.

    As there, a pose is paired with the one whose time is closest to its own plus the interval, however far off
    that lies in a gap of the estimate (it may be the pose itself); pairs that end on the last pose are left out;
    a pose counts only when the ground truth has one within twice its median step. There, more than 10,000 pairs
    are sampled at random; here all count. An estimate that is up to scale is scaled first (see `in_metres`).

    Raises:
        TrajectoryError: The two cannot be compared (see `check_comparable`), or fewer than two pairs are found.
        SparseTruthError: The ground truth has too few poses (see `require_dense`).
    """
    check_comparable(estimate, groundtruth, max_gap_s)
    require_dense(estimate, groundtruth, max_gap_s)
    estimate = in_metres(estimate, groundtruth, max_gap_s)
    times_s, true_times_s = estimate.timestamps_s, groundtruth.timestamps_s
    end = closest(times_s, times_s + delta_s)
    start = np.flatnonzero(end != len(times_s) - 1)
    end = end[start]
    true_index = closest(true_times_s, times_s)
    has_truth = np.abs(true_times_s[true_index] - times_s) <= 2 * _median_step_s(true_times_s)
    covered = has_truth[start] & has_truth[end]
    start, end = start[covered], end[covered]
    # Motions backward in time, from end to start, as in TUM's tool.
    return _measure(estimate.T_world_cam, groundtruth.T_world_cam[true_index], end, start, f"{delta_s:g} s")


def rpe_frames(
    estimate: Trajectory, groundtruth: Trajectory, n_frames: int = 30, max_gap_s: float = TUM_MAX_GAP_S
) -> RelativeError:
    """Measure drift over a number of poses, for all pairs i, i + n, as `evo_rpe -d N -u f --all_pairs` does.

    An estimate that is up to scale is scaled first, as `evo_rpe --align --correct_scale` does.

    Raises:
        TrajectoryError: The two cannot be compared (see `pair`), or fewer than two pairs are found.
        SparseTruthError: The ground truth has too few poses (see `require_dense`).
    """
    check_comparable(estimate, groundtruth, max_gap_s)
    require_dense(estimate, groundtruth, max_gap_s)
    estimate, groundtruth = pair(in_metres(estimate, groundtruth, max_gap_s), groundtruth, max_gap_s)
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


def _median_step_s(times_s: F64) -> float:
    return float(np.median(np.diff(times_s))) if len(times_s) > 1 else 0.0


@dataclass(frozen=True)
class AbsoluteError:
    """The distances of the camera centres from the truth, after the trajectories are aligned.

    The classical tables align with SE(3), the learned systems' with Sim(3), which can only be lower
    (docs/reference.md#comparing-figures): both are here. A trajectory that is up to scale is judged after Sim(3).

    Attributes:
        alignment: By which the estimate is judged.
        se3_m: Errors after a rigid alignment [m]; of a trajectory that is up to scale they mean nothing.
        sim3_m: Errors after an alignment that may also scale [m].
        scale: The scale that the Sim(3) alignment multiplies the estimate by.
        still_camera_m: RMSE of the static-pose baseline over the same poses [m], to compare them with.
        aligned: The compared poses of the estimate after its alignment, N of them.
        groundtruth: Their counterparts, N.
        errors_m: Distance of each pair after its alignment (N,) [m].
    """

    alignment: Alignment

    se3_m: Statistics
    sim3_m: Statistics
    scale: float
    still_camera_m: float
    aligned: Trajectory = field(repr=False)
    groundtruth: Trajectory = field(repr=False)
    errors_m: F64 = field(repr=False)

    @property
    def n_compared(self) -> int:
        """Number of poses compared."""
        return len(self.errors_m)

    @property
    def judged_m(self) -> Statistics:
        """The errors after the alignment by which the estimate is judged [m]."""
        return self.se3_m if self.alignment is Alignment.SE3 else self.sim3_m


def ate(estimate: Trajectory, groundtruth: Trajectory, max_gap_s: float = TUM_MAX_GAP_S) -> AbsoluteError:
    """Measure the absolute trajectory error of all poses that find a partner in time.

    It is judged after SE(3) alignment; where it is up to scale, after Sim(3).

    Raises:
        TrajectoryError: The two cannot be compared (see `pair`).
    """
    estimate, groundtruth = pair(estimate, groundtruth, max_gap_s)
    source_m, target_m = estimate.positions_m, groundtruth.positions_m
    rigid, similar = align(source_m, target_m, with_scale=False), align(source_m, target_m, with_scale=True)
    rigid_m, similar_m = (np.linalg.norm(motion.points(source_m) - target_m, axis=1) for motion in (rigid, similar))
    motion, errors_m = (rigid, rigid_m) if estimate.is_metric else (similar, similar_m)
    return AbsoluteError(
        alignment=Alignment.of(estimate),
        se3_m=Statistics.of(rigid_m),
        sim3_m=Statistics.of(similar_m),
        scale=similar.scale,
        still_camera_m=still_camera_m(target_m),
        aligned=Trajectory(estimate.timestamps_s, motion.poses(estimate.T_world_cam)),
        groundtruth=groundtruth,
        errors_m=errors_m,
    )


def still_camera_m(positions_m: F64) -> float:
    """Return the ATE RMSE [m] of the static-pose baseline: the spread of the true positions (N, 3) [m].

    The baseline is a camera that never moved; its single position is aligned with the mean of the true ones.
    """
    return float(np.sqrt(np.mean(np.sum((positions_m - positions_m.mean(axis=0)) ** 2, axis=1))))
