"""RPE over 30 frames against evo; over 1 s against TUM's rule written in plain loops."""

import numpy as np
import pytest
from evo.core import metrics
from evo.core.trajectory import PoseTrajectory3D
from scipy.spatial.transform import Rotation

from stillroom.data.trajectory import Trajectory
from stillroom.errors import TrajectoryError
from stillroom.evaluation.trajectory_errors import RelativeError, pair, rpe, rpe_frames
from stillroom.geometry import se3

NAMES = ("rmse", "mean", "median", "std", "min", "max")


def as_evo(trajectory: Trajectory) -> PoseTrajectory3D:
    return PoseTrajectory3D(poses_se3=list(trajectory.T_world_cam.copy()), timestamps=trajectory.timestamps_s)


@pytest.mark.parametrize("n_frames", [30, 1])
def test_over_frames_agrees_with_evo(case: tuple[Trajectory, Trajectory], n_frames: int) -> None:
    estimate, truth = case
    ours = rpe_frames(estimate, truth, n_frames)
    paired_estimate, paired_truth = pair(estimate, truth)
    for relation, statistics in (
        (metrics.PoseRelation.translation_part, ours.translation_m),
        (metrics.PoseRelation.rotation_angle_deg, ours.rotation_deg),
    ):
        metric = metrics.RPE(relation, delta=n_frames, delta_unit=metrics.Unit.frames, all_pairs=True)
        metric.process_data((as_evo(paired_truth), as_evo(paired_estimate)))
        assert ours.n_pairs == len(metric.error)
        for name in NAMES:
            assert getattr(statistics, name) == pytest.approx(
                metric.get_statistic(metrics.StatisticsType[name]), abs=1e-6
            )


def tum_rule(estimate: Trajectory, truth: Trajectory, delta_s: float) -> list[tuple[float, float]]:
    """Translation [m] and rotation [deg] errors by evaluate_rpe.py's rule, pair by pair."""
    step_s = np.median([b - a for a, b in zip(truth.timestamps_s[:-1], truth.timestamps_s[1:], strict=True)])
    errors = []
    for i, start_s in enumerate(estimate.timestamps_s):
        j = int(np.argmin(abs(estimate.timestamps_s - (start_s + delta_s))))
        if j == len(estimate) - 1:
            continue
        true_i = int(np.argmin(abs(truth.timestamps_s - start_s)))
        true_j = int(np.argmin(abs(truth.timestamps_s - estimate.timestamps_s[j])))
        if abs(truth.timestamps_s[true_i] - start_s) > 2 * step_s:
            continue
        if abs(truth.timestamps_s[true_j] - estimate.timestamps_s[j]) > 2 * step_s:
            continue
        moved = np.linalg.inv(estimate.T_world_cam[j]) @ estimate.T_world_cam[i]
        truly_moved = np.linalg.inv(truth.T_world_cam[true_j]) @ truth.T_world_cam[true_i]
        error = np.linalg.inv(moved) @ truly_moved
        # The rule says arccos of the trace, which loses half the digits of a small angle; this is the same angle.
        angle_rad = Rotation.from_matrix(error[:3, :3]).magnitude()
        errors.append((float(np.linalg.norm(error[:3, 3])), float(np.degrees(angle_rad))))
    return errors


@pytest.mark.parametrize("delta_s", [1.0, 0.4])
def test_over_a_second_agrees_with_the_plain_rule(case: tuple[Trajectory, Trajectory], delta_s: float) -> None:
    ours, expected = rpe(*case, delta_s), np.array(tum_rule(*case, delta_s))
    assert ours.n_pairs == len(expected) > 50
    for errors, statistics in ((expected[:, 0], ours.translation_m), (expected[:, 1], ours.rotation_deg)):
        assert statistics.rmse == pytest.approx(np.sqrt((errors**2).mean()), abs=1e-6)
        assert statistics.mean == pytest.approx(errors.mean(), abs=1e-6)
        assert statistics.median == pytest.approx(np.median(errors), abs=1e-6)
        assert statistics.std == pytest.approx(errors.std(), abs=1e-6)
        assert statistics.min == pytest.approx(errors.min(), abs=1e-6)
        assert statistics.max == pytest.approx(errors.max(), abs=1e-6)


def test_poses_without_ground_truth_nearby_do_not_count(walk: tuple[Trajectory, Trajectory]) -> None:
    estimate, truth = walk
    kept = (truth.timestamps_s < truth.timestamps_s[300]) | (truth.timestamps_s > truth.timestamps_s[500])
    holed = Trajectory(truth.timestamps_s[kept], truth.T_world_cam[kept])
    assert rpe(estimate, holed).n_pairs == len(tum_rule(estimate, holed, 1.0)) < rpe(estimate, truth).n_pairs


@pytest.mark.parametrize("measure", [rpe, rpe_frames])
def test_another_world_and_a_perfect_estimate_make_no_error(walk: tuple[Trajectory, Trajectory], measure) -> None:
    _, truth = walk
    T_other = se3.exp(np.array([3.0, 2, 1, 0.3, 0.2, 0.1]))
    result: RelativeError = measure(Trajectory(truth.timestamps_s, T_other @ truth.T_world_cam), truth)
    assert result.translation_m.max < 1e-9
    assert result.rotation_deg.max < 1e-6


def test_a_steady_drift_is_read_in_metres_and_degrees_a_second() -> None:
    stamps_s = np.arange(100) / 25
    drift = np.stack([se3.exp(np.array([0.2 * t, 0, 0, 0, 0, 0])) for t in stamps_s])
    turn = np.stack([se3.exp(np.array([0, 0, 0, 0, np.radians(3) * t, 0])) for t in stamps_s])
    still = Trajectory(stamps_s, np.tile(np.eye(4), (100, 1, 1)))
    assert rpe(Trajectory(stamps_s, drift), still).translation_m.mean == pytest.approx(0.2)
    assert rpe(Trajectory(stamps_s, turn), still).rotation_deg.max == pytest.approx(3.0)
    assert rpe_frames(Trajectory(stamps_s, drift), still, 50).translation_m.mean == pytest.approx(0.4)


@pytest.mark.parametrize("measure", [rpe, rpe_frames])
@pytest.mark.parametrize(
    ("n", "shift_s", "value", "message"),
    [(0, 0.0, 0.0, "no poses"), (10, 0.0, 0.0, "too short"), (60, 1e4, 0.0, "no overlap"), (60, 0.0, np.nan, "finite")],
)
def test_what_cannot_be_measured_is_said_in_one_line(measure, n, shift_s, value, message) -> None:
    truth = Trajectory(np.arange(100) / 30, np.tile(np.eye(4), (100, 1, 1)))
    T = np.tile(np.eye(4), (n, 1, 1))
    T[:, 0, 3] = value
    with pytest.raises(TrajectoryError, match=message) as error:
        measure(Trajectory(shift_s + np.arange(n) / 30, T), truth)
    assert "\n" not in str(error.value)


def test_a_single_pose_is_too_short() -> None:
    one = Trajectory(np.array([0.0]), np.eye(4)[None])
    with pytest.raises(TrajectoryError, match="too short"):
        rpe(one, one)
