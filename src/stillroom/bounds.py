"""Bounds of settings, declared beside them, so that every message names a setting as the user wrote it.

    @dataclass(frozen=True)
    class MyConfig:
        share: float = bounded(0.5, above=0.0, below=1.0)
        search: str = bounded("reverse", one_of=("reverse", "exhaustive"))

`check` walks a whole tree of configs. It is called when settings are read, and when a system is built.
"""

import dataclasses
import math
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar, runtime_checkable

from stillroom.errors import ConfigError

C = TypeVar("C")

BOUNDS = "bounds"
PIXELS = "pixels"
"""The keys of a field's metadata."""


@dataclass(frozen=True)
class Bounds:
    """What a setting may be; of a tuple, each of its items.

    Attributes:
        least, most: Smallest and largest value.
        above, below: Exclusive bounds.
        one_of: The allowed values.
    """

    least: float | None = None
    above: float | None = None
    most: float | None = None
    below: float | None = None
    one_of: tuple[str, ...] = ()

    def problem(self, value: Any) -> str | None:
        """Return what a value must be, in words, where it is not; None always fits."""
        if value is None:
            return None
        if isinstance(value, tuple | list):
            fits = all(self._fits(item) for item in value)
            return None if fits else f"each of its values must be {self._words()}"
        return None if self._fits(value) else f"it must be {self._words()}"

    def _fits(self, value: Any) -> bool:
        if self.one_of:
            return value in self.one_of
        return (
            _is_finite(value)
            and (self.least is None or value >= self.least)
            and (self.above is None or value > self.above)
            and (self.most is None or value <= self.most)
            and (self.below is None or value < self.below)
        )

    def _words(self) -> str:
        if self.one_of:
            return f"one of {', '.join(self.one_of)}"
        if self.least is not None and self.most is not None:
            return f"from {self.least:g} to {self.most:g}"
        lower = f"above {self.above:g}" if self.above is not None else ""
        if self.least is not None:
            lower = f"{self.least:g} or more"
        upper = f"below {self.below:g}" if self.below is not None else ""
        if self.most is not None:
            upper = f"at most {self.most:g}"
        return " and ".join(part for part in (lower, upper) if part) or "a finite number"


@runtime_checkable
class Contradictory(Protocol):
    """A config whose settings may contradict each other."""

    def contradiction(self) -> tuple[str, str] | None:
        """Return the key of a setting, and of the one that it must be above and is not; None where all fit."""


def bounded(
    default: Any,
    *,
    least: float | None = None,
    above: float | None = None,
    most: float | None = None,
    below: float | None = None,
    one_of: tuple[str, ...] = (),
    pixels: int = 0,
) -> Any:
    """Return a field of a config dataclass with a default and bounds; see `Bounds`.

    Args:
        default: Its value where none is given.
        least: See `Bounds`, as for the others.
        above: See there.
        most: See there.
        below: See there.
        one_of: See there.
        pixels: 1 for a length in pixels and 2 for an area, of images 640 pixels long; see `in_pixels_of`.
    """
    bounds = Bounds(least, above, most, below, tuple(one_of))
    return field(default=default, metadata={BOUNDS: bounds, PIXELS: pixels})


def in_pixels_of(config: C, scale: float) -> C:
    """Return a config whose lengths and areas in pixels, which are those of images 640 pixels long, fit other images.

    Whole numbers stay whole, and do not become 0. What is written beside results stays as the user gave it.

    Args:
        config: A dataclass.
        scale: `Camera.pixel_scale`; at 1 the config is returned as it is.
    """
    if scale == 1.0:
        return config
    changed: dict[str, Any] = {}
    whole: Any = config
    for one in dataclasses.fields(whole):
        value, power = getattr(config, one.name), one.metadata.get(PIXELS, 0)
        if dataclasses.is_dataclass(value) and not isinstance(value, type):
            changed[one.name] = in_pixels_of(value, scale)
        elif power and isinstance(value, int):
            changed[one.name] = max(1, round(value * scale**power)) if value > 0 else value
        elif power:
            changed[one.name] = value * scale**power
    fitted: C = dataclasses.replace(whole, **changed)
    return fitted


def check(config: Any, name: str = "", relations: bool = True) -> None:
    """Check that a config, and those in it, are within their bounds.

    Args:
        config: A dataclass.
        name: Dotted name of its section; "" for a whole tree.
        relations: Whether settings must not contradict each other; not yet, where more settings may still come.

    Raises:
        ConfigError: A setting is not; the message has its dotted name.
    """
    for one in dataclasses.fields(config):
        value = getattr(config, one.name)
        dotted = f"{name}.{one.name}" if name else one.name
        if dataclasses.is_dataclass(value) and not isinstance(value, type):
            check(value, dotted, relations)
        elif BOUNDS in one.metadata:
            _refuse(dotted, value, one.metadata[BOUNDS].problem(value))
    if relations and isinstance(config, Contradictory) and (found := config.contradiction()) is not None:
        key, lower = ((f"{name}.{one}" if name else one) for one in found)
        _refuse(key, getattr(config, found[0]), f"it must be above '{lower}', {getattr(config, found[1]):g}")


def _refuse(dotted: str, value: Any, words: str | None) -> None:
    if words is not None:
        shown = f"'{value}'" if isinstance(value, str) else value
        raise ConfigError(f"'{dotted}' is {shown}; {words}")


def _is_finite(value: float) -> bool:
    """Return whether a number is finite and not too large for a float, as a whole number can be."""
    try:
        return math.isfinite(value)
    except OverflowError:
        return False
