"""`stillroom bench paper` on a few rendered frames: every table and figure is there, and evo finds the same errors."""

import csv
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from evo.core import metrics
from evo.core.trajectory import PoseTrajectory3D
from read_pages import ReadPage
from typer.testing import CliRunner, Result

from stillroom.bench.paper.published import paper
from stillroom.cli.bench import app
from stillroom.data.trajectory import Trajectory, read_tum
from stillroom.evaluation.trajectory_errors import pair

ROOM = "synthetic:walking,frames=40"
NAME = "synthetic-walking-frames-40"
OC_FIGURES = ("3_detections", "5_features", "7_clusters", "9_removal", "10_errors", "11_12_maps")
PSPNET_FIGURES = ("5_6_geometry", "7_8_trajectories")


@dataclass(frozen=True)
class Made:
    """What a command left behind."""

    result: Result
    folder: Path

    @property
    def rows(self) -> list[dict[str, Any]]:
        rows: list[dict[str, Any]] = json.loads((self.folder / "paper.json").read_text(encoding="utf-8"))["rows"]
        return rows

    def table(self, title: str) -> list[list[str]]:
        with (self.folder / f"paper_{title}.csv").open(encoding="utf-8", newline="") as file:
            return list(csv.reader(file))


def make(folder: Path, name: str, *more: str) -> Made:
    arguments = ["paper", name, "--runs", "1", "--out", str(folder), "--table", "csv", *more]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    return Made(result, folder)


@pytest.fixture(scope="module")
def oc(tmp_path_factory: pytest.TempPathFactory) -> Made:
    folder = tmp_path_factory.mktemp("oc") / "made"
    return make(folder, "oc-slam", "--sequences", ROOM, "--set", "semantics.kind=truth", "--format", "pdf")


@pytest.fixture(scope="module")
def pspnet(tmp_path_factory: pytest.TempPathFactory) -> Made:
    folder = tmp_path_factory.mktemp("pspnet") / "made"
    return make(folder, "pspnet-slam", "--sequences", f"{ROOM},no_such_room", "--set", "semantics.kind=truth")


def pictures(made: Made, names: list[str]) -> dict[str, np.ndarray]:
    assert sorted(path.stem for path in (made.folder / "figures").glob("*.png")) == sorted(names)
    found = {name: cv2.imread(str(made.folder / "figures" / f"{name}.png")) for name in names}
    for name, picture in found.items():
        assert picture is not None, name
        assert picture.std() > 5, f"{name} shows nothing"
    return found


def test_every_figure_of_oc_slam_is_drawn(oc: Made) -> None:
    found = pictures(oc, [f"figure_{name}_{NAME}" for name in OC_FIGURES])
    two_frames = found[f"figure_5_features_{NAME}"]
    assert two_frames.shape == found[f"figure_3_detections_{NAME}"].shape
    assert two_frames.shape[1] > 2 * 780
    # People stand in the dense map in the middle, and are gone from the one at the right.
    maps = found[f"figure_11_12_maps_{NAME}"]
    third = maps.shape[1] // 3
    assert np.abs(maps[:, third : 2 * third].astype(int) - maps[:, 2 * third : 3 * third]).mean() > 2
    for name in ("10_errors", "11_12_maps"):
        assert (oc.folder / "figures" / f"figure_{name}_{NAME}.pdf").read_bytes().startswith(b"%PDF")


def test_every_figure_of_pspnet_slam_is_drawn(pspnet: Made) -> None:
    pictures(pspnet, [*(f"figure_{name}_{NAME}" for name in PSPNET_FIGURES), "figure_9_bars"])


@pytest.mark.parametrize("name", ["oc", "pspnet"])
def test_the_page_shows_the_tables_and_every_figure(request: pytest.FixtureRequest, name: str) -> None:
    made: Made = request.getfixturevalue(name)
    page = ReadPage(made.folder / "paper.html")
    assert page.asks_the_network == []
    assert len(page.pictures) == len(list((made.folder / "figures").glob("*.png")))
    assert len(page.captions) == len(page.pictures)
    assert page.n_bytes < 15e6
    assert "Table 1" in page.text


def evo_errors(estimate: Trajectory, truth: Trajectory) -> dict[str, float]:
    reference, other = (
        PoseTrajectory3D(poses_se3=list(one.T_world_cam.copy()), timestamps=one.timestamps_s)
        for one in pair(estimate, truth)[::-1]
    )
    other.align(reference, correct_scale=False)
    metric = metrics.APE(metrics.PoseRelation.translation_part)
    metric.process_data((reference, other))
    statistics: dict[str, float] = metric.get_all_statistics()
    return statistics


@pytest.mark.parametrize("name", ["oc", "pspnet"])
def test_evo_finds_the_same_errors_in_the_trajectories(request: pytest.FixtureRequest, name: str) -> None:
    made: Made = request.getfixturevalue(name)
    folder = made.folder / "trajectories" / NAME
    truth = read_tum(folder / "groundtruth.tum")
    systems = [row["method"] for row in made.rows if row.get("runs")]
    assert systems == list(paper(f"{name}-slam").systems)
    for row in (row for row in made.rows if row.get("runs")):
        theirs = evo_errors(read_tum(folder / f"{row['method']}_seed0.tum"), truth)
        ours = row["runs"][0]["evaluation"]["as_given"]["ate_se3_m"]
        for statistic in ("rmse", "mean", "median", "min", "max"):
            assert ours[statistic] == pytest.approx(theirs[statistic], abs=1e-6)


