"""`stillroom bench parts`: what boxes and clusters are worth, on rendered frames and by plain arithmetic."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from stillroom.bench.parts import BOTH, HALF, Part, every_second_second, parts
from stillroom.bench.rejection import AS_PRINTED
from stillroom.bench.trial import FrameAverages, attempt
from stillroom.cli.bench import app
from stillroom.config import SlamConfig
from stillroom.datasets.open import open_dataset
from stillroom.datasets.recording import Recording
from stillroom.datasets.selection import select
from stillroom.dynamics.chain import KeepAllConfig
from stillroom.dynamics.epipolar_sieve import EpipolarConfig
from stillroom.dynamics.paper_clusters import PaperClustersConfig
from stillroom.errors import ConfigError
from stillroom.presets.registry import configure
from stillroom.semantics.depth_clusters import DepthClustersConfig, NoClustersConfig
from stillroom.semantics.no_segmenter import NothingConfig

ROOM, FIRST, N_FRAMES = "synthetic:walking,fps=10", 30, 26
FRAMES = f"{FIRST}:{FIRST + N_FRAMES}"
TRUTH = "semantics.kind=truth"


@pytest.fixture(scope="module")
def figures(tmp_path_factory: pytest.TempPathFactory) -> tuple[Result, dict[str, dict[str, Any]]]:
    file = tmp_path_factory.mktemp("parts") / "figures.json"
    asked = ["parts", ROOM, "--frames", FRAMES, "--set", TRUTH, "--json", str(file)]
    result = CliRunner().invoke(app, asked)
    assert result.exit_code == 0, result.output
    return result, {row["method"]: row for row in json.loads(file.read_text())["rows"]}


def test_one_command_prints_the_rows_and_one_with_a_failing_detector(figures: tuple[Result, Any]) -> None:
    result, rows = figures
    assert list(rows) == ["none", "boxes only", "clusters only", "both", AS_PRINTED, HALF]
    for name, row in rows.items():
        line = next(line for line in result.stdout.splitlines() if line.strip().startswith(name))
        cells = line.strip().removeprefix(name).split()
        ate = row["ate_se3_m"]
        assert cells[:3] == [f"{ate[which]:.4f}" for which in ("median", "min", "max")]
        assert cells[3:5] == ["100.0", "%"]
        assert cells[5] == f"{row['static_kept_per_frame']:.0f}"
    assert "every second second from image 40 to 49, 10 images in all" in result.stdout


def test_each_row_is_told_of_what_it_should_be(figures: tuple[Result, Any]) -> None:
    _, rows = figures
    boxed = {name: (row["runs"][0]["boxed_frames"] or {"n_frames": 0})["n_frames"] for name, row in rows.items()}
    assert boxed["none"] == boxed["clusters only"] == 0
    assert boxed["boxes only"] == boxed[BOTH] == N_FRAMES
    assert boxed[HALF] == N_FRAMES - 10
    share = {name: row["static_kept_share"] for name, row in rows.items()}
    assert share["none"] == 1.0
    assert max(share["boxes only"], share["clusters only"], share[BOTH], share[HALF]) < 0.95


def test_the_rows_differ_in_what_they_say() -> None:
    preset = configure("oc-slam", None, ["dynamics.boxes.min_agreeing=3", "dynamics.gain=1.25"])
    four = parts(preset)
    assert four[BOTH] == preset
    for config in four.values():
        same = {"semantics": preset.semantics, "clusters": preset.clusters, "dynamics": preset.dynamics}
        assert replace(config, **same) == preset
    kinds = [(type(c.semantics), type(c.clusters), type(c.dynamics)) for c in four.values()]
    yolo, sieve = type(preset.semantics), type(preset.dynamics)
    assert kinds == [
        (NothingConfig, NoClustersConfig, KeepAllConfig),
        (yolo, NoClustersConfig, EpipolarConfig),
        (NothingConfig, DepthClustersConfig, sieve),
        (yolo, DepthClustersConfig, sieve),
        (yolo, DepthClustersConfig, PaperClustersConfig),
    ]
    assert four["boxes only"].dynamics.min_agreeing == 3
    assert four["clusters only"].dynamics.gain == 1.25


@pytest.mark.parametrize("settings", [[], ["clusters.kind=depth"], ["dynamics.kind=clusters"]])
def test_a_method_without_these_parts_is_refused(settings: list[str]) -> None:
    with pytest.raises(ConfigError, match="orb-slam2 does not reject by boxes and clusters"):
        parts(configure("orb-slam2", None, settings))


def test_every_second_second_is_the_seconds_in_between() -> None:
    stamps_s = np.array([5.0, 5.5, 6.2, 6.9, 7.1, 7.3, 8.25, 8.9, 9.1, 9.9, 10.1])
    dataset = type("Few", (Recording,), {"timestamps_s": stamps_s})()
    # From 5.5 s on: seconds [6.5, 7.5) and [8.5, 9.5).
    assert every_second_second(dataset, 1) == ((3, 6), (7, 9))
    assert every_second_second(dataset, 10) == ()
    assert every_second_second(dataset, 11) == ()


def test_ranges_are_numbers_of_the_original() -> None:
    room = select(open_dataset("synthetic:walking,frames=150"), "20:130", drop=["60:70"])
    # From image 40 on, 30 a second: images 70 to 99 and no others; 60 to 69 are not there to begin with.
    assert every_second_second(room, 40) == ((70, 100),)
    assert every_second_second(room, 20) == ((50, 80), (110, 130))


def test_boxes_are_withheld_where_they_would_be_carried_too() -> None:
    room = select(open_dataset(ROOM), FRAMES)
    config = configure("oc-slam", None, [TRUTH, "semantics.carry.enabled=true", "clusters.kind=nothing"])
    config = replace(config, dynamics=EpipolarConfig())
    assert config.semantics.build().__class__.__name__ == "CarriedBoxes"
    trial = attempt(room, config, 0, withheld=((FIRST, FIRST + 3), (FIRST + 6, FIRST + 8)))
    assert trial.first_boxed == FIRST + 3
    assert trial.boxed is not None
    assert trial.tracked is not None
    assert (trial.boxed.n_frames, trial.tracked.n_frames) == (N_FRAMES - 5, N_FRAMES)


def test_averages_are_those_of_the_frames() -> None:
    results = [SimpleNamespace(n_keypoints=100 + k, n_static=50 + 2 * k, n_inliers=k) for k in range(5)]
    found = FrameAverages.over(results)
    assert found == FrameAverages(5, 102.0, 54.0, 2.0)
    assert FrameAverages.over([]) is None
    assert FrameAverages.over_runs([None, found, FrameAverages(5, 104.0, 50.0, 4.0)]) == FrameAverages(5, 103, 52, 3)
    assert FrameAverages.over_runs([None]) is None


def test_a_part_that_was_never_tracked_still_has_a_row(monkeypatch: pytest.MonkeyPatch) -> None:
    lost = SimpleNamespace(trials=[SimpleNamespace(tracked=None, first_boxed=None)], method="lost")
    lost.ate_cells, lost.coverage = lambda: ("–", "–", "–"), SimpleNamespace(min=0.0)
    assert Part(lost).row() == ("lost", "–", "–", "–", "0.0 %", "–", "–", "–")


def test_a_detector_that_sees_nothing_cannot_fail(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []

    def trial(dataset: Any, config: SlamConfig, seed: int, bar: Any, withheld: Any) -> Any:
        asked.append(type(config.semantics).__name__)
        return replace(attempt(select(dataset, "30:31"), config, seed), first_boxed=None)

    monkeypatch.setattr("stillroom.cli.bench.session.attempt", trial)
    file = tmp_path / "figures.json"
    result = CliRunner().invoke(app, ["parts", ROOM, "--set", TRUTH, "--json", str(file)])
    assert result.exit_code == 0, result.output
    assert len(asked) == len(json.loads(file.read_text())["rows"]) == 5
    assert HALF not in result.stdout
