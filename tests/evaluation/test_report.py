"""All figures together: what is compared with what, JSON there and back, and the words around the numbers."""

import json

import numpy as np
import pytest

from stillroom.data.trajectory import Trajectory
from stillroom.errors import TrajectoryError
from stillroom.evaluation.report import HEADER, as_text, evaluate, lines, percent, rows
from stillroom.evaluation.report_file import from_json, to_json
from stillroom.evaluation.trajectory_errors import ate, rpe, rpe_frames
from stillroom.geometry import se3

T_MARKER_CAMERA = se3.exp(np.array([0.02, -0.1, 0.05, 0.2, -0.4, 0.1]))


@pytest.fixture
def marker_walk(walk: tuple[Trajectory, Trajectory]) -> tuple[Trajectory, Trajectory, Trajectory]:
    """An estimate, the ground truth of a marker on the camera, and that of the camera, as Bonn has them."""
    estimate, camera_truth = walk
    marker = Trajectory(camera_truth.timestamps_s, camera_truth.T_world_cam @ se3.inverse(T_MARKER_CAMERA))
    return estimate, marker, camera_truth


def test_the_figures_are_those_of_ate_and_rpe(walk: tuple[Trajectory, Trajectory]) -> None:
    estimate, truth = walk
    evaluation, absolute = evaluate(estimate, truth, n_given=300), ate(estimate, truth)
    given = evaluation.as_given
    assert (given.ate_se3_m, given.ate_sim3_m, given.scale) == (absolute.se3_m, absolute.sim3_m, absolute.scale)
    assert (given.n_compared, given.still_camera_m) == (absolute.n_compared, absolute.still_camera_m)
    assert given.rpe_1s == rpe(estimate, truth)
    assert given.rpe_30_frames == rpe_frames(estimate, truth, 30)
    assert evaluation.at_camera is None
    assert evaluation.coverage == len(estimate) / 300
    assert evaluate(estimate, truth).coverage is None


def test_relative_errors_are_read_at_the_camera(
    marker_walk: tuple[Trajectory, Trajectory, Trajectory],
) -> None:
    estimate, marker, camera = marker_walk
    evaluation = evaluate(estimate, marker, groundtruth_camera=camera)
    assert evaluation.as_given.ate_se3_m == ate(estimate, marker).se3_m
    assert evaluation.for_rpe.rpe_1s == rpe(estimate, camera)
    assert evaluation.for_rpe.rpe_1s.rotation_deg.rmse < 0.2 * evaluation.as_given.rpe_1s.rotation_deg.rmse
    assert evaluation.as_given.groundtruth != evaluation.at_camera.groundtruth


def test_a_short_trajectory_has_an_ate_and_says_that_it_has_no_rpe(walk: tuple[Trajectory, Trajectory]) -> None:
    estimate, truth = walk
    short = evaluate(Trajectory(estimate.timestamps_s[:10], estimate.T_world_cam[:10]), truth)
    assert short.as_given.n_compared == 10
    assert short.as_given.rpe_1s is None
    assert short.as_given.rpe_30_frames is None
    assert [row[2] for row in rows(short)[2:6]] == ["–"] * 4
    assert short.against(short, "itself").improvement.rpe_rotation_percent is None
    assert from_json(to_json(short)) == short


def test_improvement_compares_what_is_to_be_read(
    marker_walk: tuple[Trajectory, Trajectory, Trajectory],
) -> None:
    estimate, marker, camera = marker_walk
    worse = Trajectory(estimate.timestamps_s, estimate.T_world_cam.copy())
    worse.T_world_cam[:, 0, 3] += np.sin(np.arange(len(worse)) / 9)
    ours, baseline = (evaluate(e, marker, groundtruth_camera=camera) for e in (estimate, worse))
    gain = ours.against(baseline, "worse").improvement
    assert gain.baseline == "worse"
    expected = (1 - ate(estimate, marker).se3_m.rmse / ate(worse, marker).se3_m.rmse) * 100
    assert gain.ate_percent == pytest.approx(expected)
    expected = (1 - rpe(estimate, camera).translation_m.rmse / rpe(worse, camera).translation_m.rmse) * 100
    assert gain.rpe_translation_percent == pytest.approx(expected)
    assert gain.ate_percent > 50 > 1 > abs(gain.rpe_rotation_percent)


