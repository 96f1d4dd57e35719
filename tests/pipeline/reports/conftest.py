"""Runs with dense maps, by four methods on the same few frames, made once."""

from dataclasses import replace
from pathlib import Path

import pytest
from made_once import made_once

from stillroom.pipeline import RunOptions, Source, run
from stillroom.presets.registry import configure

METHODS = ("orb-slam2", "oc-slam", "oc-slam-paper", "dynaslam-g")
ROOM = Source("synthetic:walking,frames=45")
N_FRAMES = 36


@pytest.fixture(scope="session")
def four(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Results folders by method: the first with a second seed, as `again`."""
    source = replace(ROOM, frames=f":{N_FRAMES}")
    asked = {**{method: (method, 0) for method in METHODS}, "again": (METHODS[0], 5)}

    def make(folder: Path) -> None:
        for name, (method, seed) in asked.items():
            options = RunOptions(folder=folder / name, pictures=2, source=source)
            run(source.open(), configure(method, None, [f"seed={seed}"]), options)

    folder = made_once(tmp_path_factory, "four", make)
    return {name: folder / name for name in asked}
