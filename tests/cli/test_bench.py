"""`stillroom bench` on a few rendered frames, and its figures against plain arithmetic."""

import csv
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from building import parts
from read_pages import ReadPage
from typer.testing import CliRunner, Result

from stillroom.bench import trial as trials
from stillroom.bench.accuracy import Accuracy
from stillroom.bench.page import series_of
from stillroom.bench.rejection import WHOLE_BOXES, Way, sentences, ways
from stillroom.bench.speed import UnitMeter
from stillroom.bench.trial import FrameAverages, Trial, all_keypoints, attempt
from stillroom.cli.bench import app
from stillroom.config import SlamConfig
from stillroom.datasets.open import open_dataset
from stillroom.datasets.selection import select
from stillroom.errors import ConfigError, StillroomError
from stillroom.evaluation.report import evaluate
from stillroom.evaluation.timing import StageClock
from stillroom.pipeline import RunOptions, run
from stillroom.presets import oc_slam_paper
from stillroom.presets.registry import configure, method
from stillroom.semantics.depth_clusters import DepthClustersConfig, NoClustersConfig

ROOM = "synthetic:walking"
FRAMES = "100:124"
N_FRAMES = 24
TRUTH = "semantics.kind=truth"


def invoke(*arguments: str) -> Result:
    return CliRunner().invoke(app, [*arguments, "--frames", FRAMES, "--set", TRUTH])


@pytest.fixture(scope="module")
def accuracy_figures(tmp_path_factory: pytest.TempPathFactory) -> tuple[Result, dict[str, Any]]:
    file = tmp_path_factory.mktemp("bench") / "figures.json"
    result = invoke("accuracy", ROOM, "--runs", "2", "--json", str(file), "--table", "csv,latex,markdown")
    assert result.exit_code == 0, result.output
    for line in result.stdout.splitlines():
        what, _, path = line.partition(": ")
        if what in ("table", "page"):
            assert Path(path).is_file()
    return result, json.loads(file.read_text())


def test_accuracy_has_a_row_for_each_method_and_a_run_for_each_seed(
    accuracy_figures: tuple[Result, dict[str, Any]],
) -> None:
    result, figures = accuracy_figures
    assert [row["method"] for row in figures["rows"]] == ["orb-slam2", "oc-slam"]
    for row in figures["rows"]:
        ates = [one["evaluation"]["as_given"]["ate_se3_m"]["rmse"] for one in row["runs"]]
        assert [one["seed"] for one in row["runs"]] == [0, 1]
        spread = row["ate_se3_m"]
        assert (spread["min"], spread["max"]) == (min(ates), max(ates))
        assert spread["median"] == pytest.approx(np.median(ates))
        assert spread["mean"] == pytest.approx(np.mean(ates))
        line, second = (line for line in result.stdout.splitlines() if line.strip().startswith(row["method"]))
        cells = line.split()
        assert cells[1:5] == [f"{spread[name]:.4f}" for name in ("median", "mean", "min", "max")]
        assert "100.0 %" in line
        costs_ms = [one["frame_cpu_ms"] for one in row["runs"]]
        assert min(costs_ms) > 0.5
        assert second.split()[-1] == f"{np.median(costs_ms):.1f}"
        jitters_m = [one["evaluation"]["as_given"]["smoothness"]["jitter_m"]["rmse"] for one in row["runs"]]
        assert second.split()[1] == f"{1e3 * np.median(jitters_m):.1f}"
    base, ours = (row["ate_se3_m"]["median"] for row in figures["rows"])
    assert figures["rows"][0]["improvement_percent"] is None
    assert figures["rows"][1]["improvement_percent"] == pytest.approx((1 - ours / base) * 100)
    assert figures["run"]["versions"]["stillroom"]


def test_accuracy_gives_the_figures_of_a_run_by_itself(accuracy_figures: tuple[Result, dict[str, Any]]) -> None:
    dataset = select(open_dataset(ROOM), FRAMES)
    outcome = run(dataset, configure("oc-slam", None, [TRUTH], seed=1), RunOptions(root=None))
    alone = evaluate(outcome.system.trajectory(), dataset.groundtruth, n_given=N_FRAMES)
    benched = accuracy_figures[1]["rows"][1]["runs"][1]
    assert benched["evaluation"]["as_given"]["ate_se3_m"]["rmse"] == alone.as_given.ate_se3_m.rmse
    assert benched["n_tracked"] == alone.n_tracked == N_FRAMES


