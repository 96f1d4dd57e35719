"""A config.toml of an earlier version loads today: those of `old/` were written by the version of commit ecd196d."""

import logging
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from stillroom.config import SlamConfig, to_toml, updated, with_overrides
from stillroom.config.settings import PROVENANCE
from stillroom.errors import ConfigError
from stillroom.presets.registry import OWN, configure, method

OLD = Path(__file__).with_name("old")
KINDS = tomllib.loads((OLD / "kinds.toml").read_text(encoding="utf-8"))
IGNORED = {
    "orb-slam2": set(),
    "oc-slam": {"semantics.folder", "dynamics.boxes.min_matches"},
    "pspnet-slam": {"dynamics.min_matches", "dynamics.first.min_matches", "dynamics.second.min_matches"},
    "dynaslam": {"dynamics.min_matches"},
    "dynaslam-n": {"dynamics.min_matches"},
    "dynaslam-g": {"dynamics.min_matches"},
}
"""Keys that set nothing any more."""
CHANGED = {
    "dense.carving.every": 4,
    "semantics.every": 1,
}
"""What presets had then, where they have another value today: a file keeps its own."""


def changed_in(file: Path) -> list[str]:
    """Return the settings that give a preset of today the values that it had in a file."""
    old = values_of(tomllib.loads(file.read_text(encoding="utf-8")))
    return [f"{key}={value}" for key, value in CHANGED.items() if key in old]


def values_of(tree: Mapping[str, Any], path: str = "") -> dict[str, object]:
    """Return all values by their dotted names."""
    flat: dict[str, object] = {}
    for key, value in tree.items():
        flat |= values_of(value, f"{path}{key}.") if isinstance(value, Mapping) else {f"{path}{key}": value}
    return flat


def ignored(caplog: pytest.LogCaptureFixture) -> list[str]:
    """Return the keys that the log says are ignored, as often as it says so."""
    assert all(" is ignored: " in record.getMessage() for record in caplog.records)
    return [record.getMessage().split("'")[1] for record in caplog.records]


def test_there_is_a_file_of_each_method() -> None:
    assert {path.stem for path in OLD.glob("*.toml")} - {"kinds"} == set(IGNORED)
    assert set(IGNORED) < {own.name for own in OWN}, "presets that came later have no files of then"


@pytest.mark.parametrize("name", IGNORED)
def test_it_gives_the_preset_of_today(name: str, caplog: pytest.LogCaptureFixture) -> None:
    file = OLD / f"{name}.toml"
    with caplog.at_level(logging.INFO):
        config = configure(file=file)
    assert config == with_overrides(method(name).config, changed_in(file))
    assert sorted(ignored(caplog)) == sorted(IGNORED[name]), "each is said once"
    # Nothing else of the file is passed over: all other keys are there, with the values that the file gives them.
    old = tomllib.loads(file.read_text(encoding="utf-8"))
    assert old.pop(PROVENANCE)["commit"] == "ecd196d"
    kept = {key: value for key, value in values_of(old).items() if key not in IGNORED[name]}
    today = values_of(tomllib.loads(to_toml(config)))
    assert len(kept) > 100
    assert {key: today[key] for key in kept} == kept


@pytest.mark.parametrize("name", IGNORED)
def test_a_value_that_was_changed_is_kept(name: str, tmp_path: Path) -> None:
    text = (OLD / f"{name}.toml").read_text(encoding="utf-8")
    (tmp_path / "mine.toml").write_text(text.replace("min_inliers = 30", "min_inliers = 31"), encoding="utf-8")
    overrides = ["tracking.min_inliers=31", *changed_in(OLD / f"{name}.toml")]
    assert configure(file=tmp_path / "mine.toml") == configure(name, overrides=overrides)
    assert configure(file=tmp_path / "mine.toml") != configure(name)


@pytest.mark.parametrize("part", KINDS)
def test_the_keys_of_every_kind_are_known(part: str, caplog: pytest.LogCaptureFixture) -> None:
    section, kind = part.split("=")
    with caplog.at_level(logging.INFO):
        config = updated(SlamConfig(), {section: KINDS[part]})
    kept = values_of({section: KINDS[part]})
    then = [f"{key}={value}" for key, value in CHANGED.items() if key in kept]
    assert config == with_overrides(SlamConfig(), [f"{section}.kind={kind}", *then])
    assert all(key.endswith(".min_matches") or key == "semantics.folder" for key in ignored(caplog))


def test_a_key_that_never_was_is_still_an_error(tmp_path: Path) -> None:
    text = (OLD / "oc-slam.toml").read_text(encoding="utf-8")
    (tmp_path / "mine.toml").write_text(text.replace("min_inliers", "min_inlier"), encoding="utf-8")
    with pytest.raises(ConfigError, match=r"unknown key 'tracking\.min_inlier'; did you mean 'tracking\.min_inliers'"):
        configure(file=tmp_path / "mine.toml")
