"""`stillroom bench ghosts` on a few rendered frames: which images serve for what, and how maps are judged."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from stillroom.bench import dense_maps as making
from stillroom.bench.dense_maps import (
    HEADER,
    WITH_REMOVAL,
    WITHOUT_REMOVAL,
    MapFigures,
    RealJudge,
    TruthJudge,
    dense_maps,
)
from stillroom.bench.ghost_trials import Stretches, stretches
from stillroom.cli.bench import app
from stillroom.datasets.open import open_dataset
from stillroom.datasets.recording import Recording
from stillroom.datasets.selection import select
from stillroom.dense.dense_mapper import DenseMapper
from stillroom.errors import ConfigError, TrajectoryError
from stillroom.evaluation.ghosts import CompletenessFigure, Gatherer, GhostFigure
from stillroom.geometry import se3
from stillroom.presets.registry import configure
from stillroom_scenes.config import open_synthetic
from stillroom_scenes.room import SyntheticRoom

ROOM = "synthetic:walking,frames=60,fps=10"
TRUTH = "semantics.kind=truth"


def invoke(*arguments: str) -> Result:
    return CliRunner().invoke(app, ["ghosts", *arguments, "--set", TRUTH])


@pytest.fixture(scope="module")
def figures(tmp_path_factory: pytest.TempPathFactory) -> tuple[Result, dict[str, Any]]:
    file = tmp_path_factory.mktemp("bench") / "figures.json"
    result = invoke(ROOM, "--map", "20:60", "--json", str(file))
    assert result.exit_code == 0, result.output
    return result, json.loads(file.read_text())


def test_people_are_in_the_map_without_removal_and_gone_with_it(figures: tuple[Result, dict[str, Any]]) -> None:
    result, content = figures
    assert content["bench"] == "ghosts"
    (row,) = content["rows"]
    assert (row["method"], row["mapped"], row["reference"], row["coverage"]) == ("oc-slam", [20, 60], None, 1.0)
    clean, raw = row["maps"]
    assert (clean["map"], raw["map"]) == (WITH_REMOVAL, WITHOUT_REMOVAL)
    assert raw["ghosts"]["share"] > 0.05
    assert clean["ghosts"]["share"] < raw["ghosts"]["share"] / 10
    assert raw["completeness"]["share"] > 0.6
    assert raw["surface"]["error_m"]["median"] < 0.03
    for one in row["maps"]:
        ghosts = one["ghosts"]
        assert ghosts["share"] == pytest.approx(ghosts["n_ghosts"] / ghosts["n_points"])
        assert ghosts["n_ghosts"] + one["surface"]["n_astray"] == ghosts["n_suspects"]
        line = next(line for line in result.stdout.splitlines() if line.strip().startswith(f"{one['map']} "))
        assert str(ghosts["n_points"]) in line
        assert f"{ghosts['share'] * 100:.2f} %" in line
    for word in HEADER:
        assert word.split()[0] in result.stdout
    assert "100.0 % of all images up to there tracked" in result.stdout


def test_no_image_outside_the_stretch_touches_the_map(monkeypatch: pytest.MonkeyPatch) -> None:
    touched: dict[bool, list[tuple[str, int]]] = {True: [], False: []}

    def noting(name: str) -> Any:
        original = getattr(DenseMapper, name)

        def noted(self: DenseMapper, *arguments: Any) -> Any:
            image = arguments[1] if name == "integrate" else arguments[0]
            touched[self.config.carving.removal].append((name, image.index))
            return original(self, *arguments)

        return noted

    for name in ("integrate", "carve"):
        monkeypatch.setattr(DenseMapper, name, noting(name))
    room = select(open_dataset(ROOM), ":30")
    config = configure("oc-slam", None, [TRUTH])
    made = dense_maps(room, config, config.dense, range(10, 25))
    assert touched[True] == touched[False]
    numbers = [number for _, number in touched[True]]
    assert numbers == list(range(10, 25))
    assert {name for name, _ in touched[True]} == {"integrate", "carve"}
    assert sorted(made.T_world_cam) == list(range(30))
    assert made.n_given == 30
    assert all(len(cloud) > 1000 for cloud in made.clouds.values())


def simple_map(room: SyntheticRoom, T_other_world: np.ndarray, with_people: bool) -> np.ndarray:
    gatherer = Gatherer(room.camera)
    for index in range(40, 60, 4):
        truth = room.truth(index)
        gatherer.add(truth.depth_m, T_other_world @ truth.T_world_cam, None if with_people else ~truth.moving)
    return gatherer.points()


def test_a_run_in_another_world_is_judged_in_the_renderers() -> None:
    room = open_synthetic(ROOM)
    T_run_true = se3.exp(np.array([1.0, -2.0, 0.5, 0.4, -0.3, 0.9]))
    poses = {index: T_run_true @ room.pose(index) for index in range(60)}
    judge = TruthJudge(room, poses, range(40, 60))
    clean, raw = (judge.judge("a map", simple_map(room, T_run_true, people)) for people in (False, True))
    assert clean.surface is not None
    assert clean.surface.error_m is not None
    assert clean.surface.error_m.max < 0.02
    assert (clean.ghosts.n_ghosts, clean.surface.n_astray) == (0, 0)
    assert clean.complete.share > 0.97
    assert raw.ghosts.share > 0.05
    with pytest.raises(TrajectoryError, match="no map to evaluate"):
        TruthJudge(room, {3: np.eye(4)}, range(20, 60))


def test_a_real_map_is_judged_by_what_the_reference_saw() -> None:
    room = open_synthetic("synthetic:standing,frames=54,fps=9,seed=1")
    empty = open_synthetic("synthetic:empty,frames=54,fps=9,seed=1")

    class EmptyAtFirst(Recording):
        name, camera, camera_source = "room", room.camera, ""
        timestamps_s = room.timestamps_s

        def load(self, index: int) -> Any:
            return (empty if index < 24 else room).load(index)

    sequence = EmptyAtFirst()
    poses = {index: room.pose(index) for index in range(54)}
    judge = RealJudge(sequence, poses, range(24), range(24, 54))
    maps = {}
    for people in (False, True):
        gatherer = Gatherer(room.camera)
        for index in range(24, 54, 3):
            image = room.load(index)
            assert image.truth is not None
            gatherer.add(image.depth_m, room.pose(index), None if people else ~image.truth.movable)
        maps[people] = judge.judge("a map", gatherer.points())
    assert maps[True].ghosts.share > 0.05
    assert maps[False].ghosts.share < maps[True].ghosts.share / 10
    assert maps[False].complete.share > 0.95
    assert judge.control().share < 0.01
    assert "the empty room itself" in judge.sentences()[-1]
    with pytest.raises(TrajectoryError, match="none of the images 0:24 was tracked"):
        RealJudge(sequence, {30: np.eye(4)}, range(24), range(24, 54))


def test_which_images_serve_for_what() -> None:
    rendered = open_dataset(ROOM)
    assert stretches(rendered) == Stretches(None, range(60))
    assert stretches(rendered, mapped="20:") == Stretches(None, range(20, 60))
    assert stretches(rendered, reference="0:20") == Stretches(range(20), range(20, 60))
    real = select(open_dataset("synthetic:empty,frames=300"), ":300")
    assert stretches(real) == Stretches(range(200), range(200, 300))
    assert stretches(real, "-100:", "0:150") == Stretches(range(200, 300), range(150))


@pytest.mark.parametrize(
    ("reference", "mapped", "says"),
    [
        ("0:30", "20:60", "overlap"),
        ("0:60", None, "no such images"),
        ("0:20:2", None, "no such images"),
        (None, "x", "map: 'x' is no range"),
        ("5:5", None, "reference 5:5: no such images; there are 60"),
    ],
)
def test_a_slip_in_the_stretches_is_one_line(reference: str | None, mapped: str | None, says: str) -> None:
    with pytest.raises(ConfigError, match=says):
        stretches(open_dataset(ROOM), reference, mapped)


def test_a_map_without_points_and_a_real_map_have_rows_too() -> None:
    nothing = np.zeros(0, dtype=np.bool_)
    row = MapFigures("bare", GhostFigure.of(nothing, 0), CompletenessFigure(10, 0, 0.05, np.zeros(10, dtype=np.bool_)))
    assert row.row() == ("bare", "0", "0.00 %", "0.0 %", "0.0 %", "–", "–")
    assert replace(row, surface=None).to_dict()["surface"] is None


def test_ctrl_c_leaves_no_figures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stopped(*arguments: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(making, "_track_all", stopped)
    result = invoke(ROOM, "--json", str(tmp_path / "figures.json"))
    assert result.exit_code == 130
    assert not (tmp_path / "figures.json").exists()
