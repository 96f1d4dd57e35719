"""Trajectories that are known up to scale: aligned by Sim(3), as evo does it, and said to be."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from evo.core import metrics
from evo.core.trajectory import PoseTrajectory3D

from stillroom.data.trajectory import Trajectory, read_tum
from stillroom.evaluation.report import Evaluation, as_text, evaluate, lines, rows, said_alignment, values
from stillroom.evaluation.report_file import from_json, to_json
from stillroom.evaluation.smoothness import smoothness
from stillroom.evaluation.time_matching import TimeMatching, estimate_offset_s
from stillroom.evaluation.trajectory_errors import Alignment, ate, in_metres, pair, rpe, rpe_frames
from stillroom.pipeline.evaluating import evaluate_files
from stillroom.pipeline.plots import said_scales
from stillroom.pipeline.results import Truth

NAMES = ("rmse", "mean", "median", "std", "min", "max")
UNIT = 3.7
"""How many units of its map a monocular run's metre has."""


def monocular(trajectory: Trajectory) -> Trajectory:
    """The same poses in another unit, which the trajectory says it does not know."""
    return replace(trajectory.scaled(UNIT), is_metric=False)


def as_evo(trajectory: Trajectory) -> PoseTrajectory3D:
    return PoseTrajectory3D(poses_se3=list(trajectory.T_world_cam.copy()), timestamps=trajectory.timestamps_s)


def aligned_by_evo(estimate: Trajectory, truth: Trajectory) -> tuple[PoseTrajectory3D, PoseTrajectory3D, float]:
    """The pairs that `pair` finds, the estimate aligned by evo with a free scale, and that scale."""
    ours, true = pair(estimate, truth)
    reference, other = as_evo(true), as_evo(ours)
    _, _, scale = other.align(reference, correct_scale=True)
    return reference, other, float(scale)


def test_ate_is_evos_with_the_scale_corrected(case: tuple[Trajectory, Trajectory]) -> None:
    estimate, truth = monocular(case[0]), case[1]
    reference, other, scale = aligned_by_evo(estimate, truth)
    found = ate(estimate, truth)
    metric = metrics.APE(metrics.PoseRelation.translation_part)
    metric.process_data((reference, other))
    assert found.alignment is Alignment.SIM3
    assert found.scale == pytest.approx(scale, rel=1e-9)
    for name, value in metric.get_all_statistics().items():
        if name in NAMES:
            assert getattr(found.sim3_m, name) == pytest.approx(value, abs=1e-6)
    np.testing.assert_allclose(found.errors_m, metric.error, atol=1e-6)
    np.testing.assert_allclose(found.aligned.positions_m, other.positions_xyz, atol=1e-6)


@pytest.mark.parametrize("n_frames", [30, 1])
def test_rpe_is_evos_with_the_scale_corrected(case: tuple[Trajectory, Trajectory], n_frames: int) -> None:
    estimate, truth = monocular(case[0]), case[1]
    reference, other, _ = aligned_by_evo(estimate, truth)
    found = rpe_frames(estimate, truth, n_frames)
    for relation, statistics in (
        (metrics.PoseRelation.translation_part, found.translation_m),
        (metrics.PoseRelation.rotation_angle_deg, found.rotation_deg),
    ):
        metric = metrics.RPE(relation, delta=n_frames, delta_unit=metrics.Unit.frames, all_pairs=True)
        metric.process_data((reference, other))
        for name in NAMES:
            assert getattr(statistics, name) == pytest.approx(
                metric.get_statistic(metrics.StatisticsType[name]), abs=1e-6
            )


def test_the_unit_does_not_matter(case: tuple[Trajectory, Trajectory]) -> None:
    estimate, truth = replace(case[0], is_metric=False), case[1]
    other = replace(estimate.scaled(0.01), is_metric=False)
    for measure in (rpe, smoothness):
        first, second = measure(estimate, truth), measure(other, truth)
        for name in ("translation_m", "jitter_m", "slow_m", "fast_m"):
            if hasattr(first, name):
                assert getattr(first, name).rmse == pytest.approx(getattr(second, name).rmse, rel=1e-9)
    assert ate(other, truth).sim3_m.rmse == pytest.approx(ate(estimate, truth).sim3_m.rmse, rel=1e-9)
    assert rpe(estimate, truth) == rpe(in_metres(estimate, truth), truth)


def test_a_metric_trajectory_is_never_scaled(walk: tuple[Trajectory, Trajectory]) -> None:
    estimate, truth = walk
    assert in_metres(estimate, truth) is estimate
    assert ate(estimate, truth).alignment is Alignment.SE3


def test_the_offset_of_clocks_is_found_in_any_unit(walk: tuple[Trajectory, Trajectory]) -> None:
    estimate, truth = walk
    late = Trajectory(estimate.timestamps_s + 2.5, estimate.T_world_cam)
    assert estimate_offset_s(monocular(late), truth) == pytest.approx(-2.5, abs=0.01)
    matched, _ = TimeMatching(offset_s=None).match(monocular(late), truth)
    assert not matched.is_metric


