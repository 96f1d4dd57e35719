"""A disk that fills up while a run writes: each file is the old one or the new one, and pictures end nothing."""

import json
import logging
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from full_disk import FullDisk

from stillroom.config import SlamConfig
from stillroom.data.dense_cloud import load_cloud
from stillroom.data.trajectory import read_tum
from stillroom.datasets.selection import select
from stillroom.dense.dense_mapper import DenseMapperConfig
from stillroom.errors import StillroomError
from stillroom.pipeline import RunOptions, RunOutcome, evaluate_folder, results, run
from stillroom.pipeline.results import Truth, write_results
from stillroom.protocols import Dataset

OLD = "# timestamp tx ty tz qx qy qz qw\n1.000000 0 0 0 0 0 0 1\n"
NAMES = ("trajectory.tum", "trajectory_online.tum", "keyframes.tum", "metrics.json", "frames.csv", "groundtruth.tum")
NAMES = (*NAMES, "timing.csv", "dense_cloud.npz", "cloud.ply")


@pytest.fixture(scope="module")
def tracked(room: Dataset) -> RunOutcome:
    """A short run with a dense map."""
    config = replace(SlamConfig(), dense=DenseMapperConfig())
    return run(select(room, ":3"), config, RunOptions(root=None, pictures=0))


def test_every_file_is_the_old_one_or_the_new_one(
    tracked: RunOutcome, room: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whichever write is the first that finds no room."""
    monkeypatch.setattr(results, "peak_memory_mb", lambda: 100.0)  # or no two writes would give the same bytes
    truth, whole = Truth.of(room), tmp_path / "whole"
    whole.mkdir()
    with FullDisk(tmp_path, float("inf")).mounted() as disk:
        write_results(whole, tracked, truth)
    assert {path.name for path in whole.iterdir()} == set(NAMES)
    new = {name: (whole / name).read_bytes() for name in NAMES}
    assert disk.n_tried > len(NAMES)
    for n in range(disk.n_tried):
        folder = tmp_path / str(n)
        folder.mkdir()
        for name in NAMES:
            (folder / name).write_text(OLD)
        with (
            FullDisk(tmp_path, n).mounted(),
            pytest.raises(StillroomError, match=r"\[see troubleshooting: disk-full\]"),
        ):
            write_results(folder, tracked, truth)
        assert {path.name for path in folder.iterdir()} == set(NAMES), "what was begun lies about"
        for place, name in enumerate(NAMES):
            found = (folder / name).read_bytes()
            assert found in (OLD.encode(), new[name]), (n, name)
            # One write each: what matters comes first.
            assert place >= 7 or (found == new[name]) == (n > place), (n, name)
        assert len(read_tum(folder / "trajectory.tum")) == (3 if n else 1)
        shutil.rmtree(folder)
    assert len(load_cloud(whole / "dense_cloud.npz")) > 100


def test_one_file_without_room_costs_no_other(tracked: RunOutcome, tmp_path: Path) -> None:
    (tmp_path / "keyframes.tum").mkdir()
    with pytest.raises(StillroomError, match=r"keyframes\.tum: cannot be written"):
        write_results(tmp_path, tracked, None)
    assert json.loads((tmp_path / "metrics.json").read_text(encoding="utf-8"))["n_tracked"] == 3
    assert (tmp_path / "cloud.ply").stat().st_size > 1000


def test_pictures_end_nothing(room: Dataset, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """The disk is full for pictures from the first frame on, or from the third picture on."""
    for n in (0, 2):
        caplog.clear()
        with FullDisk(tmp_path / str(n) / "pictures", n).mounted() as disk, caplog.at_level(logging.WARNING):
            outcome = run(select(room, ":4"), SlamConfig(), RunOptions(folder=tmp_path / str(n), pictures=2))
        [warning] = caplog.messages
        assert "No space left on device" in warning
        assert warning.endswith("[see troubleshooting: pictures]")
        figures = json.loads((tmp_path / str(n) / "metrics.json").read_text(encoding="utf-8"))
        assert figures["run"]["n_pictures_failed"] == outcome.ornaments.n_failed == disk.n_tried - n == 6 - n
        assert len(outcome.pictures) == n
        assert len(list((tmp_path / str(n) / "pictures").iterdir())) == n
        assert len(read_tum(tmp_path / str(n) / "trajectory.tum")) == 4


def test_an_evaluation_has_its_figures_without_its_plots(room: Dataset, tmp_path: Path) -> None:
    run(select(room, ":4"), SlamConfig(), RunOptions(folder=tmp_path / "out", pictures=0))
    (tmp_path / "out" / "pictures").write_text("in the way")
    judged = evaluate_folder(tmp_path / "out")
    assert judged.pictures == ()
    assert judged.evaluation.n_tracked == 4


def test_a_plotting_library_that_does_not_import_ends_nothing(
    room: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "matplotlib", None)
    outcome = run(select(room, ":4"), SlamConfig(), RunOptions(folder=tmp_path / "out", pictures=1))
    assert outcome.ornaments.n_failed == 4
    assert [path.name for path in outcome.pictures] == ["frame_00002.png"]
