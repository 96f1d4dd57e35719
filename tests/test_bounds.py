"""Bounds of settings: at their edges, in tuples, in sections, and with the name that the user wrote."""

import dataclasses
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from stillroom.bounds import BOUNDS, PIXELS, Bounds, bounded, check, in_pixels_of
from stillroom.config import SlamConfig, with_overrides
from stillroom.errors import ConfigError
from stillroom.presets.registry import OWN, configure
from stillroom.system import build
from stillroom.testing.tiny_sequence import TINY_CAMERA


@pytest.mark.parametrize(
    ("bounds", "fits", "not_", "words"),
    [
        (Bounds(least=1), (1, 7), (0, -3), "it must be 1 or more"),
        (Bounds(above=0.0), (1e-9,), (0.0, -1.0), "it must be above 0"),
        (Bounds(most=0), (0, -6), (1,), "it must be at most 0"),
        (Bounds(least=0, most=1), (0.0, 1.0), (-0.1, 1.1), "it must be from 0 to 1"),
        (Bounds(above=0, most=1), (1.0, 0.1), (0.0, 1.01), "it must be above 0 and at most 1"),
        (Bounds(above=0, below=1), (0.5,), (0.0, 1.0), "it must be above 0 and below 1"),
        (Bounds(least=0, below=1), (0.0,), (1.0,), "it must be 0 or more and below 1"),
        (Bounds(one_of=("a", "b")), ("a", "b"), ("c", ""), "it must be one of a, b"),
    ],
)
def test_each_kind_of_bound(bounds: Bounds, fits: tuple, not_: tuple, words: str) -> None:
    assert [bounds.problem(value) for value in fits] == [None] * len(fits)
    assert [bounds.problem(value) for value in not_] == [words] * len(not_)
    assert bounds.problem(None) is None, "no value"
    assert bounds.problem(fits) is None
    assert bounds.problem((*fits, *not_)) == words.replace("it must", "each of its values must")


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_what_is_no_finite_number_fits_no_bound(value: float) -> None:
    assert Bounds(above=0).problem(value) == "it must be above 0"
    assert Bounds(most=0).problem(value) == "it must be at most 0"


@dataclass(frozen=True)
class Inner:
    near_m: float = bounded(0.1, least=0)
    far_m: float = bounded(5.0, above=0)

    def contradiction(self) -> tuple[str, str] | None:
        return None if self.near_m < self.far_m else ("far_m", "near_m")


@dataclass(frozen=True)
class Outer:
    inner: Inner = field(default_factory=Inner)
    free: float = -1.0


def test_messages_have_the_dotted_name() -> None:
    check(Outer())
    for inner, name, said in (
        (Inner(near_m=-1.0), "", r"^'inner\.near_m' is -1\.0; it must be 0 or more$"),
        (Inner(near_m=7.0), "dense", r"^'dense\.inner\.far_m' is 5\.0; it must be above 'dense\.inner\.near_m', 7$"),
    ):
        with pytest.raises(ConfigError, match=said):
            check(Outer(inner), name)


def bounded_keys(config: object, path: tuple[str, ...] = ()) -> list[tuple[str, Bounds, object]]:
    """Every bounded setting of a tree: its dotted name, its bounds, and its value."""
    found = []
    for one in dataclasses.fields(config):  # type: ignore[arg-type]
        value, own = getattr(config, one.name), (*path, one.name)
        if dataclasses.is_dataclass(value):
            found += bounded_keys(value, own)
        elif BOUNDS in one.metadata:
            found.append((".".join(own), one.metadata[BOUNDS], value))
    return found


def outside(bounds: Bounds) -> float | str | None:
    """A value just outside."""
    if bounds.one_of:
        return "no-such-thing"
    if bounds.least is not None:
        return bounds.least - 1
    if bounds.above is not None:
        return bounds.above
    return None if bounds.most is None else bounds.most + 1