@pytest.mark.parametrize("n_given", [None, 300])
def test_json_comes_back_the_same(marker_walk: tuple[Trajectory, Trajectory, Trajectory], n_given: int | None) -> None:
    estimate, marker, camera = marker_walk
    for truth_at_camera in (None, camera):
        evaluation = evaluate(estimate, marker, groundtruth_camera=truth_at_camera, n_given=n_given)
        for one in (evaluation, evaluation.against(evaluation, "itself")):
            assert from_json(to_json(one)) == one
    data = json.loads(to_json(evaluation))
    assert data["coverage"] == evaluation.coverage
    assert data["as_given"]["ate_se3_m"]["rmse"] == evaluation.as_given.ate_se3_m.rmse


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", '{"n_tracked": 3}', '"x"', "null"])
def test_json_of_something_else_is_refused_in_one_line(text: str) -> None:
    with pytest.raises(TrajectoryError, match=r"expected a metrics\.json") as error:
        from_json(text)
    assert "\n" not in str(error.value)


def test_json_with_a_broken_number_is_refused(walk: tuple[Trajectory, Trajectory]) -> None:
    data = json.loads(to_json(evaluate(*walk)))
    data["as_given"]["ate_se3_m"]["rmse"] = "much"
    with pytest.raises(TrajectoryError, match="much"):
        from_json(json.dumps(data))


def test_the_text_says_convention_coverage_and_the_still_camera(
    marker_walk: tuple[Trajectory, Trajectory, Trajectory],
) -> None:
    estimate, marker, camera = marker_walk
    evaluation = evaluate(estimate, marker, groundtruth_camera=camera, n_given=300)
    text = as_text(evaluation.against(evaluation, "itself"))
    given = evaluation.as_given
    for words in (
        "SE(3)",
        f"Sim(3), scale {given.scale:.4f}",
        "as given",
        "moved to the camera",
        f"{given.ate_se3_m.rmse:.4f}",
        f"{evaluation.at_camera.rpe_1s.rotation_deg.rmse:.3f}",
        f"{len(estimate)} of 300 frames tracked ({len(estimate) / 3:.1f} %)",
        f"{given.n_compared} poses compared",
        f"never moved): ATE {given.still_camera_m:.4f} m",
        "improvement over itself",
        "ATE +0.0 %",
    ):
        assert words in text, words
    assert all(len(row) == len(HEADER) for row in rows(evaluation))
    smooth = [row for row in rows(evaluation) if "jitter" in row[0] or "than 1 s" in row[0]]
    assert [row[1] for row in smooth] == ["moved to the camera"] * 4
    assert f"{evaluation.at_camera.smoothness.jitter_m.rmse:.4f}" in text
    assert len(rows(evaluation)) + 4 == 2 * len(rows(evaluate(estimate, marker)))


def test_an_unknown_coverage_is_said_to_be_unknown(walk: tuple[Trajectory, Trajectory]) -> None:
    assert "not known" in lines(evaluate(*walk))[0]


@pytest.mark.parametrize(
    ("share", "text"), [(1.0, "100.0 %"), (0.9999, "99.9 %"), (559 / 560, "99.8 %"), (0.0, "0.0 %"), (None, "–")]
)
def test_a_share_is_never_rounded_up_to_all(share: float | None, text: str) -> None:
    assert percent(share) == text


def test_poses_known_earlier_are_compared_beside_the_final_ones_and_read_again(
    marker_walk: tuple[Trajectory, Trajectory, Trajectory],
) -> None:
    estimate, marker, camera = marker_walk
    poses = estimate.T_world_cam.copy()
    poses[::2, 0, 3] += 0.01
    online = Trajectory(estimate.timestamps_s, poses)
    evaluation = evaluate(estimate, marker, groundtruth_camera=camera, online=online, lagged=estimate)
    alone = evaluate(online, marker, groundtruth_camera=camera)
    assert evaluation.online is not None
    assert evaluation.lagged is not None
    assert evaluation.online.ate_m == alone.as_given.ate_se3_m.rmse
    assert evaluation.online.jitter_m == alone.at_camera.smoothness.jitter_m.rmse
    assert evaluation.lagged.ate_m == evaluation.as_given.ate_se3_m.rmse
    assert evaluation.lagged.n_compared == evaluation.as_given.n_compared
    assert from_json(to_json(evaluation)) == evaluation
    assert f"ATE {evaluation.online.ate_m:.4f} m" in as_text(evaluation)


def test_poses_known_earlier_that_are_too_few_cost_nothing_but_their_own_figures(
    marker_walk: tuple[Trajectory, Trajectory, Trajectory],
) -> None:
    """As where all images but the last were tracked in a sub-map that was merged into the main one afterwards."""
    estimate, marker, _ = marker_walk
    online = Trajectory(estimate.timestamps_s[-1:], estimate.T_world_cam[-1:])
    evaluation = evaluate(estimate, marker, online=online, lagged=Trajectory(np.zeros(0), np.zeros((0, 4, 4))))
    assert evaluation.online is None
    assert evaluation.lagged is None
    assert evaluation.as_given == evaluate(estimate, marker).as_given
