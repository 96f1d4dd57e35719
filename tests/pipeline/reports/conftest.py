"""Runs with dense maps, by four methods on the same few frames, made once."""

from dataclasses import replace
from pathlib import Path

import pytest

from stillroom.pipeline import RunOptions, Source, run
from stillroom.presets.registry import configure

METHODS = ("orb-slam2", "oc-slam", "oc-slam-paper", "dynaslam-g")
ROOM = Source("synthetic:walking,frames=45")
N_FRAMES = 36


@pytest.fixture(scope="session")
def four(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Results folders by method: the first with a second seed, as `again`."""
    source = replace(ROOM, frames=f":{N_FRAMES}")
    folder, found = tmp_path_factory.mktemp("four"), {}
    for name, method, seed in (*((m, m, 0) for m in METHODS), ("again", METHODS[0], 5)):
        found[name] = folder / name
        options = RunOptions(folder=found[name], pictures=2, source=source)
        run(source.open(), configure(method, None, [f"seed={seed}"]), options)
    return found
