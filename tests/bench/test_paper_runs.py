"""Which sequences a paper's tables are of, and which runs they need."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from stillroom.bench.accuracy import Accuracy
from stillroom.bench.paper.published import paper
from stillroom.bench.paper.runs import SequenceRuns, run_system
from stillroom.bench.paper.sequences import sequences_of
from stillroom.bench.paper.tables import OC_HEADER, tables_of
from stillroom.bench.trial import Trial, attempt, poses_only
from stillroom.config import SlamConfig
from stillroom.data.trajectory import Trajectory
from stillroom.datasets.open import open_dataset
from stillroom.datasets.selection import select
from stillroom.errors import StillroomError
from stillroom.evaluation.report import evaluate
from stillroom.evaluation.timing import StageClock
from stillroom.presets.registry import configure


def test_the_papers_sequences_are_found_as_folder_and_as_archive(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STILLROOM_DATA", str(tmp_path))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    (tmp_path / "rgbd_dataset_freiburg3_walking_xyz").mkdir()
    (tmp_path / "rgbd_dataset_freiburg3_sitting_static.tgz").touch()
    found = {one.name: one for one in sequences_of(paper("oc-slam"))}
    assert list(found) == list(paper("oc-slam").sequences)
    assert all(one.printed == name for name, one in found.items())
    assert found["walking_xyz"].source == "rgbd_dataset_freiburg3_walking_xyz"
    assert found["sitting_static"].source == "rgbd_dataset_freiburg3_sitting_static.tgz"
    assert found["walking_static"].source is None
    assert "'stillroom download tum/freiburg3_walking_static'" in found["walking_static"].missing
    assert found["walking_xyz"].missing == ""


def test_others_in_their_place_have_no_printed_cells_unless_they_are_the_papers_own() -> None:
    texts = ["synthetic:walking,frames=40", "rgbd_bonn_crowd_first560", "/data/rgbd_dataset_freiburg3_walking_rpy.tgz"]
    texts.append("rgbd_dataset_freiburg3_office")
    found = sequences_of(paper("pspnet-slam"), texts)
    assert [one.source for one in found] == texts
    assert [one.name for one in found] == [texts[0], "bonn_crowd_first560", "walking_rpy", "freiburg3_office"]
    assert [one.printed for one in found] == [None, None, "walking_rpy", None]


def trial_of(error_m: float, n_jumps: int = 0) -> Trial:
    """A run that swings around the truth by this much."""
    times_s = np.arange(40) / 30
    T = np.tile(np.eye(4), (40, 1, 1))
    T[:, 0, 3] = times_s
    estimate = T.copy()
    estimate[:, 1, 3] = error_m * (-1.0) ** np.arange(40)
    trajectory = Trajectory(times_s, estimate)
    evaluation = evaluate(trajectory, Trajectory(times_s, T), n_given=40)
    clock = StageClock()
    return Trial(0, 40, 40, evaluation, None, None, None, clock, trajectory=trajectory, n_jumps=n_jumps)


def measuring(error_m: Callable[[SlamConfig], float], n_jumps: int) -> tuple[list[bool], Callable[..., Accuracy]]:
    asked: list[bool] = []

    def measure(name: str, config: SlamConfig) -> Accuracy:
        asked.append(config.loops.enabled)
        return Accuracy("room", name, (trial_of(error_m(config), n_jumps),))

    return asked, measure


@pytest.mark.parametrize("system", ["orb-slam2", "oc-slam-paper"])
def test_a_run_in_which_a_loop_moved_the_map_is_made_again_without(system: str) -> None:
    asked, measure = measuring(lambda config: 0.01 if config.loops.enabled else 0.02, n_jumps=2)
    runs = run_system(system, configure(system), measure, both_loops=True)
    assert asked == [True, False]
    assert not runs.is_same
    closes = system == "orb-slam2"
    assert runs.has_loops == closes
    assert runs.accuracy is not None
    assert runs.other is not None
    assert runs.accuracy.ate_m is not None
    assert runs.accuracy.ate_m.median == pytest.approx(0.01 if closes else 0.02, rel=1e-3)
    assert runs.without_loops.accuracy is not None
    assert runs.without_loops.accuracy.ate_m is not None
    assert runs.without_loops.accuracy.ate_m.median == pytest.approx(0.02, rel=1e-3)


def test_a_run_without_a_loop_serves_for_both() -> None:
    asked, measure = measuring(lambda config: 0.01, n_jumps=0)
    runs = run_system("oc-slam", configure("oc-slam"), measure, both_loops=True)
    assert asked == [True]
    assert runs.is_same
    assert runs.other == runs.accuracy


def test_without_a_jump_loop_closing_changes_no_byte() -> None:
    """What that sharing rests on."""
    dataset = select(open_dataset("synthetic:walking,frames=40"), ":40")
    config = poses_only(configure("orb-slam2"))
    closing = attempt(dataset, config, 0)
    open_ended = attempt(dataset, poses_only(configure("orb-slam2", None, ["loops.enabled=false"])), 0)
    assert closing.n_jumps == 0
    assert closing.trajectory is not None
    assert open_ended.trajectory is not None
    assert closing.trajectory.T_world_cam.tobytes() == open_ended.trajectory.T_world_cam.tobytes()


def test_what_is_absent_is_not_run_and_says_why() -> None:
    def measure(name: str, config: SlamConfig) -> Accuracy:
        raise StillroomError("network.onnx: not there")

    runs = run_system("dynaslam", configure("dynaslam"), measure, both_loops=False)
    assert runs.accuracy is None
    assert runs.why_not == "dynaslam: not run: network.onnx: not there"
    assert runs.to_dict("room", None) == {"sequence": "room", "method": "dynaslam", "not_run": runs.why_not}


@pytest.mark.parametrize("system", ["orb-slam2", "oc-slam-paper"])
def test_runs_with_loops_stay_where_those_without_fail(system: str) -> None:
    def measure(name: str, config: SlamConfig) -> Accuracy:
        if not config.loops.enabled:
            raise StillroomError("no memory")
        return Accuracy("room", name, (trial_of(0.01, n_jumps=2),))

    runs = run_system(system, configure(system), measure, both_loops=True)
    assert runs.why_not == f"{system}, without loops: not run: no memory"
    looped = runs.accuracy if runs.has_loops else runs.other
    assert looped is not None
    assert looped.ate_m is not None
    assert runs.without_loops.accuracy is None
    found = SequenceRuns(sequences_of(paper("oc-slam"), ["synthetic:walking"])[0], {system: runs})
    shown = [row for table in tables_of(paper("oc-slam"), [found]) for row in table.rows if system in row[1]]
    assert any(f"{looped.ate_m.median:.4f}" in row for row in shown)


def test_the_table_has_the_errors_of_both_and_the_gains() -> None:
    oc = paper("oc-slam")
    asked = sequences_of(oc, ["rgbd_dataset_freiburg3_walking_xyz"])[0]
    systems = {}
    for system, error_m in (("orb-slam2", 0.4), ("oc-slam-paper", 0.1), ("oc-slam", 0.02)):
        measure = measuring(lambda config, error_m=error_m: error_m, n_jumps=0)[1]
        systems[system] = run_system(system, configure(system), measure, both_loops=True)
    tables = {table.title: table for table in tables_of(oc, [SequenceRuns(asked, systems)])}
    ours, printed = (dict(zip(OC_HEADER, row, strict=True)) for row in tables["Table 1, proposed: oc-slam"].rows)
    assert (ours["sequence"], printed["sequence"]) == ("walking_xyz", "")
    for name, error_m in (("ORB", 0.4), ("OC", 0.02)):
        evaluation = trial_of(error_m).evaluation
        assert evaluation is not None
        errors_m = evaluation.as_given.ate_se3_m
        assert ours[f"{name} RMSE"] == f"{errors_m.rmse:.4f}"
        assert ours[f"{name} mean"] == f"{errors_m.mean:.4f}"
        assert ours[f"{name} median"] == f"{errors_m.median:.4f}"
    assert ours["gain RMSE"] == ours["gain median"] == "95.0 %"
    assert [printed[name] for name in OC_HEADER[2:]] == [
        "0.756", "0.655", "0.653", "0.129", "0.119", "0.118", "84.1 %*", "81.7 %", "81.9 %"
    ]  # fmt: skip
    notes = tables["All runs, RMSE of the ATE [m]"].notes
    assert "* a misprint: OC-SLAM on walking_xyz, an improvement of 84.1 %: 0.129 against 0.756 is 82.9 %" in notes
    assert not any("walking_halfsphere" in note for note in notes)


def test_where_loops_moved_the_map_the_table_has_both_systems_without_loops_too() -> None:
    oc = paper("oc-slam")
    asked = sequences_of(oc, ["rgbd_bonn_crowd_first560"])[0]
    systems = {}
    for system, error_m in (("orb-slam2", 0.1), ("oc-slam-paper", 0.1), ("oc-slam", 0.02)):
        measure = measuring(lambda config, error_m=error_m: error_m * (1 if config.loops.enabled else 4), n_jumps=2)[1]
        systems[system] = run_system(system, configure(system), measure, both_loops=True)
    tables = {table.title: table for table in tables_of(oc, [SequenceRuns(asked, systems)])}
    of_letter, of_ours = (tables[f"Table 1, proposed: {system}"].rows for system in oc.proposed)
    for rows in (of_letter, of_ours):
        assert [row[1] for row in rows] == ["ours", "no loops", "printed"]
    cells = [[float(cell) for cell in row[2::3][:2]] for rows in (of_letter, of_ours) for row in rows[:2]]
    # The letter closes no loops by itself.
    expected = [[0.1, 0.4], [0.4, 0.4], [0.1, 0.02], [0.4, 0.08]]
    np.testing.assert_allclose(cells, expected, rtol=0.01)


def test_no_minus_stands_before_nothing() -> None:
    pspnet = paper("pspnet-slam")
    asked = sequences_of(pspnet, ["rgbd_bonn_crowd_first560"])[0]
    systems = {}
    for system, error_m in (("orb-slam2", 0.1), ("ds-slam", 0.10001)):
        measure = measuring(lambda config, error_m=error_m: error_m, n_jumps=0)[1]
        systems[system] = run_system(system, configure(system), measure, both_loops=False)
    table = tables_of(pspnet, [SequenceRuns(asked, systems)])[0]
    ours, printed, less = (dict(zip(table.header, row, strict=True)) for row in table.rows)
    assert less["ds-slam"] == "0.0 %"
    assert ours["sof-slam"] == less["sof-slam"] == "not run"
    assert printed["ds-slam"] == "–"
