"""Keypoints as the optimisers want them."""

import numpy as np

from stillroom.data.frame import ScaleLevels
from stillroom.optimize import observations


def test_keypoints_with_and_without_depth() -> None:
    px = np.array([[10, 20], [30, 40], [5, 6]], np.float32)
    right_px = np.array([8, -1, 0], np.float32)
    observed = observations.observed_px(px, right_px)
    assert observed.dtype == np.float64
    assert observed.tolist() == [[10, 20, 8], [30, 40, 0], [5, 6, 0]]
    weights = observations.weights(np.array([0, 2, 1]), right_px, ScaleLevels(2.0, 3).inverse_variances)
    assert weights.tolist() == [[1, 1, 1], [1 / 16, 1 / 16, 0], [1 / 4, 1 / 4, 1 / 4]]


def test_no_keypoints() -> None:
    none = np.zeros(0, np.float32)
    assert observations.observed_px(np.zeros((0, 2), np.float32), none).shape == (0, 3)
    assert observations.weights(none.astype(int), none, ScaleLevels().inverse_variances).shape == (0, 3)
