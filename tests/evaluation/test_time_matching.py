"""Slow ground truth is interpolated or gives no RPE; clocks that differ are shifted; every refusal says what helps."""

import numpy as np
import pytest

from stillroom.data.trajectory import Trajectory, read_tum
from stillroom.errors import ConfigError, TrajectoryError
from stillroom.evaluation.report import evaluate, lines
from stillroom.evaluation.report_file import from_json, to_json
from stillroom.evaluation.time_matching import TimeMatching, estimate_offset_s, interpolated
from stillroom.evaluation.trajectory_errors import SparseTruthError, rpe, rpe_frames
from stillroom.geometry import se3

ROW = "[see troubleshooting: groundtruth-gaps]"
Walk = tuple[Trajectory, Trajectory]


def part(trajectory: Trajectory, places: slice | np.ndarray) -> Trajectory:
    return Trajectory(trajectory.timestamps_s[places], trajectory.T_world_cam[places])


def later(trajectory: Trajectory, seconds: float) -> Trajectory:
    return Trajectory(trajectory.timestamps_s + seconds, trajectory.T_world_cam)


def test_a_motion_of_constant_twist_is_interpolated_exactly() -> None:
    twist = np.array([0.3, -0.2, 0.1, 0.4, 0.1, -0.7])
    true = Trajectory(np.arange(5.0), np.array([se3.exp(k * twist) for k in range(5)]))
    times_s = np.array([-0.1, 0.0, 0.25, 1.5, 3.999, 4.0, 4.1])
    between = interpolated(true, times_s)
    assert between.timestamps_s.tolist() == times_s[1:-1].tolist()
    expected = np.array([se3.exp(time * twist) for time in times_s[1:-1]])
    np.testing.assert_allclose(between.T_world_cam, expected, atol=1e-12)


def test_a_hole_is_not_bridged() -> None:
    times_s = np.array([0.0, 1.0, 2.0, 6.0, 7.0])
    true = Trajectory(times_s, np.tile(np.eye(4), (5, 1, 1)))
    assert interpolated(true, np.array([1.5, 3.0, 5.9, 6.5])).timestamps_s.tolist() == [1.5, 6.5]
    with pytest.raises(TrajectoryError, match="nothing can be interpolated"):
        interpolated(true, np.array([100.0]))
    with pytest.raises(TrajectoryError, match="nothing can be interpolated"):
        interpolated(part(true, slice(1)), np.array([0.0]))


def test_slow_ground_truth_gives_no_relative_errors(walk: Walk) -> None:
    estimate, truth = walk
    slow = part(truth, slice(None, None, 18))  # 5 Hz
    for measure in (rpe, rpe_frames):
        with pytest.raises(SparseTruthError, match=r"a pose every 0\.2 s \(median\), up to 0\.\d+ s beside"):
            measure(estimate, slow)
    evaluation = evaluate(estimate, slow)
    assert evaluation.as_given.rpe_1s is evaluation.as_given.rpe_30_frames is None
    said = [line for line in lines(evaluation) if line.startswith("no RPE: ")]
    assert len(said) == 1
    assert "--interpolate" in said[0]
    assert said[0].endswith(ROW)
    assert from_json(to_json(evaluation)) == evaluation


def test_interpolated_ground_truth_gives_the_relative_errors_of_the_dense_one(walk: Walk) -> None:
    estimate, truth = walk
    right = evaluate(estimate, truth).as_given
    evaluation = evaluate(estimate, part(truth, slice(None, None, 9)), matching=TimeMatching(interpolate=True))
    assert evaluation.as_given.rpe_1s.rotation_deg.rmse == pytest.approx(right.rpe_1s.rotation_deg.rmse, rel=0.05)
    assert evaluation.as_given.ate_se3_m.rmse == pytest.approx(right.ate_se3_m.rmse, rel=0.05)
    assert evaluation.as_given.n_compared > 0.95 * len(estimate)
    assert any("interpolated" in line for line in lines(evaluation))
    assert from_json(to_json(evaluation)) == evaluation