def test_accuracy_writes_a_page_and_tables_with_the_figures_of_its_file(
    accuracy_figures: tuple[Result, dict[str, Any]],
) -> None:
    result, figures = accuracy_figures
    written = [Path(line.partition(": ")[2]) for line in result.stdout.splitlines() if line.startswith("table: ")]
    stem = "figures_synthetic_walking_sway_office_270_seed0"
    names = [path.name for path in written]
    assert names[:3] == [f"{stem}.csv", f"{stem}.tex", f"{stem}.md"]
    assert [name.partition(".")[0] for name in names[3:]] == [f"{stem}-smoothness-and-time"] * 3
    with written[0].open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["method"] for row in rows] == [row["method"] for row in figures["rows"]]
    assert [row["ATE median"] for row in rows] == [f"{row['ate_se3_m']['median']:.4f}" for row in figures["rows"]]
    page = ReadPage(written[0].with_name("figures.html"))
    assert page.asks_the_network == []
    assert "synthetic_walking_sway_office_270_seed0" in page.text
    assert "ATE [m]" in page.text
    bars = series_of(figures["rows"])["ATE [m]"]
    assert [bar.name for bar in bars] == ["orb-slam2", "oc-slam"]
    for bar, row in zip(bars, figures["rows"], strict=True):
        spread = row["ate_se3_m"]
        assert (bar.value, bar.low, bar.high) == (spread["median"], spread["min"], spread["max"])
        assert repr(bar.high) in page.scripts


def test_rejection_prints_a_row_for_each_way_and_counts_what_is_kept(tmp_path: Path) -> None:
    file = tmp_path / "figures.json"
    result = invoke("rejection", ROOM, "--json", str(file))
    assert result.exit_code == 0, result.output
    rows = {row["method"]: row for row in json.loads(file.read_text())["rows"]}
    ways = ["no rejection", "whole boxes", "OC-SLAM 2.2 alone", "OC-SLAM as printed", "… its Eq. 2 too"]
    ways += ["the preset without clusters", "the preset"]
    assert list(rows) == ways
    for name in rows:
        assert any(line.strip().startswith(name) for line in result.stdout.splitlines())
    dataset = select(open_dataset(ROOM), FRAMES)
    features = SlamConfig().features.build(parts(dataset.camera))
    found, outside, boxed = 0, 0, 0
    for place in range(N_FRAMES):
        image = dataset.load(place)
        # The boxes alone: a detector tells no masks.
        boxes = replace(image.truth, mask=None, instances=())
        if boxes.boxes:
            frame = features.extract(image)
            found += len(frame)
            outside += int((~boxes.movable_at(frame.keypoints.raw_px)).sum())
            boxed += 1
    assert boxed > N_FRAMES // 2
    assert rows["no rejection"]["static_kept_per_frame"] == pytest.approx(found / boxed)
    assert rows["no rejection"]["static_kept_share"] == pytest.approx(1.0)
    assert rows["whole boxes"]["static_kept_per_frame"] == pytest.approx(outside / boxed)
    kept = rows["the preset"]["static_kept_per_frame"]
    assert outside / boxed < kept < found / boxed
    more = (kept * boxed / outside - 1) * 100
    assert rows["the preset"]["kept_more_than_whole_boxes_percent"] == pytest.approx(more)
    assert f"it keeps {more:.1f} % more static keypoints" in result.stdout


def test_the_ways_differ_in_the_sieve_and_the_clusters_it_asks_for() -> None:
    preset = all_keypoints(method("oc-slam").config)
    found = ways(method("oc-slam").config)
    assert len({config.dynamics for config in found.values()}) == len(found) == 7
    for name, config in found.items():
        has_clusters = name in ("the preset", "OC-SLAM as printed", "… its Eq. 2 too")
        assert isinstance(config.clusters, DepthClustersConfig if has_clusters else NoClustersConfig)
        as_preset = {part: getattr(preset, part) for part in ("dynamics", "clusters", "semantics")}
        assert replace(config, **as_preset) == preset
    printed = found["OC-SLAM as printed"]
    assert not printed.semantics.carry.enabled
    assert printed.dynamics == oc_slam_paper.METHOD.config.dynamics
    assert found["… its Eq. 2 too"].dynamics.pairs.distance == "printed"


