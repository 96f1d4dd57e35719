"""Reading, writing and overriding the configuration."""

import dataclasses
import tomllib
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pytest

from stillroom.config import SlamConfig, read_toml, to_toml, updated, with_overrides
from stillroom.config.kinds import DYNAMICS, SEMANTICS
from stillroom.config.settings import as_toml
from stillroom.dynamics.chain import KeepAllConfig
from stillroom.dynamics.epipolar_sieve import EpipolarConfig
from stillroom.errors import ConfigError
from stillroom.semantics.carried_boxes import CarryConfig
from stillroom.semantics.mask_files import MaskFilesConfig
from stillroom.semantics.truth import TrueSemanticsConfig
from stillroom.semantics.yolo_fastest import YoloFastestConfig
from stillroom.tracking.tracker import TrackerConfig


@dataclass(frozen=True)
class Part:
    level: int = 3
    note: str = "plain"


@dataclass(frozen=True)
class Everything:
    """A field of each type that a config may have."""

    on: bool = False
    count: int = 1
    size_m: float = 0.5
    name: str = ""
    place: Path | None = None
    numbers: tuple[int, ...] = ()
    words: tuple[str, ...] = ("a",)
    pair: tuple[int, float] = (1, 2.0)
    part: Part = field(default_factory=Part)


EVERYTHING = Everything(
    on=True,
    count=-7,
    size_m=1e-9,
    name='quotes " and \\ and\nlines, ümläuts and = # [',
    place=Path("/some where/else"),
    numbers=(3, 1, 2),
    words=("x, y", "", "ü"),
    pair=(4, 0.1),
    part=Part(5, "'"),
)


def reread(config: Any) -> Any:
    return updated(type(config)(), tomllib.loads(to_toml(config)))


@pytest.mark.parametrize("config", [Everything(), EVERYTHING], ids=["defaults", "odd values"])
def test_what_is_written_is_read_back(config: Everything) -> None:
    assert reread(config) == config


@pytest.mark.parametrize("semantics", [kind() for kind in SEMANTICS.classes.values()], ids=list(SEMANTICS.classes))
@pytest.mark.parametrize("dynamics", [kind() for kind in DYNAMICS.classes.values()], ids=list(DYNAMICS.classes))
def test_every_part_of_every_socket_is_read_back(semantics: Any, dynamics: Any) -> None:
    config = SlamConfig(seed=5, semantics=semantics, dynamics=dynamics)
    again = reread(config)
    assert again == config
    assert type(again.semantics) is type(semantics)
    assert type(again.dynamics) is type(dynamics)


def test_provenance_is_written_and_configures_nothing(tmp_path: Path) -> None:
    file = tmp_path / "config.toml"
    file.write_text(to_toml(SlamConfig(seed=4), {"commit": "abc", "source": {"fps": None}}), encoding="utf-8")
    assert tomllib.loads(file.read_text(encoding="utf-8"))["run"] == {"commit": "abc", "source": {"fps": ""}}
    assert updated(SlamConfig(), read_toml(file)) == SlamConfig(seed=4)


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("count=12", Everything(count=12)),
        ("count = 12", Everything(count=12)),
        ("size_m=2", Everything(size_m=2.0)),
        ("size_m=1e-3", Everything(size_m=0.001)),
        ("on=true", Everything(on=True)),
        ("name=plain text", Everything(name="plain text")),
        ("name='quoted'", Everything(name="quoted")),
        ("name=1.1", Everything(name="1.1")),
        ("name=2024-01-01", Everything(name="2024-01-01")),
        ("name=true", Everything(name="true")),
        ("name=a=b", Everything(name="a=b")),
        ("place=some/masks", Everything(place=Path("some/masks"))),
        ("place=/data/2011", Everything(place=Path("/data/2011"))),
        ("place=", Everything()),
        ("numbers=[1, 2]", Everything(numbers=(1, 2))),
        ("numbers=1,2", Everything(numbers=(1, 2))),
        ("numbers=7", Everything(numbers=(7,))),
        ("numbers=", Everything()),
        ("words=person", Everything(words=("person",))),
        ("words=person, dog", Everything(words=("person", "dog"))),
        ('words=["person", "teddy bear"]', Everything(words=("person", "teddy bear"))),
        ("pair=[3, 4]", Everything(pair=(3, 4.0))),
        ("part.level=9", Everything(part=Part(level=9))),
        ("part={level = 9}", Everything(part=Part(level=9))),
    ],
)
def test_overrides(override: str, expected: Everything) -> None:
    changed = with_overrides(Everything(), [override])
    assert changed == expected
    for own in dataclasses.fields(changed):
        assert type(getattr(changed, own.name)) is type(getattr(expected, own.name))


