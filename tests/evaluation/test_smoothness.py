"""Jitter and the error by how fast it changes, against errors whose figures are known in closed form."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stillroom.data.trajectory import Trajectory
from stillroom.errors import TrajectoryError
from stillroom.evaluation.smoothness import smoothness
from stillroom.geometry import se3

N, STEP_S = 3000, 1 / 30
TIMES_S = 100.0 + STEP_S * np.arange(N)
MOVED = se3.from_rotation_translation(Rotation.from_rotvec([0.4, -1.0, 0.3]).as_matrix(), np.array([3.0, -2.0, 1.0]))


def path(times_s: np.ndarray) -> Trajectory:
    """A smooth path that turns and goes round."""
    poses = np.tile(np.eye(4), (len(times_s), 1, 1))
    phase = 0.7 * (times_s - 100.0)
    poses[:, :3, :3] = Rotation.from_euler(
        "yx", np.stack((0.5 * np.sin(phase), 0.2 * np.cos(phase)), axis=1)
    ).as_matrix()
    poses[:, :3, 3] = np.stack((np.cos(phase), 0.3 * np.sin(2 * phase), np.sin(phase)), axis=1)
    return Trajectory(times_s, poses)


TRUTH = path(99.0 + 0.005 * np.arange(int((N * STEP_S + 2.0) / 0.005)))


def with_errors(position_m: np.ndarray, rotvec: np.ndarray | None = None) -> Trajectory:
    """The path at the images' times with position errors (N, 3) [m, world] and rotation errors (N, 3) [rad, camera]."""
    poses = path(TIMES_S).T_world_cam.copy()
    poses[:, :3, 3] += position_m
    if rotvec is not None:
        poses[:, :3, :3] = poses[:, :3, :3] @ Rotation.from_rotvec(rotvec).as_matrix()
    return Trajectory(TIMES_S, MOVED @ poses)


def test_a_perfect_trajectory_in_another_world_has_none() -> None:
    found = smoothness(with_errors(np.zeros((N, 3))), TRUTH)
    # What is left is the bending of the true path between two of its poses.
    for part in (found.jitter_m, found.slow_m, found.fast_m):
        assert part.max < 2e-5
    assert found.jitter_deg.max < 2e-3


def test_white_noise_is_fast_and_jitters_by_the_root_of_six() -> None:
    noise_m = np.random.default_rng(0).normal(0, 0.004, (N, 3))
    found = smoothness(with_errors(noise_m), TRUTH)
    assert found.jitter_m.rmse == pytest.approx(np.sqrt(6 * 3) * 0.004, rel=0.03)
    assert found.fast_m.rmse == pytest.approx(np.sqrt(3) * 0.004, rel=0.05)
    assert found.slow_m.rmse < 0.25 * found.fast_m.rmse


def test_a_slow_wave_is_slow_and_hardly_jitters() -> None:
    wave_m = np.zeros((N, 3))
    wave_m[:, 1] = 0.05 * np.sin(2 * np.pi * 0.1 * TIMES_S)
    found = smoothness(with_errors(wave_m), TRUTH)
    assert found.slow_m.rmse == pytest.approx(0.05 / np.sqrt(2), rel=0.05)
    assert found.fast_m.rmse < 0.05 * found.slow_m.rmse
    # The second difference of a wave is ω² Δt² times it.
    assert found.jitter_m.rmse == pytest.approx(0.05 / np.sqrt(2) * (2 * np.pi * 0.1 * STEP_S) ** 2, rel=0.1, abs=1e-5)


def test_a_fast_wave_is_fast() -> None:
    wave_m = np.zeros((N, 3))
    wave_m[:, 0] = 0.01 * np.sin(2 * np.pi * 5.0 * TIMES_S)
    found = smoothness(with_errors(wave_m), TRUTH)
    assert found.fast_m.rmse == pytest.approx(0.01 / np.sqrt(2), rel=0.05)
    assert found.slow_m.rmse < 0.1 * found.fast_m.rmse


