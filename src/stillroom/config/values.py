"""One value of a configuration, made to fit the type of its field."""

import tomllib
import types
import typing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stillroom.errors import ConfigError

WORDS: dict[object, str] = {
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    str: "text",
    Path: "a path",
}


@dataclass(frozen=True)
class Written:
    """A value as written on the command line, before the type of its field is known."""

    text: str

    def read(self) -> Any:
        """Return the value as TOML reads it; the bare text where that is no TOML."""
        try:
            return tomllib.loads(f"value = {self.text}")["value"]
        except tomllib.TOMLDecodeError:
            return self.text


def convert(value: Any, kind: Any, name: str) -> Any:
    """Return a value of a field's type; "" is None where the type allows it.

    Args:
        value: From TOML, or `Written`.
        kind: The type of the field.
        name: Dotted name, for messages.

    Raises:
        ConfigError: It does not fit.
    """
    origin = typing.get_origin(kind)
    if origin in (types.UnionType, typing.Union):
        inner = next(choice for choice in typing.get_args(kind) if choice is not types.NoneType)
        return None if _is_empty(value) else convert(value, inner, name)
    if origin is tuple:
        return _tuple(value, typing.get_args(kind), name)
    plain = value.read() if isinstance(value, Written) else value
    if kind in (str, Path):
        # 1.1 and 2024-01-01 are fine names, though TOML reads them as something else.
        text = value.text if isinstance(value, Written) and not isinstance(plain, str) else plain
        if not isinstance(text, str):
            raise _wrong(value, kind, name)
        return Path(text).expanduser() if kind is Path else text
    if kind is float and isinstance(plain, int) and not isinstance(plain, bool):
        return float(plain)
    if kind not in WORDS:
        raise TypeError(f"{name}: a config field cannot be of type {kind}")
    if type(plain) is not kind:
        raise _wrong(value, kind, name)
    return plain


def _tuple(value: Any, kinds: tuple[Any, ...], name: str) -> tuple[Any, ...]:
    items = value.read() if isinstance(value, Written) else value
    if isinstance(value, Written) and not isinstance(items, list):
        items = [Written(part.strip()) for part in value.text.split(",") if part.strip()]
    if not isinstance(items, list | tuple):
        raise ConfigError(f"'{name}' is {items!r}; it must be a list")
    if len(kinds) == 2 and kinds[1] is Ellipsis:
        kinds = (kinds[0],) * len(items)
    if len(items) != len(kinds):
        raise ConfigError(f"'{name}' has {len(items)} items; it must have {len(kinds)}")
    return tuple(convert(item, kind, f"{name}[{i}]") for i, (item, kind) in enumerate(zip(items, kinds, strict=True)))


def _is_empty(value: Any) -> bool:
    return value is None or value == "" or (isinstance(value, Written) and value.read() == "")


def _wrong(value: Any, kind: Any, name: str) -> ConfigError:
    shown = f"'{value.text}'" if isinstance(value, Written) else repr(value)
    return ConfigError(f"'{name}' is {shown}; it must be {WORDS[kind]}")
