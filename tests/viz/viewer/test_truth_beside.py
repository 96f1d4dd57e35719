"""The true path that a viewer draws beside the camera's."""

import numpy as np
import pytest

from stillroom.data.trajectory import Trajectory
from stillroom.geometry import se3
from stillroom.viz.viewer.observer import truth_beside

T_MAP_TRUTH = se3.exp(np.array([3.0, -1.0, 0.5, 0.4, -0.8, 0.2]))


@pytest.mark.parametrize(("unit", "is_metric"), [(1.0, True), (0.3, False)])
def test_it_lies_along_the_path_in_the_lengths_of_the_map(unit: float, is_metric: bool) -> None:
    rng = np.random.default_rng(0)
    times_s = np.arange(40) / 30
    truth = Trajectory(times_s, np.array([se3.exp(rng.normal(scale=0.5, size=6)) for _ in times_s]))
    seen = truth.T_world_cam[5:30].copy()
    seen[:, :3, 3] *= unit
    beside = truth_beside(Trajectory(times_s[5:30], T_MAP_TRUTH @ seen, is_metric), truth)
    assert beside is not None
    np.testing.assert_allclose(beside.positions_m, (T_MAP_TRUTH @ seen)[:, :3, 3], atol=1e-9)
