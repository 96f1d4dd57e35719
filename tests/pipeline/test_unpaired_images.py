"""Colour at twice the rate of depth: what was left out is in the figures, and the coverage is of what was recorded."""

import json
from pathlib import Path

import pytest
from tests.fabricated.recorders import keep
from tests.fabricated.rgbd_folder import write_rgbd_folder

from stillroom.datasets.open import open_dataset
from stillroom.datasets.selection import select
from stillroom.pipeline import RunOptions, evaluate_folder, run
from stillroom.presets.registry import configure

N_FRAMES = 12


def test_coverage_is_of_what_was_recorded(tmp_path: Path) -> None:
    write_rgbd_folder(open_dataset(f"synthetic:empty,frames={N_FRAMES}"), tmp_path / "room")
    keep(tmp_path / "room", "depth.txt", range(0, N_FRAMES, 2))
    dataset = open_dataset(str(tmp_path / "room"))
    results = tmp_path / "results"
    outcome = run(dataset, configure("orb-slam2"), RunOptions(folder=results, pictures=0))
    assert (outcome.n_given, outcome.n_unpaired, outcome.n_tracked) == (6, 6, 6)
    figures = json.loads((results / "metrics.json").read_text(encoding="utf-8"))
    assert figures["coverage"] == 0.5
    assert (figures["n_tracked"], figures["n_given"], figures["run"]["n_unpaired"]) == (6, 12, 6)
    again = evaluate_folder(results, write=False).evaluation
    assert again.coverage == 0.5
    part = run(select(dataset, ":3"), configure("orb-slam2"), RunOptions(root=None, pictures=0))
    assert (part.n_given, part.n_unpaired) == (3, 2)  # the one after the third has a neighbour that was not asked for
    assert part.evaluation is not None
    assert part.evaluation.coverage == pytest.approx(3 / 5)