def test_speed_tells_stages_in_units(tmp_path: Path) -> None:
    file = tmp_path / "figures.json"
    result = invoke("speed", ROOM, "--methods", "oc-slam", "--json", str(file))
    assert result.exit_code == 0, result.output
    (row,) = json.loads(file.read_text())["rows"]
    stages = {stage["stage"]: stage for stage in row["stages"]}
    assert {"frame", "features", "tracking", "dynamics", "mapping", "semantics"} <= set(stages)
    assert "loading" not in stages
    frame = stages["frame"]
    assert frame["n_frames"] == row["n_frames"] == N_FRAMES
    assert row["units"] == pytest.approx(frame["cpu_mean_ms"] / row["unit_cpu_ms"])
    assert row["units_by_wall"] == pytest.approx(frame["wall_mean_ms"] / row["unit_wall_ms"])
    names = ("features", "flow", "tracking", "mapping", "semantics", "clusters", "dense", "carving")
    parts_ms = sum(stages[name]["cpu_mean_ms"] * stages[name]["n_frames"] / N_FRAMES for name in names)
    assert parts_ms <= frame["cpu_mean_ms"] < 1.5 * parts_ms
    whole_ms = stages["dense"]["cpu_mean_ms"]
    pieces = [stages[f"dense: {name}"] for name in ("removal", "doubts", "corrections")]
    assert 0 < sum(piece["cpu_mean_ms"] for piece in pieces) < whole_ms
    fusing = stages["dense: fusing"]
    each = fusing["cpu_mean_ms"] / row["unit_cpu_ms"] * N_FRAMES / fusing["n_frames"]
    assert re.search(rf"dense: fusing .*{each:.2f}", result.stdout)
    assert 50 < row["peak_memory_mb"] < 8000
    assert f"oc-slam: {frame['wall_mean_ms']:.1f} ms a frame on average" in result.stdout
    assert f"that is {row['units']:.2f} units a frame" in result.stdout


def test_the_unit_is_one_orb_on_every_few_of_the_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[np.ndarray] = []

    class Orb:
        def detectAndCompute(self, gray: np.ndarray, mask: None) -> None:
            seen.append(gray)

    monkeypatch.setattr(cv2.ORB, "create", lambda features: Orb() if features == 1000 else None)
    room = select(open_dataset(ROOM), "0:7")
    meter = UnitMeter(room, every=3)
    images = [meter.load(place) for place in range(7)]
    assert len(meter.cpu_ms) == len(meter.wall_ms) == 3
    # The first is taken twice: once to allocate.
    for gray, place in zip(seen, (0, 0, 3, 6), strict=True):
        assert np.array_equal(gray, images[place].gray)
    assert (meter.name, len(meter), meter.groundtruth) == (room.name, 7, None)


def fabricated(seed: int, n_tracked: int, ate_scale: float | None, static: float = 800.0) -> Trial:
    evaluation = None
    if ate_scale is not None:
        truth = open_dataset(f"{ROOM},frames=60,cache=off").groundtruth
        noise = np.random.default_rng(0).normal(size=(60, 3))
        poses = truth.T_world_cam.copy()
        poses[:, :3, 3] += ate_scale * noise
        evaluation = evaluate(replace(truth, T_world_cam=poses), truth, n_given=60)
    boxed = FrameAverages(10, 1000.0, static, 300.0)
    kept = {index: int(static) for index in range(10)}
    return Trial(seed, 60, n_tracked, evaluation, boxed, boxed, 0, StageClock(), kept)


def test_a_row_tells_the_worst_coverage_and_the_gain_of_the_medians() -> None:
    base = Accuracy("room", "base", tuple(fabricated(k, 60, scale) for k, scale in enumerate((0.02, 0.03, 0.1))))
    ours = Accuracy("room", "ours", tuple(fabricated(k, n, 0.01) for k, n in enumerate((60, 57, 59))))
    assert ours.coverage.min == pytest.approx(57 / 60)
    gain = (1 - ours.trials[0].ate_m / base.trials[1].ate_m) * 100
    assert ours.improvement_percent(base) == pytest.approx(gain)
    assert ours.row(base)[5] == f"{gain:+.1f} %"
    assert ours.row(base)[6] == "95.0 %"
    assert base.row(base)[5] == "–"


