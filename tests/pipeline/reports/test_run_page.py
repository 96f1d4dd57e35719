"""The report of a run, read back: its figures are those of metrics.json, and nothing is fetched."""

import json
import logging
import shutil
import signal
import sys
from base64 import b64decode
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from read_pages import ReadPage

from stillroom.config import SlamConfig
from stillroom.data.image import RgbdImage
from stillroom.datasets.selection import Selected, select
from stillroom.errors import FrameError, StillroomError
from stillroom.evaluation.report import as_text, values
from stillroom.evaluation.report_file import from_json
from stillroom.pipeline import RunOptions, RunOutcome, evaluate_folder, run
from stillroom.pipeline.reports.finished import read_finished
from stillroom.pipeline.reports.run_page import write_run_page
from stillroom.pipeline.run import Silent
from stillroom.protocols import Dataset

MOST_BYTES = 15_000_000


def page_of(folder: Path) -> ReadPage:
    return ReadPage(folder / "report.html")


def metrics_of(folder: Path) -> dict[str, Any]:
    figures: dict[str, Any] = json.loads((folder / "metrics.json").read_text(encoding="utf-8"))
    return figures


@pytest.fixture
def copied(four: dict[str, Path], tmp_path: Path) -> Path:
    """A results folder to damage."""
    return shutil.copytree(four["oc-slam"], tmp_path / "copied")


def test_the_numbers_are_those_of_metrics_json(four: dict[str, Path]) -> None:
    for folder in four.values():
        page, figures = page_of(folder), metrics_of(folder)
        given, own = figures["as_given"], figures["run"]
        wanted = [given["ate_se3_m"]["rmse"], given["rpe_1s"]["translation_m"]["rmse"], figures["coverage"]]
        wanted += [own["frame_ms"]["wall_median_ms"], own["n_keyframes"]]
        errors = [given["ate_se3_m"], given["ate_sim3_m"]]
        errors += [
            given[kind][what] for kind in ("rpe_1s", "rpe_30_frames") for what in ("translation_m", "rotation_deg")
        ]
        errors += [given["smoothness"][what] for what in ("slow_m", "fast_m", "jitter_m", "jitter_deg")]
        wanted += [one[name] for one in errors for name in ("rmse", "mean", "median", "std", "min", "max")]
        assert page.numbers == wanted


def test_it_is_in_the_words_of_the_printed_summary(four: dict[str, Path]) -> None:
    folder = four["oc-slam"]
    page, figures = page_of(folder), metrics_of(folder)
    printed = as_text(from_json((folder / "metrics.json").read_text(encoding="utf-8")))
    for line in printed.splitlines():
        assert " ".join(line.split()) in page.text
    own = figures["run"]
    assert f"map: {own['n_keyframes']} keyframes, {own['n_points']} points; a frame took " in page.text
    assert "oc-slam on synthetic_walking_sway_office_45_seed0" in page.text
    assert (folder / "config.toml").read_text(encoding="utf-8").split() == page.text[
        page.text.index('method = "oc-slam"') : page.text.index("How it came about")
    ].split()


def test_all_is_inside_and_it_is_not_too_large(four: dict[str, Path]) -> None:
    for folder in four.values():
        page = page_of(folder)
        assert page.asks_the_network == []
        assert page.n_bytes < MOST_BYTES
        files = list((folder / "pictures").glob("*.png"))
        drawn = {"trajectory_above.png", "trajectory_over_time.png", "error.png"}  # these can be zoomed in the page
        assert len(page.pictures) == len({path.name for path in files} - drawn) > 2
        for address in page.pictures:
            picture = cv2.imdecode(np.frombuffer(b64decode(address.partition(",")[2]), np.uint8), cv2.IMREAD_COLOR)
            assert picture is not None
    assert "dense map" in page_of(four["oc-slam"]).captions
    assert "dense map" not in page_of(four["orb-slam2"]).captions


def test_a_run_without_truth_says_so(room: Dataset, tmp_path: Path) -> None:
    class Untrue(Selected):
        groundtruth = None
        groundtruth_at_camera = None

    run(Untrue(room, np.arange(6)), SlamConfig(), RunOptions(folder=tmp_path / "out", pictures=0))
    page = page_of(tmp_path / "out")
    assert "6 of 6 frames tracked (100.0 %); no ground truth to compare with" in page.text
    assert "In plan view" in page.text
    assert "Error over time" not in page.text


def test_a_run_that_was_stopped_has_the_report_of_what_there_is(room: Dataset, tmp_path: Path) -> None:
    class Impatient(Silent):
        n = 0

        def frame(self, result: object) -> None:
            self.n += 1
            if self.n == 9:
                signal.raise_signal(signal.SIGINT)

    outcome = run(room, SlamConfig(), RunOptions(folder=tmp_path / "out", pictures=0), Impatient())
    assert outcome.interrupted
    assert outcome.report == tmp_path / "out" / "report.html"
    page = page_of(tmp_path / "out")
    assert "the run was stopped before the last image" in page.text
    assert "stopped after 9 images; the figures are of these" in page.text
    assert metrics_of(tmp_path / "out")["as_given"]["ate_se3_m"]["rmse"] in page.numbers


