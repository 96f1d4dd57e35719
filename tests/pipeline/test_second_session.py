"""A second session on real data: a map of the room before people came; the camera is tracked against it among them.

The short version shows a few frames to a map of a few; the long one is what the map file is for.
"""

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from stillroom.config import SlamConfig, with_overrides
from stillroom.datasets.open import open_dataset
from stillroom.datasets.selection import select
from stillroom.pipeline import RunOptions, RunOutcome, run
from stillroom.presets.registry import configure
from stillroom.session.map_file import MapFile, MapUse

POSES_ONLY = ("dense.kind=nothing",)


def played(
    sequence: Path, config: SlamConfig, path: Path, use: MapUse, frames: str, reverse: bool = False
) -> RunOutcome:
    dataset = select(open_dataset(str(sequence)), frames=frames, reverse=reverse)
    return run(dataset, config, RunOptions(root=None, pictures=0, map=MapFile(path, use)))


def assert_localized(outcome: RunOutcome, at_least: float, ate_m: float) -> None:
    assert outcome.n_tracked >= at_least * outcome.n_given
    assert outcome.evaluation is not None
    assert outcome.evaluation.as_given.ate_se3_m.rmse <= ate_m
    assert not any(result.is_keyframe for result in outcome.system.results)


@contextmanager
def left_as_it_is(path: Path) -> Iterator[None]:
    before, listed = hashlib.sha256(path.read_bytes()).digest(), sorted(path.parent.iterdir())
    yield
    assert hashlib.sha256(path.read_bytes()).digest() == before
    assert sorted(path.parent.iterdir()) == listed


def test_a_short_second_session(bonn: Path, tmp_path: Path) -> None:
    path, config = tmp_path / "room.stillmap", with_overrides(configure("orb-slam2"), POSES_ONLY)
    played(bonn, config, path, MapUse.NEW, "0:40")
    with left_as_it_is(path):
        assert_localized(played(bonn, config, path, MapUse.LOCALIZE, "35:60"), 1.0, 0.02)
        assert_localized(played(bonn, config, path, MapUse.LOCALIZE, "10:40", reverse=True), 1.0, 0.02)


@pytest.mark.slow
def test_a_second_session_with_people(bonn: Path, tmp_path: Path) -> None:
    """All of it, backwards too, and from five frames sampled at random to the end."""
    path, config = tmp_path / "room.stillmap", with_overrides(configure("oc-slam"), POSES_ONLY)
    played(bonn, config, path, MapUse.NEW, "0:200")
    starts = np.random.default_rng(0).integers(200, 530, 5)
    with left_as_it_is(path):
        for frames in ("200:560", *(f"{start}:560" for start in starts)):
            assert_localized(played(bonn, config, path, MapUse.LOCALIZE, frames), 0.97, 0.02)
        assert_localized(played(bonn, config, path, MapUse.LOCALIZE, "200:560", reverse=True), 0.97, 0.02)
