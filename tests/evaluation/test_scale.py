"""The scale of a path, against paths that were scaled, moved, shaken and delayed by known amounts."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stillroom.data.trajectory import Trajectory
from stillroom.evaluation.scale import path_scale

TIMES_S = 100.0 + np.arange(300) / 30.0


def path(times_s: np.ndarray, scale: float = 1.0) -> Trajectory:
    poses = np.tile(np.eye(4), (len(times_s), 1, 1))
    t = times_s - 100.0
    poses[:, :3, 3] = 0.3 * scale * np.stack((np.sin(1.7 * t), 0.5 * np.cos(2.3 * t), np.sin(1.1 * t + 1)), axis=1)
    return Trajectory(times_s, poses)


TRUTH = path(99.0 + np.arange(1200) / 100.0)


def seen(scale: float, noise_m: float, late_s: float = 0.0, seed: int = 0) -> Trajectory:
    """The path in another world, with noise, drift and a clock of its own."""
    rng = np.random.default_rng(seed)
    T = path(TIMES_S - late_s, scale).T_world_cam
    drift_m = np.cumsum(1e-4 * rng.normal(size=(len(T), 3)), axis=0)
    turned = Rotation.from_rotvec([0.3, -0.9, 0.2]).as_matrix()
    moved = np.tile(np.eye(4), (len(T), 1, 1))
    moved[:, :3, 3] = (T[:, :3, 3] + drift_m + noise_m * rng.normal(size=(len(T), 3))) @ turned.T + 3.0
    return Trajectory(TIMES_S, moved)


@pytest.mark.parametrize("scale", [0.97, 1.0, 1.03])
@pytest.mark.parametrize("seed", range(3))
def test_a_scale_is_found_within_its_uncertainty(scale: float, seed: int) -> None:
    found = path_scale(seen(scale, 0.002, seed=seed), TRUTH)
    assert found is not None
    assert abs(found.scale - scale) < max(3.0 * found.sigma, 0.001)
    assert found.sigma < 0.003
    assert found.moved_m == pytest.approx(0.16, abs=0.05)


def test_a_clock_that_is_late_is_no_scale() -> None:
    found = path_scale(seen(1.03, 0.0005, late_s=0.03), TRUTH)
    assert found is not None
    assert found.scale == pytest.approx(1.03, abs=0.002)


def test_noise_does_not_shrink_it_as_it_does_in_a_similarity() -> None:
    found = path_scale(seen(1.0, 0.05), TRUTH)
    assert found is not None
    assert abs(found.scale - 1.0) < 3.0 * found.sigma
    assert found.sigma > 0.005


def test_too_little_tells_nothing() -> None:
    few = Trajectory(TIMES_S[:20], seen(1.0, 0.0).T_world_cam[:20])
    assert path_scale(few, TRUTH) is None
