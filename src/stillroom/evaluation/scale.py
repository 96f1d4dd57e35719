"""The scale of a trajectory against the truth, with its uncertainty.

Images and depth alone never tell it: a room twice as large, from twice as far, gives the same images, and depth that
reads twice as far agrees with them. So what is wrong with the scale of depth is wrong with that of the trajectory.
"""

from dataclasses import dataclass

import numpy as np

from stillroom.data.trajectory import Trajectory
from stillroom.evaluation.time_matching import interpolated
from stillroom.geometry.align import align
from stillroom.geometry.arrays import F64

BLOCK_S = 1.0
"""Drift within it is small, and motion within it large enough."""
LEAST_POSES = 8
"""In a block."""
LEAST_BLOCKS = 2
DRAWS = 400


@dataclass(frozen=True)
class PathScale:
    """How long a trajectory is, as a share of the truth.

    Attributes:
        scale: The estimate.
        sigma: One standard deviation, by a bootstrap over blocks of a second.
        moved_m: How far the camera went from the middle of each block, RMS [m].
    """

    scale: float
    sigma: float
    moved_m: float


def path_scale(estimate: Trajectory, groundtruth: Trajectory, seed: int = 0) -> PathScale | None:
    """Return the scale of an estimate; None where there is too little of it with the truth around.

    Within a block of a second the estimate is the truth, turned as the whole of it is, times the scale; a lag of the
    truth's clock is estimated with it.

    Args:
        estimate: The estimate.
        groundtruth: The truth, of the same body: a lever arm would pass for scale.
        seed: Of the bootstrap.
    """
    truth = interpolated(groundtruth, estimate.timestamps_s)
    known = np.isin(estimate.timestamps_s, truth.timestamps_s)
    times_s, found_m, true_m = truth.timestamps_s, estimate.positions_m[known], truth.positions_m
    if len(times_s) < LEAST_POSES:
        return None
    R = align(found_m, true_m, with_scale=False).T_target_source[:3, :3]
    blocks = _blocks(times_s, found_m @ R.T, true_m)
    if len(blocks) < LEAST_BLOCKS:
        return None
    H, slope = np.array([block[0] for block in blocks]), np.array([block[1] for block in blocks])
    rng = np.random.default_rng(seed)
    chosen = rng.integers(0, len(blocks), (DRAWS, len(blocks)))
    drawn = [_solved(H[one].sum(axis=0), slope[one].sum(axis=0)) for one in chosen]
    n_poses = sum(block[2] for block in blocks)
    scale, moved_m = _solved(H.sum(axis=0), slope.sum(axis=0)), float(np.sqrt(H[:, 0, 0].sum() / n_poses))
    return PathScale(scale, float(np.std(drawn)), moved_m)


def _blocks(times_s: F64, found_m: F64, true_m: F64) -> list[tuple[F64, F64, int]]:
    """Return normal equations of the scale, and of the lag times it, and the number of poses, block by block."""
    number = ((times_s - times_s[0]) / BLOCK_S).astype(np.int64)
    speed_m_s = np.gradient(true_m, times_s, axis=0)
    blocks = []
    for one in np.unique(number):
        inside = number == one
        if inside.sum() < LEAST_POSES:
            continue
        J = np.stack([(part[inside] - part[inside].mean(axis=0)).ravel() for part in (true_m, speed_m_s)], axis=1)
        away_m = (found_m[inside] - found_m[inside].mean(axis=0)).ravel()
        blocks.append((J.T @ J, J.T @ away_m, int(inside.sum())))
    return blocks


def _solved(H: F64, slope: F64) -> float:
    """Return the scale; a path without speed has no lag."""
    return float(np.linalg.lstsq(H, slope, rcond=1e-9)[0][0])