def test_a_method_without_figures_still_has_a_row() -> None:
    base = Accuracy("room", "base", (fabricated(0, 60, 0.02),))
    lost = Accuracy("room", "lost", (fabricated(0, 60, 0.01), fabricated(1, 1, None)))
    assert lost.row(base) == ("lost", "–", "–", "–", "–", "–", "1.7 %", "–", "–")
    assert lost.smoothness_row() == ("lost", *["–"] * 8, "0.0")
    assert lost.to_dict(base)["ate_se3_m"] is None
    json.dumps(lost.to_dict(base), allow_nan=False)


def test_the_verdict_says_higher_and_fewer_where_it_is_so() -> None:
    boxes = Way(Accuracy("room", WHOLE_BOXES, (fabricated(0, 60, 0.01, static=800),)))
    preset = Way(Accuracy("room", "the preset", (fabricated(0, 60, 0.02, static=600),)))
    worse_mm = (preset.accuracy.trials[0].ate_m - boxes.accuracy.trials[0].ate_m) * 1e3
    last = sentences([boxes, preset])[-1]
    assert f"{worse_mm:.1f} mm higher" in last
    assert "25.0 % fewer" in last


def test_only_frames_that_both_tracked_are_compared() -> None:
    def way(kept: dict[int, int]) -> Way:
        return Way(Accuracy("room", "a way", (replace(fabricated(0, 60, None), kept=kept),)))

    preset, boxes = way({1: 60, 2: 90, 3: 10}), way({1: 40, 2: 60, 7: 900})
    assert preset.more_kept_percent(boxes) == pytest.approx(50.0)
    assert preset.more_kept_percent(way({8: 5})) is None


def test_ctrl_c_keeps_the_methods_that_are_done(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []

    def interrupted(dataset: Any, config: SlamConfig, seed: int, *others: Any) -> Trial:
        asked.append(config.method)
        if len(asked) > 2:
            raise KeyboardInterrupt
        return fabricated(seed, 60, 0.02)

    monkeypatch.setattr("stillroom.cli.bench.session.attempt", interrupted)
    file = tmp_path / "figures.json"
    result = invoke("accuracy", ROOM, ROOM, "--runs", "2", "--json", str(file))
    assert result.exit_code == 130
    assert asked == ["orb-slam2", "orb-slam2", "oc-slam"]
    assert [row["method"] for row in json.loads(file.read_text())["rows"]] == ["orb-slam2"]
    assert "what was not finished is left out" in result.stderr


def test_half_a_run_has_no_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    def stopped(*arguments: Any) -> Any:
        return replace(run(*arguments), interrupted=True)

    monkeypatch.setattr(trials, "run", stopped)
    with pytest.raises(KeyboardInterrupt):
        attempt(select(open_dataset(ROOM), "0:2"), SlamConfig(), 0)


@pytest.mark.parametrize(
    ("arguments", "error", "says"),
    [
        (("accuracy", ROOM, "--methods", " , "), ConfigError, "names none"),
        (("accuracy", ROOM, "--methods", "oc"), ConfigError, "did you mean 'oc-slam'"),
        (("speed", "no-such-sequence"), StillroomError, "no such folder"),
    ],
)
def test_a_slip_is_one_line(arguments: tuple[str, ...], error: type[Exception], says: str) -> None:
    caught = invoke(*arguments).exception
    assert isinstance(caught, error)
    assert says in str(caught)
    assert "\n" not in str(caught)


def test_figures_that_cannot_be_written_say_where(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "stillroom.cli.bench.session.attempt", lambda data, config, seed, *others: fabricated(seed, 60, 0.02)
    )
    (tmp_path / "file").write_text("")
    caught = invoke("accuracy", ROOM, "--json", str(tmp_path / "file" / "figures.json")).exception
    assert isinstance(caught, StillroomError)
    assert "name another file with --json" in str(caught)
