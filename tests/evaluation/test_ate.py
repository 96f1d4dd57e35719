"""ATE against evo, and against cases whose answer is known."""

from pathlib import Path

import numpy as np
import pytest
from evo.core import metrics
from evo.core.trajectory import PoseTrajectory3D

from stillroom.data.trajectory import Trajectory, read_tum
from stillroom.errors import TrajectoryError
from stillroom.evaluation.trajectory_errors import ate, pair, still_camera_m

NAMES = ("rmse", "mean", "median", "std", "min", "max")


def as_evo(trajectory: Trajectory) -> PoseTrajectory3D:
    return PoseTrajectory3D(poses_se3=list(trajectory.T_world_cam.copy()), timestamps=trajectory.timestamps_s)


def evo_ate(estimate: Trajectory, truth: Trajectory, with_scale: bool) -> tuple[dict[str, float], float, int]:
    """evo's figures for the pairs that `pair` finds; how these differ from evo's own is a test in test_pairing."""
    estimate, truth = pair(estimate, truth)
    reference, other = as_evo(truth), as_evo(estimate)
    _, _, scale = other.align(reference, correct_scale=with_scale)
    metric = metrics.APE(metrics.PoseRelation.translation_part)
    metric.process_data((reference, other))
    return metric.get_all_statistics(), scale, reference.num_poses


def test_agrees_with_evo(case: tuple[Trajectory, Trajectory]) -> None:
    estimate, truth = case
    ours = ate(estimate, truth)
    rigid, _, n = evo_ate(estimate, truth, False)
    similar, scale, _ = evo_ate(estimate, truth, True)
    assert ours.n_compared == n
    assert ours.scale == pytest.approx(scale, abs=1e-9)
    for name in NAMES:
        assert getattr(ours.se3_m, name) == pytest.approx(rigid[name], abs=1e-6)
        assert getattr(ours.sim3_m, name) == pytest.approx(similar[name], abs=1e-6)
    assert ours.sim3_m.rmse < ours.se3_m.rmse  # the case has a fault in scale, and it shows
    assert ours.se3_m.rmse > 0.01


def test_positions_and_errors_belong_together(case: tuple[Trajectory, Trajectory]) -> None:
    result = ate(*case)
    distance_m = np.linalg.norm(result.aligned.positions_m - result.groundtruth.positions_m, axis=1)
    np.testing.assert_allclose(distance_m, result.errors_m, atol=1e-9)
    gaps_s = np.abs(result.aligned.timestamps_s - result.groundtruth.timestamps_s)
    assert gaps_s.max() <= 0.02


def test_a_perfect_trajectory_in_another_world_has_no_error(walk: tuple[Trajectory, Trajectory]) -> None:
    _, truth = walk
    T_other = np.array([[0.0, -1, 0, 5], [1, 0, 0, -3], [0, 0, 1, 100], [0, 0, 0, 1]])
    result = ate(Trajectory(truth.timestamps_s, T_other @ truth.T_world_cam), truth)
    assert result.se3_m.max < 1e-9
    assert result.scale == pytest.approx(1.0)
    np.testing.assert_allclose(result.aligned.T_world_cam, truth.T_world_cam, atol=1e-9)


def test_a_camera_that_never_moved_has_the_still_cameras_error(walk: tuple[Trajectory, Trajectory]) -> None:
    estimate, truth = walk
    still = Trajectory(estimate.timestamps_s, np.tile(np.eye(4), (len(estimate), 1, 1)))
    result = ate(still, truth)
    assert result.se3_m.rmse == pytest.approx(result.still_camera_m, abs=1e-12)
    assert result.sim3_m.rmse == pytest.approx(result.still_camera_m, abs=1e-12)


@pytest.mark.parametrize(("sequence", "whole_m", "poses"), [("bonn", 0.117, 559), ("freiburg1", 0.037, 150)])
@pytest.mark.real
def test_the_still_camera_of_the_real_stretches(
    request: pytest.FixtureRequest, sequence: str, whole_m: float, poses: int
) -> None:
    folder: Path = request.getfixturevalue(sequence)
    truth, images_s = read_tum(folder / "groundtruth.txt"), np.loadtxt(folder / "rgb.txt", usecols=0)
    assert round(still_camera_m(truth.positions_m), 3) == whole_m
    # Over the poses that a run can be compared at, half a millimetre less.
    result = ate(Trajectory(images_s, np.tile(np.eye(4), (len(images_s), 1, 1))), truth)
    assert result.n_compared == poses
    assert result.still_camera_m == pytest.approx(whole_m, abs=1e-3)


def poses(stamps_s: list[float], value: float = 0.0) -> Trajectory:
    T = np.tile(np.eye(4), (len(stamps_s), 1, 1))
    T[:, :3, 3] = value + np.arange(3 * len(stamps_s)).reshape(-1, 3) ** 0.5
    return Trajectory(np.array(stamps_s), T)


@pytest.mark.parametrize(
    ("estimate", "truth", "message"),
    [
        (poses([]), poses([0, 1, 2]), "estimate: no poses"),
        (poses([0, 1, 2]), poses([]), "ground truth: no poses"),
        (poses([0, 1, 2], np.nan), poses([0, 1, 2]), r"estimate: pose 0 \(from 0\) at 0.000000 s is not finite"),
        (poses([0, 1, 2]), poses([0, 1, np.nan]), "ground truth: pose 2 .* is not finite"),
        (poses([0, 1, 2]), poses([100, 101, 102]), "no overlap in time: the estimate lies in 0.000–2.000 s"),
        (poses([0, 1, 2]), poses([0.5, 1.01, 1.5]), "only 1 of the estimate's 3 poses lie within 0.02 s"),
        (poses([0, 1]), poses([0, 1, 2]), "only 2 of the estimate's 2 poses"),
    ],
)
def test_what_cannot_be_compared_is_said_in_one_line(estimate: Trajectory, truth: Trajectory, message: str) -> None:
    with pytest.raises(TrajectoryError, match=message) as error:
        ate(estimate, truth)
    assert "\n" not in str(error.value)