def test_the_last_override_counts_and_the_original_stays() -> None:
    original = Everything()
    changed = with_overrides(original, ["count=2", "part.level=1", "part.note=x", "count=3"])
    assert changed == Everything(count=3, part=Part(1, "x"))
    assert original == Everything()


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("coumt=1", "unknown key 'coumt'; did you mean 'count'?"),
        ("part.levle=1", "unknown key 'part.levle'; did you mean 'part.level'?"),
        ("level=1", "unknown key 'level'; did you mean 'part.level'?"),
        ("prat.level=1", "unknown key 'prat'; did you mean 'part'?"),
        ("count=many", "'count' is 'many'; it must be a whole number"),
        ("count=1.5", "'count' is '1.5'; it must be a whole number"),
        ("count=true", "'count' is 'true'; it must be a whole number"),
        ("on=1", "'on' is '1'; it must be true or false"),
        ("size_m=true", "'size_m' is 'true'; it must be a number"),
        ("numbers=1,x", "'numbers[1]' is 'x'; it must be a whole number"),
        ("pair=[1]", "'pair' has 1 items; it must have 2"),
        ("part=3", "'part' is a section; set one of its keys, such as 'part.level'"),
        ("count.level=3", "'count' is a value, not a section: it has no key 'level'"),
        ("count", "'count' sets nothing; write it like tracking.min_inliers=20"),
        (".count=1", "'.count=1' sets nothing"),
    ],
)
def test_wrong_overrides_say_what_is_wrong(override: str, message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        with_overrides(Everything(), [override])
    assert str(caught.value).startswith(message)
    assert "\n" not in str(caught.value)


def test_a_value_and_a_section_at_one_place_contradict() -> None:
    with pytest.raises(ConfigError, match="given a value before"):
        with_overrides(Everything(), ["part=1", "part.level=2"])


def test_values_of_a_file_must_have_the_right_type() -> None:
    for values, message in (
        ({"count": "3"}, "'count' is '3'; it must be a whole number"),
        ({"name": 3}, "'name' is 3; it must be text"),
        ({"numbers": 3}, "'numbers' is 3; it must be a list"),
        ({"part": {"level": [1]}}, "'part.level' is"),
    ):
        with pytest.raises(ConfigError) as caught:
            updated(Everything(), values, "my.toml")
        assert str(caught.value).startswith("my.toml: ")
        assert message in str(caught.value)


def test_changing_a_kind_starts_from_its_defaults_wherever_it_stands() -> None:
    config = SlamConfig(semantics=YoloFastestConfig(confidence=0.5))
    assert with_overrides(config, ["semantics.nms_iou=0.3"]).semantics == YoloFastestConfig(confidence=0.5, nms_iou=0.3)
    for overrides in (
        ["semantics.kind=mask-files", "semantics.folder=masks"],
        ["semantics.folder=masks", "semantics.kind=mask-files"],
    ):
        assert with_overrides(config, overrides).semantics == MaskFilesConfig(folder=Path("masks"))
    changed = with_overrides(config, ["semantics.kind=truth", "semantics.carry.enabled=true"])
    assert changed.semantics == TrueSemanticsConfig(carry=replace(CarryConfig(), enabled=True))
    # The kind that is there already resets nothing.
    assert with_overrides(config, ["semantics.kind=yolo-fastest"]) == config


def test_wrong_kinds_and_keys_of_another_kind() -> None:
    for override, words in (
        ("semantics.kind=yolo", ["'yolo'", "'yolo-fastest'", "mask-files"]),
        ("dynamics.kind=3", ["dynamics.kind is '3'"]),
        ("dynamics.motion_model_px=3", ["unknown key 'dynamics.motion_model_px'", "keep-all"]),
        ("semantics=truth", ["'semantics' is a section", "semantics.kind"]),
        ("semantics.kind=os:getcwd", ["must be a dataclass"]),
        ("semantics.kind=no_such_package_anywhere:X", ["cannot be imported"]),
        ("semantics.kind=:X", ["cannot be imported"]),
    ):
        with pytest.raises(ConfigError) as caught:
            with_overrides(SlamConfig(), [override])
        for word in words:
            assert word in str(caught.value), f"{override}: {caught.value}"


def test_a_part_of_ones_own_needs_no_registration() -> None:
    kind = "stillroom.semantics.truth:TrueSemanticsConfig"
    assert with_overrides(SlamConfig(), [f"semantics.kind={kind}"]).semantics == TrueSemanticsConfig()
    config = SlamConfig(dynamics=OwnSieveConfig(threshold_px=4.0))
    assert f'kind = "{__name__}:OwnSieveConfig"' in to_toml(config)


@dataclass(frozen=True)
class OwnSieveConfig(KeepAllConfig):
    threshold_px: float = 1.0


def test_replacing_values_leaves_the_others_alone() -> None:
    config = SlamConfig(method="x", dynamics=EpipolarConfig(min_agreeing=11), tracking=TrackerConfig(min_matches=22))
    changed = updated(config, {"tracking": {"min_inliers": 33}, "dynamics": {"keyframe_px": 1.5}})
    assert changed.tracking == TrackerConfig(min_matches=22, min_inliers=33)
    assert changed.dynamics == EpipolarConfig(min_agreeing=11, keyframe_px=1.5)
    assert changed.method == "x"


@pytest.mark.parametrize(
    ("content", "message"),
    [(None, "no such config file"), (b"a = = 1", "not a TOML file"), (b"\xff\xfe\x00", "cannot be read as text")],
)
def test_files_that_cannot_be_read(tmp_path: Path, content: bytes | None, message: str) -> None:
    file = tmp_path / "mine.toml"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(ConfigError, match=message) as caught:
        read_toml(file)
    assert str(file) in str(caught.value)


def test_toml_text_is_toml() -> None:
    values = {
        "a": 1,
        "nested": {"odd key.": [1.5, float("inf")], "deeper": {"text": "\x7f\t\"'"}},
        "after": [],
        "flag": True,
    }
    assert tomllib.loads(as_toml(values)) == values
    with pytest.raises(TypeError, match="dict"):
        as_toml({"a": [{}]})


def test_a_key_that_sets_nothing_any_more_is_ignored_and_said_so(caplog: pytest.LogCaptureFixture) -> None:
    config = SlamConfig(dynamics=EpipolarConfig())
    assert with_overrides(config, ["dynamics.min_matches=20"]) == config
    assert "'dynamics.min_matches' is ignored" in caplog.text
    with pytest.raises(ConfigError, match=r"unknown key 'mapping\.min_matches'"):
        with_overrides(config, ["mapping.min_matches=20"])


def test_a_key_that_one_kind_had_is_ignored_for_that_kind_only(caplog: pytest.LogCaptureFixture) -> None:
    """Written by versions that were told where YOLO-Fastest's own files lie."""
    old = {"semantics": {"kind": "yolo-fastest", "confidence": 0.5, "folder": ""}}
    assert updated(SlamConfig(), old, "old.toml").semantics == YoloFastestConfig(confidence=0.5)
    assert "'semantics.folder' is ignored" in caplog.text
    boxes = ["semantics.kind=onnx-boxes", "semantics.layout=darknet"]
    assert with_overrides(SlamConfig(), [*boxes, "semantics.darknet_cfg=my.cfg"]) == with_overrides(SlamConfig(), boxes)
    for kind, key in (("nothing", "folder"), ("onnx-boxes", "folder"), ("yolo-fastest", "darknet_cfg")):
        with pytest.raises(ConfigError, match=rf"unknown key 'semantics\.{key}'"):
            with_overrides(SlamConfig(), [f"semantics.kind={kind}", f"semantics.{key}=x"])