def test_what_was_warned_of_is_in_it_and_stays(room: Dataset, tmp_path: Path) -> None:
    class Damaged(Selected):
        def load(self, index: int) -> RgbdImage:
            if index == 3:
                raise FrameError("frame3.png: does not decode")
            return super().load(index)

    options = RunOptions(folder=tmp_path / "out", pictures=0, warned=("said before the run",))
    outcome = run(Damaged(room, np.arange(6)), SlamConfig(), options)
    told = ["said before the run", "image 3 is left out: frame3.png: does not decode"]
    assert outcome.warnings == told
    assert (tmp_path / "out" / "warnings.txt").read_text(encoding="utf-8").splitlines() == told
    (tmp_path / "out" / "report.html").unlink()
    write_run_page(tmp_path / "out")
    text = page_of(tmp_path / "out").text
    assert all(warning in text for warning in told)
    assert "not tracked, as they could not be read: 1 image" in text
    assert read_finished(tmp_path / "out").lost_s() == [pytest.approx((0.1, 4 / 30), abs=1e-5)]


def test_a_report_that_cannot_be_written_is_one_warning(
    room: Dataset, tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "bokeh.plotting", None)
    with caplog.at_level(logging.WARNING):
        outcome = run(select(room, ":4"), SlamConfig(), RunOptions(folder=tmp_path / "out", pictures=0))
    [warning] = caplog.messages
    assert warning.startswith("the report is left out: ")
    assert outcome.report is None
    assert not (tmp_path / "out" / "report.html").exists()
    assert metrics_of(tmp_path / "out")["n_tracked"] == 4


def test_who_wants_no_report_gets_none(room: Dataset, tmp_path: Path) -> None:
    with_it, without = RunOptions(folder=tmp_path / "a", pictures=0), RunOptions(folder=tmp_path / "b", pictures=0)
    outcomes = [run(select(room, ":4"), SlamConfig(), each) for each in (with_it, replace(without, report=False))]
    assert [outcome.report for outcome in outcomes] == [tmp_path / "a" / "report.html", None]
    names = [{path.name for path in (tmp_path / name).iterdir()} for name in ("a", "b")]
    assert names[0] - names[1] == {"report.html"}
    for name in ("trajectory.tum", "trajectory_online.tum", "keyframes.tum", "frames.csv"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_an_evaluation_brings_the_report_up_to_date(copied: Path, four: dict[str, Path]) -> None:
    judged = evaluate_folder(copied, baseline=four["orb-slam2"])
    page = page_of(copied)
    assert "improvement over orb-slam2 in RMSE" in page.text
    assert {number for row in values(judged.evaluation) for number in row} <= set(page.numbers)


def test_what_is_missing_is_said(copied: Path) -> None:
    (copied / "timing.csv").unlink()
    (copied / "frames.csv").write_text("frame,state\n0,ok\n", encoding="utf-8")
    (copied / "metrics.json").write_text("[]", encoding="utf-8")
    (copied / "pictures" / "dense_map.png").write_bytes(b"half a picture")
    page = ReadPage(write_run_page(copied))
    said = page.text[page.text.index("Not in this report") :]
    assert "figures: the file is damaged (no figures)" in said
    assert "time of each stage: " in said
    assert "No such file or directory" in said
    assert "states and counts: the file is damaged" in said
    assert "Time of each stage" not in page.text
    assert "Error over time" in page.text
    assert "dense map" not in page.captions


def test_figures_of_another_version_cost_only_what_is_not_in_them(copied: Path) -> None:
    figures = metrics_of(copied)
    figures["run"] = {"n_keyframes": 7}
    (copied / "metrics.json").write_text(json.dumps(figures), encoding="utf-8")
    page = ReadPage(write_run_page(copied))
    assert "figures of the run itself: the file is damaged ('interrupted')" in page.text
    assert figures["as_given"]["ate_se3_m"]["rmse"] in page.numbers
    assert page.numbers[3] == 7


def test_a_folder_with_its_poses_alone_has_a_page(copied: Path, tmp_path: Path) -> None:
    (tmp_path / "bare").mkdir()
    shutil.copy(copied / "trajectory.tum", tmp_path / "bare")
    page = ReadPage(write_run_page(tmp_path / "bare", tmp_path / "page.html"))
    assert page.text.startswith("bare on –")
    assert "In plan view" in page.text


def test_what_is_no_results_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(StillroomError, match=r"none of config\.toml, metrics\.json, trajectory\.tum in it"):
        write_run_page(tmp_path)
    with pytest.raises(StillroomError, match="no such results folder"):
        write_run_page(tmp_path / "nowhere")


def test_a_finished_run_of_the_other_tests_has_a_report(finished: RunOutcome) -> None:
    assert finished.report is not None
    assert finished.folder is not None
    assert page_of(finished.folder).numbers
