"""Pairs against evo's, which differ only where evo uses one true pose twice."""

import numpy as np
from evo.core.sync import matching_time_indices

from stillroom.data.trajectory import Trajectory
from stillroom.evaluation.trajectory_errors import pair


def test_pairs_are_evos_made_one_to_one(case: tuple[Trajectory, Trajectory]) -> None:
    estimate, truth = case
    ours_estimate, ours_truth = pair(estimate, truth)
    i, j = (np.array(indices) for indices in matching_time_indices(estimate.timestamps_s, truth.timestamps_s, 0.02))
    used_once = np.isin(
        j, [index for index, count in zip(*np.unique(j, return_counts=True), strict=True) if count == 1]
    )
    evos = set(zip(estimate.timestamps_s[i], truth.timestamps_s[j], strict=True))
    sure = set(zip(estimate.timestamps_s[i[used_once]], truth.timestamps_s[j[used_once]], strict=True))
    ours = set(zip(ours_estimate.timestamps_s, ours_truth.timestamps_s, strict=True))
    assert sure <= ours
    assert len(ours - evos) <= 1
    assert len(set(ours_truth.timestamps_s)) == len(ours_truth) == len(ours_estimate) > 100


def test_poses_stay_with_their_times(case: tuple[Trajectory, Trajectory]) -> None:
    for whole, part in zip(case, pair(*case), strict=True):
        rows = np.searchsorted(whole.timestamps_s, part.timestamps_s)
        np.testing.assert_array_equal(whole.T_world_cam[rows], part.T_world_cam)