@pytest.mark.real
def test_real_ground_truth_thinned_to_5_hz(bonn) -> None:
    truth = read_tum(bonn / "groundtruth.txt")
    images_s = np.loadtxt(bonn / "rgb.txt", usecols=0)
    estimate, slow = interpolated(truth, images_s), part(truth, slice(None, None, 6))
    assert evaluate(estimate, truth).as_given.rpe_1s is not None  # 30 Hz beside 30 Hz is near enough
    assert "a pose every 0.2 s" in evaluate(estimate, slow).as_given.rpe_refused
    between = evaluate(estimate, slow, matching=TimeMatching(interpolate=True)).as_given
    assert between.rpe_1s.rotation_deg.rmse < 1.0


@pytest.mark.parametrize("offset_s", [0.8, -0.8, 3.0, -1.5e9])
def test_the_offset_between_two_clocks_is_estimated(offset_s: float, walk: Walk) -> None:
    estimate, truth = walk
    right = evaluate(estimate, truth)
    other_clock = later(estimate, -offset_s)
    assert estimate_offset_s(other_clock, truth) == pytest.approx(offset_s, abs=0.02)
    evaluation = evaluate(other_clock, truth, matching=TimeMatching(offset_s=None))
    assert evaluation.offset_s == pytest.approx(offset_s, abs=0.02)
    assert evaluation.as_given.ate_se3_m.rmse < 1.1 * right.as_given.ate_se3_m.rmse
    assert any("were added to the estimate's times" in line for line in lines(evaluation))
    assert from_json(to_json(evaluation)) == evaluation


def test_the_offset_is_estimated_from_a_part_and_where_nothing_turns(walk: Walk) -> None:
    estimate, truth = walk
    middle = (truth.timestamps_s[300], truth.timestamps_s[600])
    inside = (estimate.timestamps_s > middle[0]) & (estimate.timestamps_s < middle[1])
    assert estimate_offset_s(part(later(estimate, -0.8), inside), truth) == pytest.approx(0.8, abs=0.03)
    straight = truth.T_world_cam.copy()
    straight[:, :3, :3] = np.eye(3)
    moving = Trajectory(truth.timestamps_s, straight)
    assert estimate_offset_s(later(part(moving, slice(0, None, 3)), -0.8), moving) == pytest.approx(0.8, abs=0.02)


def test_motions_that_do_not_resemble_each_other_have_no_offset(walk: Walk) -> None:
    estimate, truth = walk
    rng = np.random.default_rng(5)
    T = np.array([se3.exp(0.05 * rng.normal(size=6)) for _ in range(len(estimate))])
    with pytest.raises(TrajectoryError, match=r"resemble each other nowhere .*groundtruth-gaps"):
        estimate_offset_s(Trajectory(estimate.timestamps_s, T), truth)
    with pytest.raises(TrajectoryError, match="fewer than three poses"):
        estimate_offset_s(part(estimate, slice(2)), truth)


def test_what_lies_apart_is_measured(walk: Walk) -> None:
    estimate, truth = walk
    slow = part(truth, slice(45, None, 450))  # one pose in five seconds
    with pytest.raises(TrajectoryError, match=r"are needed; the closest ones are \d\.\d+ s away \(median\)") as caught:
        evaluate(part(estimate, slice(30)), slow)
    assert str(caught.value).endswith(ROW)
    with pytest.raises(TrajectoryError, match=r"no overlap in time.*--offset") as caught:
        evaluate(later(estimate, 1e6), truth)
    assert str(caught.value).endswith(ROW)


def test_a_larger_gap_is_heeded_by_every_figure(walk: Walk) -> None:
    estimate, truth = walk
    slow = part(truth, slice(None, None, 18))
    evaluation = evaluate(estimate, slow, matching=TimeMatching(max_gap_s=0.11))
    assert evaluation.as_given.rpe_1s is not None
    assert evaluation.as_given.n_compared > evaluate(estimate, slow).as_given.n_compared


@pytest.mark.parametrize("values", [{"max_gap_s": 0.0}, {"max_gap_s": np.nan}, {"offset_s": np.inf}])
def test_what_cannot_be_asked_is_said(values: dict) -> None:
    with pytest.raises(ConfigError, match="it must be"):
        TimeMatching(**values)