def test_rotation_jitters_by_the_root_of_six_too() -> None:
    noise_deg = np.random.default_rng(1).normal(0, 0.05, (N, 3))
    found = smoothness(with_errors(np.zeros((N, 3)), np.radians(noise_deg)), TRUTH)
    assert found.jitter_deg.rmse == pytest.approx(np.sqrt(6 * 3) * 0.05, rel=0.03)


def test_a_gap_makes_no_jitter() -> None:
    """The camera was lost for a second, and came back with another error."""
    errors_m = np.zeros((N, 3))
    errors_m[1500:, 2] = 0.2
    whole = with_errors(errors_m)
    kept = np.r_[0:1480, 1510:N]
    with_gap = Trajectory(whole.timestamps_s[kept], whole.T_world_cam[kept])
    assert smoothness(whole, TRUTH).jitter_m.max > 0.15
    assert smoothness(with_gap, TRUTH).jitter_m.max < 2e-5


def test_too_few_poses_are_refused() -> None:
    whole = with_errors(np.zeros((N, 3)))
    with pytest.raises(TrajectoryError, match="only 4 poses have truth around them; 5 are needed"):
        smoothness(Trajectory(whole.timestamps_s[:4], whole.T_world_cam[:4]), TRUTH)


def wave(hertz: float, metres: float, times_s: np.ndarray) -> np.ndarray:
    """Positions (N, 3) [m] that go to and fro."""
    return np.stack((metres * np.sin(2 * np.pi * hertz * times_s), *2 * [np.zeros(len(times_s))]), axis=1)


def shaking(times_s: np.ndarray, tremor_m: float) -> Trajectory:
    """The path with a tremor of 3 Hz, in the world of the images' poses."""
    poses = path(times_s).T_world_cam.copy()
    poses[:, :3, 3] += wave(3.0, tremor_m, times_s)
    return Trajectory(times_s, poses)


@pytest.mark.parametrize("left", [1.0, 0.5, 1.5])
def test_the_power_of_fast_motion_is_the_square_of_what_is_left_of_a_tremor(left: float) -> None:
    truth = shaking(TRUTH.timestamps_s, 0.01)
    estimate = shaking(TIMES_S, left * 0.01)
    moved = Trajectory(TIMES_S, MOVED @ estimate.T_world_cam)
    power = smoothness(moved, truth).fast_power
    assert power == pytest.approx(left**2, rel=0.03)


def test_slow_errors_are_no_fast_motion_and_gaps_end_a_piece() -> None:
    truth = shaking(TRUTH.timestamps_s, 0.01)
    poses = shaking(TIMES_S, 0.01).T_world_cam.copy()
    poses[:, :3, 3] += wave(0.2, 0.1, TIMES_S)
    poses[1500:, 2, 3] += 0.5
    kept = np.r_[0:1480, 1510:N]
    power = smoothness(Trajectory(TIMES_S[kept], poses[kept]), truth).fast_power
    assert power == pytest.approx(1.0, rel=0.03)


def test_smoothing_a_trajectory_takes_the_power_of_its_fast_motion() -> None:
    """A Gaussian of four images leaves exp(−(2π f σ)²) of the power: over-smoothing shows."""
    from scipy.ndimage import gaussian_filter1d

    truth = shaking(TRUTH.timestamps_s, 0.01)
    poses = shaking(TIMES_S, 0.01).T_world_cam.copy()
    poses[:, :3, 3] = gaussian_filter1d(poses[:, :3, 3], 2.0, axis=0)
    power = smoothness(Trajectory(TIMES_S, poses), truth).fast_power
    assert power == pytest.approx(np.exp(-((2 * np.pi * 3.0 * 2.0 * STEP_S) ** 2)), rel=0.1)


def test_a_short_trajectory_has_no_spectrum() -> None:
    few = slice(0, 80)
    short = with_errors(np.zeros((N, 3)))
    assert smoothness(Trajectory(TIMES_S[few], short.T_world_cam[few]), TRUTH).fast_power is None