def test_oc_slams_table_has_the_figures_of_the_runs(oc: Made) -> None:
    errors = {row["method"]: row["runs"][0]["evaluation"]["as_given"]["ate_se3_m"] for row in oc.rows}
    for system in ("oc-slam", "oc-slam-paper"):
        header, ours, printed = oc.table(f"Table-1-proposed-{system}")
        cells = dict(zip(header, ours, strict=True))
        for name in ("rmse", "mean", "median"):
            column = "RMSE" if name == "rmse" else name
            assert cells[f"ORB {column}"] == f"{errors['orb-slam2'][name]:.4f}"
            assert cells[f"OC {column}"] == f"{errors[system][name]:.4f}"
            gain = (1 - errors[system][name] / errors["orb-slam2"][name]) * 100
            assert cells[f"gain {column}"] == f"{gain:.1f} %"
        assert printed == ["", "printed", *["–"] * 9]
    times = {row[0]: row for row in oc.table("Time-of-a-frame-ms")}
    assert times["OC-SLAM"][-1] == "97"
    assert times["DynaSLAM"][-1] == "195"
    for row in oc.rows:
        assert times[row["method"]][2] == f"{row['frame_cpu_ms']['median']:.1f}"
        assert row["frame_cpu_ms"]["median"] > 0.5


def test_loop_closing_is_told_both_ways(oc: Made) -> None:
    lines = oc.table("All-runs-RMSE-of-the-ATE-m")[1:]
    assert [line[1] for line in lines] == [
        "orb-slam2", "orb-slam2, loops off", "oc-slam-paper", "oc-slam-paper, loops on", "oc-slam", "oc-slam, loops off"
    ]  # fmt: skip
    for own, other in zip(lines[::2], lines[1::2], strict=True):
        assert own[2:6] == other[2:6], "no loop was closed in so few frames"
        assert own[9] == other[9] == "0"
    for row in oc.rows:
        assert row["loops_enabled"] == (row["method"] != "oc-slam-paper")
        assert row["with_loops_the_other_way"]["ate_se3_m"]["n_runs"] == 1
        assert row["still_camera_m"] > 0.1


def test_pspnet_slams_table_has_the_figures_of_the_runs_and_what_was_not_run(pspnet: Made) -> None:
    systems = paper("pspnet-slam").systems
    errors = {row["method"]: row["ate_se3_m"]["median"] for row in pspnet.rows if row.get("runs")}
    header, ours, printed, less, missing, *_ = pspnet.table("Table-1-RMSE-of-the-ATE-m")
    assert header == ["sequence", "figures", *systems]
    assert ours[2:] == [f"{errors[system]:.4f}" for system in systems]
    assert printed[2:] == ["–"] * len(systems)
    base = errors["orb-slam2"]
    assert less[2:] == ["–", *(f"{(1 - errors[system] / base) * 100:.1f} %" for system in systems[1:])]
    assert missing == ["no_such_room", "ours", *["not run"] * len(systems)]
    assert "no_such_room: not run: no_such_room: no such folder or archive" in pspnet.result.stdout


def test_table_2_has_what_the_geometries_took(pspnet: Made) -> None:
    rows = {(row["test"], row["search"]): row for row in pspnet.rows if "test" in row}
    _, ours, _, missing, _ = pspnet.table("Table-2-geometry-of-an-image-ms")
    for place, test in ((2, "multi-view depth"), (5, "projected points")):
        row = rows[test, "ants"]
        every, path = row["exhaustive_s"] + row["exhaustive_growing_s"], row["search_s"] + row["growing_s"]
        ms = [f"{seconds / row['n_images'] * 1e3:.2f}" for seconds in (every, path)]
        assert ours[place : place + 3] == [*ms, f"{path / every:.2f}"]
    assert missing[2:] == ["not run"] * 6


def test_without_the_papers_sequences_nothing_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STILLROOM_DATA", str(tmp_path / "empty"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    made = make(tmp_path / "made", "pspnet-slam")
    assert made.rows == []
    for sequence in paper("pspnet-slam").sequences:
        assert f"'stillroom download tum/freiburg3_{sequence}' fetches it" in made.result.stdout
    lines = made.table("Table-1-RMSE-of-the-ATE-m")
    by_sequence = {ours[0]: (ours, printed) for ours, printed in zip(lines[1::3], lines[2::3], strict=True)}
    header = lines[0]
    ours, printed = by_sequence["walking_rpy"]
    assert ours[2:] == ["not run"] * 8
    assert printed[header.index("ds-slam")] == "0.0442*"
    assert printed[header.index("zhang-slam")] == "–"
    assert printed[header.index("pspnet-slam")] == "0.025"
    assert "0.4442 in DS-SLAM's own paper" in made.result.stdout
    assert made.table("Table-2-geometry-of-an-image-ms")[2] == [
        "",
        "printed",
        "175.42",
        "143.11",
        "0.82",
        "–",
        "–",
        "–",
    ]


def test_a_folder_with_something_in_it_is_refused(tmp_path: Path) -> None:
    (tmp_path / "note.txt").touch()
    result = CliRunner().invoke(app, ["paper", "oc-slam", "--out", str(tmp_path)])
    assert result.exit_code != 0
    assert "is not empty" in str(result.exception)
