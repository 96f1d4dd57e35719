"""`stillroom bench geometry` and `ablation` on a few rendered frames, against plain counts."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner, Result

from stillroom.bench.ablation import ablation
from stillroom.bench.observers import MovingThings
from stillroom.bench.trial import all_keypoints
from stillroom.cli.bench import app
from stillroom.datasets.open import open_dataset
from stillroom.presets.registry import configure
from stillroom.semantics.masks.pspnet import PspNetConfig
from stillroom.semantics.no_segmenter import NothingConfig

CARRIED = "synthetic:carried,frames=220"
FRAMES = "196:216"
TRUTH = "semantics.kind=truth"


def invoke(*arguments: str) -> Result:
    result = CliRunner().invoke(app, [*arguments, "--set", TRUTH])
    assert result.exit_code == 0, result.output
    return result


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> tuple[Result, list[dict[str, Any]], np.ndarray]:
    folder = tmp_path_factory.mktemp("bench")
    paths = {"--json": folder / "figures.json", "--picture": folder / "picture.png"}
    options = [str(text) for pair in paths.items() for text in pair]
    result = invoke("geometry", CARRIED, "--frames", FRAMES, "--picture-of", "212", *options)
    figures = json.loads(paths["--json"].read_text())
    return result, figures["rows"], cv2.imread(str(paths["--picture"]))


def test_all_tests_and_both_paths_go_over_the_same_points(table: tuple[Result, list[dict[str, Any]], Any]) -> None:
    rows = {(row["test"], row["search"]): row for row in table[1]}
    assert len(rows) == 5
    for test in ("compensated homography", "multi-view depth"):
        serpentine, ants = rows[test, "serpentine"], rows[test, "ants"]
        for name in ("n_images", "n_points", "n_dynamic", "exhaustive_s", "exhaustive_growing_s"):
            assert serpentine[name] == ants[name] > 0
        for row in (serpentine, ants):
            assert 0 < row["n_tested"] <= row["n_points"]
            assert row["recall"] == pytest.approx(row["n_found"] / row["n_dynamic"])
            assert row["n_wrong"] == 0, "what both ask the same test, both answer alike"
            assert row["time_ratio"] == pytest.approx(row["search_s"] / row["exhaustive_s"])
            with_growing = (row["search_s"] + row["growing_s"]) / (row["exhaustive_s"] + row["exhaustive_growing_s"])
            assert row["time_ratio_with_growing"] == pytest.approx(with_growing)
            assert row["test_s"] == pytest.approx(row["exhaustive_s"] / row["n_points"])
            assert row["path_length_px"] > 500 * row["n_images"]
    printed = rows["projected points", "ants"]
    assert printed["n_images"] == rows["multi-view depth", "ants"]["n_images"]
    assert 0 < printed["n_tested"] < printed["n_points"]
    assert printed["n_wrong"] == 0
    assert printed["n_found"] <= printed["n_dynamic"]
    assert "projected points" in table[0].stdout
    homography = rows["compensated homography", "ants"]
    assert homography["recall"] >= 0.95
    assert homography["share_tested"] < 0.85
    assert "µs a point" in table[0].stdout


def test_the_picture_shows_four_panels(table: tuple[Result, Any, np.ndarray]) -> None:
    picture = table[2]
    assert picture.shape[1] > 2 * 900
    red = (picture[..., 2] > 200) & (picture[..., 0] < 90) & (picture[..., 1] < 90)
    green = (picture[..., 1] > 200) & (picture[..., 2] < 90)
    lower = picture.shape[0] // 2
    assert red[lower:].sum() > 200
    assert green[lower:].sum() > 2000
    assert red[:lower].sum() < 50, "the differences are gray"


def test_ablation_shows_geometry_finding_what_the_network_is_not_told(tmp_path: Path) -> None:
    file = tmp_path / "figures.json"
    only = "network only,geometry only,both, ants"
    arguments = ["ablation", CARRIED, "--frames", FRAMES, "--only", only, "--json", str(file)]
    result = CliRunner().invoke(app, [*arguments, "--set", "semantics.kind=nothing"])
    assert result.exit_code == 0, result.output
    rows = {row["method"]: row for row in json.loads(file.read_text())["rows"]}
    assert rows["network only"]["object_keypoints_found"] == 0.0
    assert rows["network only"]["moving_keypoints_found"] == 0.0
    for name in ("geometry only", "both, ants"):
        assert rows[name]["object_keypoints_found"] > 0.5
        assert rows[name]["object_pixels_found"] > 0.05, "hulls of keypoints are smaller than the thing"
        assert rows[name]["static_keypoints_wrong"] < 0.02
    assert "the same, compensated" not in rows


def test_the_rows_differ_in_what_decides() -> None:
    rows = ablation(configure("pspnet-slam"))
    assert len(rows) == len({repr(config) for config in rows.values()}) == 9
    assert rows["the preset"] == all_keypoints(configure("pspnet-slam"))
    assert {config.tracking.between_keyframes for config in rows.values()} == {"orb"}
    networks = [config.semantics for config in rows.values() if not isinstance(config.semantics, NothingConfig)]
    assert len(networks) == 7
    assert all(isinstance(network, PspNetConfig) and network.model is None for network in networks), "nothing to fetch"
    assert {config.low_cost for config in rows.values()} == {configure("pspnet-slam").low_cost}
    assert rows["both, every point"].dynamics.search == "exhaustive"
    ants = rows["both, ants"].dynamics
    assert (ants.search, ants.ants.path.kind) == ("reverse", "ants")
    assert rows["both, ants, plain homography"].dynamics.compensation.refine is False
    assert rows["the same, compensated"].dynamics.compensation.refine is True
    assert rows["the same, compensated"].dynamics.test.use_depth is False


def test_moving_things_are_the_renderers() -> None:
    room = open_dataset(CARRIED)
    things = MovingThings(room)
    for _ in range(2):
        moving, handled = things.at(210)
        truth = room.truth(210)
        np.testing.assert_array_equal(moving, truth.moving)
        np.testing.assert_array_equal(handled, truth.moving & (truth.instance > 100))
    assert 500 < handled.sum() < moving.sum()


def test_an_unknown_row_is_one_line() -> None:
    result = CliRunner().invoke(app, ["ablation", CARRIED, "--only", "magic", "--set", TRUTH])
    assert result.exit_code == 1
    assert "no such row" in str(result.exception)