@pytest.mark.parametrize("config", [method.config for method in OWN], ids=lambda config: config.method)
def test_every_bounded_setting_of_every_preset_is_refused_by_its_dotted_name(config: SlamConfig) -> None:
    keys = bounded_keys(config)
    assert len(keys) > 60
    for name, bounds, value in keys:
        wrong = outside(bounds)
        text = f"{float(wrong)!r}" if isinstance(value, float) else str(wrong)
        if isinstance(value, tuple):
            text = ",".join([f"{float(wrong)!r}" if isinstance(value[0], float) else str(wrong)] * len(value))
        with pytest.raises(ConfigError, match=rf"^'{name}' is "):
            with_overrides(config, [f"{name}={text}"])


def test_what_a_file_says_may_be_sound_with_the_command_line_only(tmp_path: Path) -> None:
    file = tmp_path / "far.toml"
    file.write_text("[features]\nmin_depth_m = 25.0\n")
    assert configure("orb-slam2", file, ["features.max_depth_m=30"]).features.max_depth_m == 30.0
    with pytest.raises(
        ConfigError, match=r"^'features\.max_depth_m' is 20\.0; it must be above 'features\.min_depth_m', 25$"
    ):
        configure("orb-slam2", file)


def test_a_config_made_in_python_is_checked_when_it_is_built() -> None:
    config = configure("orb-slam2")
    config = dataclasses.replace(config, features=dataclasses.replace(config.features, n_levels=0))
    with pytest.raises(ConfigError, match=r"^'features\.n_levels' is 0; it must be 1 or more$"):
        build(config, TINY_CAMERA)


ON_LEVELS = {
    "dynamics.boxes.keyframe_px",
    "dynamics.boxes.local_map_px",
    "dynamics.boxes.motion_model_px",
    "dynamics.search_px",
    "joining.verification.window_px",
    "loops.verification.window_px",
    "low_cost.window_px",
    "recovery.recognition.narrow_px",
    "recovery.recognition.wide_px",
    "tracking.window_px",
}
"""Settings in pixels of the finest level of the pyramid, which is 640 pixels long in images of any size."""
OF_NETWORKS = {"semantics.longer_side_px", "semantics.offset_px", "semantics.step_px", "semantics.input_px"}
"""Settings in pixels of a network's input."""
PARTS = (
    [],
    ["semantics.kind=mask-files"],
    ["semantics.kind=onnx-masks"],
    ["semantics.kind=onnx-boxes"],
    ["semantics.kind=onnx-instances"],
    ["dense.kind=octomap"],
    ["dynamics.kind=paper-epipolar"],
    ["dynamics.kind=multiview-code"],
)


def settings(config: object, path: str = "") -> dict[str, tuple[int, object]]:
    """Every setting of a tree by its dotted name: whether it grows with pixels or their squares, and its value."""
    found: dict[str, tuple[int, object]] = {}
    for one in dataclasses.fields(config):  # type: ignore[arg-type]
        value, name = getattr(config, one.name), f"{path}{one.name}"
        own = settings(value, f"{name}.") if dataclasses.is_dataclass(value) else {}
        found |= own or {name: (one.metadata.get(PIXELS, 0), value)}
    return found


@pytest.mark.parametrize("config", [method.config for method in OWN], ids=lambda config: config.method)
@pytest.mark.parametrize("parts", PARTS, ids=str)
def test_every_setting_in_pixels_says_how_it_grows_with_the_image(config: SlamConfig, parts: list[str]) -> None:
    config = with_overrides(config, parts)
    given, doubled = settings(config), settings(in_pixels_of(config, 2.0))
    for name, (power, value) in given.items():
        if name.split(".")[-1].endswith(("_px", "stride")) and name not in ON_LEVELS | OF_NETWORKS:
            assert power == (2 if name.endswith(("min_px", "area_px", "box_px")) else 1), f"{name} does not grow"
        assert doubled[name] == (power, value * 2**power if power else value), name
        assert type(doubled[name][1]) is type(value), name
    assert sum(power > 0 for power, _ in given.values()) >= 2


def test_at_the_usual_size_a_config_is_taken_as_it_is() -> None:
    config = configure("pspnet-slam")
    assert in_pixels_of(config, 1.0) is config


def test_in_small_images_lengths_in_pixels_stay_possible() -> None:
    config = in_pixels_of(configure("pspnet-slam"), 0.1)
    check(config)
    assert all(value for power, value in settings(config).values() if power)
