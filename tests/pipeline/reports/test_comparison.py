"""Several runs on one page: the table, the names, the ranges, and what is missing."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from read_pages import ReadPage

from stillroom.errors import ConfigError, StillroomError
from stillroom.pipeline.reports import comparison
from stillroom.pipeline.reports.comparison import compare_runs
from stillroom.viz.page.charts import Bar, Path3


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> dict[str, list[Any]]:
    """What the plots of a page were given, in order."""
    given: dict[str, list[Any]] = {"plan_view": [], "errors_over_time": [], "bars": []}
    for name, calls in given.items():
        honest = getattr(comparison.charts, name)

        def noted(*args: Any, honest: Any = honest, calls: list[Any] = calls, **named: Any) -> Any:
            calls.append(args)
            return honest(*args, **named)

        monkeypatch.setattr(comparison.charts, name, noted)
    return given


def test_the_table_has_the_figures_of_every_run(four: dict[str, Path], tmp_path: Path) -> None:
    compared = compare_runs(list(four.values()), tmp_path / "new" / "page.html")
    assert compared.file == tmp_path / "new" / "page.html"
    assert [row[-1] for row in compared.rows] == [folder.name for folder in four.values()]
    for row, folder in zip(compared.rows, four.values(), strict=True):
        cells = dict(zip(compared.header, row, strict=True))
        figures = json.loads((folder / "metrics.json").read_text(encoding="utf-8"))
        given, own = figures["as_given"], figures["run"]
        assert cells["ATE [m]"] == f"{given['ate_se3_m']['rmse']:.4f}"
        assert cells["RPE [m/s]"] == f"{given['rpe_1s']['translation_m']['rmse']:.4f}"
        assert cells["RPE [deg/s]"] == f"{given['rpe_1s']['rotation_deg']['rmse']:.3f}"
        assert cells["ms a frame"] == f"{own['frame_ms']['wall_median_ms']:.1f}"
        assert cells["keyframes"] == str(own["n_keyframes"])
        assert cells["map points"] == str(own["n_points"])
        assert cells["tracked"] == "100.0 %"
        assert cells["seed"] == ("5" if folder.name == "again" else "0")
    page = ReadPage(compared.file)
    assert page.asks_the_network == []
    assert page.n_bytes < 15_000_000
    # Exactly in what the table sorts by, too.
    rmse = json.loads((four["oc-slam"] / "metrics.json").read_text(encoding="utf-8"))["as_given"]["ate_se3_m"]["rmse"]
    assert repr(rmse) in page.scripts


def test_paths_are_aligned_and_named_apart(four: dict[str, Path], tmp_path: Path, drawn: dict[str, list[Any]]) -> None:
    compare_runs(list(four.values()), tmp_path / "page.html")
    [(paths, truth)] = drawn["plan_view"]
    assert [path.name for path in paths] == [
        "orb-slam2, seed 0",
        "oc-slam",
        "oc-slam-paper",
        "dynaslam-g",
        "orb-slam2, seed 5",
    ]
    for path, folder in zip(paths, four.values(), strict=True):
        rmse = json.loads((folder / "metrics.json").read_text(encoding="utf-8"))["as_given"]["ate_se3_m"]["rmse"]
        apart_m = np.linalg.norm(path.positions_m - truth.positions_m, axis=1)
        assert np.sqrt(np.mean(apart_m**2)) == pytest.approx(rmse, abs=2e-6)  # poses in files have six digits
        assert np.allclose(path.errors_m, apart_m)
    [(with_errors, still_m)] = drawn["errors_over_time"]
    assert with_errors == paths
    assert still_m > 0.01


def test_bars_have_the_range_of_a_method_with_several_runs(
    four: dict[str, Path], tmp_path: Path, drawn: dict[str, list[Any]]
) -> None:
    compared = compare_runs(list(four.values()), tmp_path / "page.html")
    found = {xlabel: rows for rows, xlabel, *_ in drawn["bars"]}
    assert list(found) == ["ATE [m]", "RPE [m/s]", "RPE [deg/s]", "ms a frame", "keyframes"]
    bars: dict[str, Bar] = {bar.name: bar for bar in found["ATE [m]"]}
    assert list(bars) == ["orb-slam2", "oc-slam", "oc-slam-paper", "dynaslam-g"]
    place = compared.header.index("ATE [m]")
    ours = sorted(float(row[place]) for row in compared.rows if row[0] == "orb-slam2")
    twice = bars["orb-slam2"]
    assert [twice.low, twice.value, twice.high] == pytest.approx([ours[0], np.mean(ours), ours[1]], abs=1e-4)
    assert twice.note == "2 runs"
    assert (bars["oc-slam"].low, bars["oc-slam"].note) == (None, "1 run")


def test_maps_stand_beside_each_other_and_what_is_missing_is_said(four: dict[str, Path], tmp_path: Path) -> None:
    broken = shutil.copytree(four["dynaslam-g"], tmp_path / "broken")
    (broken / "metrics.json").unlink()
    (broken / "pictures" / "dense_map.png").unlink()
    compared = compare_runs([four["orb-slam2"], four["oc-slam"], broken], tmp_path / "page.html")
    page = ReadPage(compared.file)
    assert page.captions == ["oc-slam"]
    assert len(page.pictures) == 1
    assert "No picture of a dense map: orb-slam2, dynaslam-g." in page.text
    [note] = compared.notes
    assert note.startswith("missing, dynaslam-g (broken): figures: ")
    assert note in page.text
    assert compared.rows[2][compared.header.index("ATE [m]")] == "–"


def test_sequences_are_kept_apart(four: dict[str, Path], tmp_path: Path, drawn: dict[str, list[Any]]) -> None:
    other = shutil.copytree(four["oc-slam"], tmp_path / "other")
    config = (other / "config.toml").read_text(encoding="utf-8")
    (other / "config.toml").write_text(config.replace("synthetic_walking", "another_room"), encoding="utf-8")
    compared = compare_runs([four["orb-slam2"], four["oc-slam"], other], tmp_path / "page.html", ("svg",))
    [note] = compared.notes
    assert note.startswith("the runs are of 2 sequences (synthetic_walking_sway_office_45_seed0, another_room_")
    assert [[path.name for path in paths] for paths, _ in drawn["plan_view"]] == [["orb-slam2", "oc-slam"], ["oc-slam"]]
    page = ReadPage(compared.file)
    assert "oc-slam on 2 sequences" in page.text
    assert "Trajectories on another_room_sway_office_45_seed0" in page.text
    folders = {path.relative_to(tmp_path / "page_plots").parts[0] for path in compared.plots}
    assert folders == {"synthetic_walking_sway_office_45_seed0", "another_room_sway_office_45_seed0"}
    assert {path.suffix for path in compared.plots} == {".png", ".svg"}
    assert all(path.is_file() for path in compared.plots)


def test_runs_without_truth_are_drawn_as_they_are(
    four: dict[str, Path], tmp_path: Path, drawn: dict[str, list[Any]]
) -> None:
    bare = []
    for name in ("oc-slam", "orb-slam2"):
        bare.append(shutil.copytree(four[name], tmp_path / name))
        (bare[-1] / "groundtruth.tum").unlink()
    compared = compare_runs(bare, tmp_path / "page.html", ("pdf",))
    [(paths, truth)] = drawn["plan_view"]
    assert truth is None
    assert all(isinstance(path, Path3) and path.errors_m is None for path in paths)
    assert drawn["errors_over_time"] == []
    assert compared.plots == ()
    assert "Without ground truth" in ReadPage(compared.file).text


def test_a_run_that_nothing_aligns_is_left_out_of_the_plan(
    four: dict[str, Path], tmp_path: Path, drawn: dict[str, list[Any]]
) -> None:
    bare = shutil.copytree(four["orb-slam2"], tmp_path / "bare")
    (bare / "groundtruth.tum").unlink()
    compared = compare_runs([bare, four["oc-slam"]], tmp_path / "page.html")
    [(paths, truth)] = drawn["plan_view"]
    assert [path.name for path in paths] == ["oc-slam"]
    assert truth is not None
    assert "Not drawn, as nothing aligns it with the ground truth: orb-slam2." in ReadPage(compared.file).text


def test_two_runs_at_least_and_results_only(four: dict[str, Path], tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="two runs at least"):
        compare_runs([four["oc-slam"]], tmp_path / "page.html")
    with pytest.raises(StillroomError, match="is it the folder of a run"):
        compare_runs([four["oc-slam"], tmp_path], tmp_path / "page.html")
    (tmp_path / "file").touch()
    with pytest.raises(StillroomError, match="cannot be written"):
        compare_runs([four["oc-slam"], four["orb-slam2"]], tmp_path / "file" / "page.html")
