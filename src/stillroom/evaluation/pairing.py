"""Which poses of an estimate are compared with which of the ground truth, and when they cannot be."""

import numpy as np

from stillroom.data.association import TUM_MAX_GAP_S, associate
from stillroom.data.trajectory import Trajectory
from stillroom.errors import TrajectoryError

MIN_PAIRS = 3
"""An alignment of fewer poses says nothing: they always fit."""


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
        raise TrajectoryError(
            f"only {len(i)} of the estimate's {len(estimate)} poses lie within {max_gap_s:g} s of a pose of the "
            f"ground truth; {MIN_PAIRS} are needed: is it the same sequence and the same clock?"
        )
    return (
        Trajectory(estimate.timestamps_s[i], estimate.T_world_cam[i]),
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
            f"{starts[1]:.3f}–{ends[1]:.3f} s; is it the same sequence and the same clock?"
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
