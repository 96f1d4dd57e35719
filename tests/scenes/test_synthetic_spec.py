"""The one-line spec: what it understands, and what it says when it does not."""

import re

import numpy as np
import pytest

from stillroom.datasets.open import open_dataset
from stillroom.errors import ConfigError, DatasetError
from stillroom_scenes.config import PRESETS, SyntheticConfig, parse_spec


@pytest.mark.parametrize(
    ("spec", "config"),
    [
        ("synthetic", SyntheticConfig()),
        ("synthetic:", SyntheticConfig()),
        ("synthetic:walking", SyntheticConfig(figures="walking", path="sway")),
        (
            "synthetic:walking,frames=300,seed=3,path=loop",
            SyntheticConfig(figures="walking", n_frames=300, seed=3, path="loop"),
        ),
        ("synthetic:n_frames=12, fps = 15 ,noise=off", SyntheticConfig(n_frames=12, fps=15.0, noise=False)),
        (
            "synthetic:standing,cache=no,room=library",
            PRESETS["standing"].__class__(figures="standing", n_frames=360, cache=False, room="library"),
        ),
        ("synthetic:corridor,frames=600", SyntheticConfig(room="corridor", path="round", n_frames=600)),
        (
            "synthetic:building,rooms=3,alike=no,figures=walking",
            SyntheticConfig(room="building", path="tour", rooms=3, alike=False, n_frames=2700),
        ),
        ("synthetic:rooms", SyntheticConfig(room="building", path="tour", rooms=6, alike=False, n_frames=10_000)),
        ("synthetic:empty,name=mine", SyntheticConfig(figures="none", name="mine")),
    ],
)
def test_a_spec_is_read(spec: str, config: SyntheticConfig) -> None:
    assert parse_spec(spec) == config


@pytest.mark.parametrize(
    ("spec", "error", "said"),
    [
        ("synthetic:walkin", DatasetError, "no synthetic sequence 'walkin'; did you mean 'walking'"),
        ("synthetic:zzz", DatasetError, "there are walking, standing"),
        ("synthetic:walking,frame=3", ConfigError, "unknown key 'frame'; did you mean 'frames'"),
        ("synthetic:walking,sed=3", ConfigError, "did you mean 'seed'"),
        ("synthetic:walking,seed=three", ConfigError, "seed is 'three'; it must be a whole number"),
        ("synthetic:walking,seed=1.5", ConfigError, "seed is '1.5'; it must be a whole number"),
        ("synthetic:walking,fps=fast", ConfigError, "fps is 'fast'; it must be a number"),
        ("synthetic:walking,noise=loud", ConfigError, "noise is 'loud'; it must be on or off"),
        ("synthetic:walking,path=swya", ConfigError, "path is 'swya'; did you mean 'sway'"),
        ("synthetic:walking,figures=dancing", ConfigError, "figures is 'dancing'; .*none, walking"),
        ("synthetic:walking,room=offise", ConfigError, "did you mean 'office'"),
        ("synthetic:walking,frames=0", ConfigError, "frames is 0"),
        ("synthetic:walking,fps=-1", ConfigError, "fps is -1.0"),
        ("synthetic:walking,fps=inf", ConfigError, "fps is inf"),
        ("synthetic:walking,seed=-1", ConfigError, "seed is -1"),
        ("synthetic:building,rooms=0", ConfigError, "rooms is 0; a building has 1 to 40"),
        ("synthetic:building,path=sway", ConfigError, "path is 'sway'; there are tour"),
        ("synthetic:corridor,figures=pushed", ConfigError, "figures is 'pushed'; there are none, walking"),
        ("synthetic:walking,room=corridor", ConfigError, "path is 'sway'; there are round"),
        ("synthetic:walking,loop", ConfigError, "'loop' is not of the form key=value"),
        ("synthetic:walking,name=a/b", ConfigError, "name is 'a/b'; it must not have a slash"),
    ],
)
def test_a_wrong_spec_ends_in_one_line_that_names_the_nearest(spec: str, error: type[Exception], said: str) -> None:
    with pytest.raises(error, match=said) as caught:
        open_dataset(spec)
    assert "\n" not in str(caught.value)
    assert re.search("synthetic", str(caught.value))


def test_the_name_tells_the_sequence_apart() -> None:
    names = {
        open_dataset(f"synthetic:empty,cache=off,{choice}").name
        for choice in (
            "frames=9",
            "frames=9,seed=1",
            "frames=9,path=rpy",
            "frames=9,room=library",
            "frames=8",
            "frames=9,noise=off",
            "frames=9,fps=15",
        )
    }
    assert len(names) == 7


def test_frames_and_rate_are_those_asked_for() -> None:
    room = open_dataset("synthetic:empty,frames=31,fps=15,cache=off")
    assert len(room) == 31
    np.testing.assert_allclose(np.diff(room.timestamps_s), 1 / 15)