def test_the_text_and_the_figures_say_sim3(walk: tuple[Trajectory, Trajectory]) -> None:
    estimate, truth = walk
    evaluation = evaluate(monocular(estimate), truth)
    text = as_text(evaluation)
    scale = evaluation.as_given.scale
    assert scale == pytest.approx(evaluate(estimate, truth).as_given.scale / UNIT)
    assert f"ATE [m], Sim(3), scale {scale:.4f}" in text
    assert "ATE [m], SE(3)" not in text
    assert any("up to scale: it was aligned by Sim(3)" in line for line in lines(evaluation))
    assert len(rows(evaluation)) == len(values(evaluation)) == len(rows(evaluate(estimate, truth))) - 1
    assert values(evaluation)[0][0] == evaluation.as_given.ate_m.rmse == evaluation.as_given.ate_sim3_m.rmse
    assert not any("Sim(3)" in line for line in lines(evaluate(estimate, truth)))


def test_json_keeps_the_alignment_and_older_files_are_metric(walk: tuple[Trajectory, Trajectory]) -> None:
    evaluation = evaluate(monocular(walk[0]), walk[1])
    assert from_json(to_json(evaluation)) == evaluation
    older = json.loads(to_json(evaluate(*walk)))
    del older["as_given"]["alignment"]
    assert from_json(json.dumps(older)) == evaluate(*walk)


def test_an_improvement_compares_like_with_like(walk: tuple[Trajectory, Trajectory]) -> None:
    metric, up_to_scale = evaluate(*walk), evaluate(monocular(walk[0]), walk[1])
    for ours, theirs in ((metric, up_to_scale), (up_to_scale, metric)):
        gain = ours.against(theirs, "the other").improvement
        assert gain is not None
        assert gain.ate_percent == pytest.approx(0.0, abs=1e-6)


def test_tables_say_by_what_their_rows_were_aligned(walk: tuple[Trajectory, Trajectory]) -> None:
    metric, up_to_scale = evaluate(*walk), evaluate(monocular(walk[0]), walk[1])
    assert said_alignment([metric, None]) == "SE(3)"
    assert said_alignment([up_to_scale]) == "Sim(3)"
    assert said_alignment([metric, up_to_scale]) == "SE(3), of trajectories that are up to scale Sim(3),"
    assert said_alignment([]) == "SE(3)"


def test_titles_say_it(walk: tuple[Trajectory, Trajectory]) -> None:
    estimate, truth = walk
    plain, scaled = ate(estimate, truth), ate(monocular(estimate), truth)
    assert said_scales({"a": plain}) == ""
    assert said_scales({"a": scaled}) == f" – up to scale, aligned by Sim(3): × {scaled.scale:.4g}"
    assert said_scales({"a": plain, "b": scaled}).endswith(f"Sim(3): b × {scaled.scale:.4g}")


def test_a_file_says_it_and_is_read_so(tmp_path: Path, walk: tuple[Trajectory, Trajectory]) -> None:
    estimate, truth = walk
    monocular(estimate).write_tum(tmp_path / "mono.tum")
    estimate.write_tum(tmp_path / "metric.tum")
    assert not read_tum(tmp_path / "mono.tum").is_metric
    assert read_tum(tmp_path / "metric.tum").is_metric
    text = (tmp_path / "mono.tum").read_text(encoding="utf-8")
    assert text.startswith("# up to scale")
    assert "scale" not in (tmp_path / "metric.tum").read_text(encoding="utf-8")
    np.testing.assert_allclose(np.loadtxt(tmp_path / "mono.tum")[:, 1:4], UNIT * estimate.positions_m, atol=1e-6)
    judged = evaluate_files(tmp_path / "mono.tum", Truth(truth), None)
    assert judged.evaluation.alignment is Alignment.SIM3


def by(path: Path, truth: Trajectory, alignment: Alignment | None) -> Evaluation:
    return evaluate_files(path, Truth(truth), None, alignment=alignment).evaluation


def test_another_systems_file_is_aligned_as_asked(
    tmp_path: Path, walk: tuple[Trajectory, Trajectory], caplog: pytest.LogCaptureFixture
) -> None:
    estimate, truth = walk
    estimate.scaled(UNIT).write_tum(tmp_path / "theirs.txt")  # nothing in it says that it is monocular
    assert by(tmp_path / "theirs.txt", truth, None).alignment is Alignment.SE3
    asked = by(tmp_path / "theirs.txt", truth, Alignment.SIM3)
    assert asked.as_given.ate_m.rmse == pytest.approx(ate(*walk).sim3_m.rmse, rel=1e-4)
    assert not caplog.records
    monocular(estimate).write_tum(tmp_path / "ours.tum")
    assert by(tmp_path / "ours.tum", truth, Alignment.SE3).alignment is Alignment.SE3
    assert "up to scale" in caplog.text
