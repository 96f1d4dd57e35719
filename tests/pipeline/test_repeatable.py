"""The same input and seed give the same bytes."""

from dataclasses import replace
from pathlib import Path

import pytest

from stillroom.config import SlamConfig
from stillroom.pipeline import RunOptions, Source, run
from stillroom.presets.registry import method
from stillroom.semantics.no_segmenter import NothingConfig
from stillroom.semantics.truth import TrueSemanticsConfig

REPEATED = ("trajectory.tum", "trajectory_online.tum", "keyframes.tum", "frames.csv")


def assert_same_bytes(source: Source, config: SlamConfig, tmp_path: Path) -> None:
    for name in ("one", "two"):
        run(source.open(), config, RunOptions(folder=tmp_path / name, pictures=0))
    for name in REPEATED:
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes(), name
    assert (tmp_path / "one" / "trajectory.tum").read_bytes().count(b"\n") > 30


@pytest.mark.parametrize("name", ["orb-slam2", "oc-slam"])
def test_in_the_synthetic_room(name: str, tmp_path: Path) -> None:
    config = replace(method(name).config, seed=3)
    if not isinstance(config.semantics, NothingConfig):
        config = replace(config, semantics=TrueSemanticsConfig())
    assert_same_bytes(Source("synthetic:walking,frames=45"), config, tmp_path)


@pytest.mark.parametrize("frames", ["210:260", pytest.param("210:330", marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", ["orb-slam2", "oc-slam"])
def test_on_real_frames(name: str, frames: str, bonn: Path, tmp_path: Path) -> None:
    """With the detector, in a stretch in which people walk."""
    assert_same_bytes(Source(str(bonn), frames=frames), method(name).config, tmp_path)
