"""Estimates with known faults: a real ground truth, moved, bent smoothly, shaken, with poses missing."""

from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from stillroom.data.association import associate
from stillroom.data.trajectory import Trajectory, read_tum


def synthetic_truth(n: int = 900, rate_hz: float = 90.0) -> Trajectory:
    """A hand-held walk at a motion-capture's rate."""
    rng = np.random.default_rng(42)
    smooth = gaussian_filter1d(rng.normal(0, 1, (n, 6)), 60, axis=0) * [20, 20, 8, 6, 6, 6]
    T = np.tile(np.eye(4), (n, 1, 1))
    T[:, :3, :3] = Rotation.from_rotvec(smooth[:, 3:]).as_matrix()
    T[:, :3, 3] = smooth[:, :3]
    return Trajectory(1.5e9 + np.arange(n) / rate_hz, T)


def estimate_of(truth: Trajectory, stamps_s: np.ndarray, seed: int, scale: float = 1.0) -> Trajectory:
    """What a fair system might say of the camera at these times."""
    rng = np.random.default_rng(seed)
    nearest = np.abs(truth.timestamps_s[None] - stamps_s[:, None]).argmin(1)
    n = len(stamps_s)
    bend = gaussian_filter1d(rng.normal(0, 1, (n, 6)), 25, axis=0) * [0.2, 0.2, 0.2, 0.1, 0.1, 0.1]
    bend += rng.normal(0, 0.002, (n, 6))
    T = truth.T_world_cam[nearest].copy()
    T[:, :3, 3] = scale * T[:, :3, 3] + bend[:, :3]
    T[:, :3, :3] = T[:, :3, :3] @ Rotation.from_rotvec(bend[:, 3:]).as_matrix()
    T_other_world = np.eye(4)
    T_other_world[:3, :3] = Rotation.random(random_state=rng).as_matrix()
    T_other_world[:3, 3] = rng.normal(0, 5, 3)
    kept = rng.random(n) > 0.05
    kept[n // 2 : n // 2 + n // 10] = False  # lost for a while
    return Trajectory(stamps_s[kept], (T_other_world @ T)[kept])


@pytest.fixture(
    params=[
        "synthetic",
        pytest.param("bonn", marks=pytest.mark.real),
        pytest.param("freiburg1", marks=pytest.mark.real),
    ]
)
def case(request: pytest.FixtureRequest) -> tuple[Trajectory, Trajectory]:
    """An estimate and its ground truth, three times over."""
    if request.param == "synthetic":
        truth = synthetic_truth()
        stamps_s = truth.timestamps_s[0] + 0.003 + np.arange(280) / 30
        return estimate_of(truth, stamps_s, seed=1, scale=1.2), truth
    folder: Path = request.getfixturevalue(request.param)
    truth = read_tum(folder / "groundtruth.txt")
    images_s = np.loadtxt(folder / "rgb.txt", usecols=0)
    with_truth, _ = associate(images_s, truth.timestamps_s)
    return estimate_of(truth, images_s[with_truth], seed=7, scale=0.95), truth


@pytest.fixture
def walk() -> tuple[Trajectory, Trajectory]:
    """An estimate of the synthetic walk, and its ground truth."""
    truth = synthetic_truth()
    return estimate_of(truth, truth.timestamps_s[0] + 0.003 + np.arange(280) / 30, seed=2), truth
