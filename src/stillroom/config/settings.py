"""Read, write and override a tree of config dataclasses.

A field that is a dataclass is a section. A field whose metadata names `Kinds` is a socket: a section whose key `kind`
chooses the class, and with it the other keys. Values are bool, int, float, str, tuples of those, or a path.
"""

import dataclasses
import json
import logging
import re
import tomllib
import types
import typing
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from difflib import SequenceMatcher
from pathlib import Path
from typing import Any, TypeVar

from stillroom.bounds import check
from stillroom.config.kinds import KIND, Kinds
from stillroom.data.text import read_text
from stillroom.errors import ConfigError

WORDS: dict[object, str] = {
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    str: "text",
    Path: "a path",
}
C = TypeVar("C")
log = logging.getLogger(__name__)
RETIRED: Mapping[str, str] = {
    r"dynamics(\.\w+)?\.min_matches": "how many matches a sieve must leave is the same for all sieves now",
    r"semantics=yolo-fastest\.folder": "YOLO-Fastest comes with Stillroom; convert a network of your own with "
    "'stillroom export yolo' and set semantics.model to the file",
    r"semantics=onnx-boxes\.darknet_cfg": "the ONNX file names its anchors; make it with 'stillroom export yolo'",
}
"""Keys of earlier versions that set nothing any more, and why: patterns of their dotted names, with `=kind` after the
section where one kind alone had the key."""
PROVENANCE = "run"
"""The table of a results folder's config.toml that says how it came about; it configures nothing."""


# A nested mapping as TOML; the standard library only reads it.


def as_toml(values: Mapping[str, Any], comments: Mapping[str, str] | None = None) -> str:
    """Return TOML text of scalars, lists of scalars and nested mappings.

    Args:
        values: What to write; None becomes "", TOML having no word for it.
        comments: Remarks by dotted key, written behind the value.
    """
    return "\n".join(_section(values, "", comments or {})) + "\n"


def scalar(value: object) -> str:
    """Return one value as TOML."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, list | tuple):
        return f"[{', '.join(scalar(item) for item in value)}]"
    text = "" if value is None else str(value) if isinstance(value, str | Path) else None
    if text is None:
        raise TypeError(f"{type(value).__name__} cannot be written as TOML")
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _section(values: Mapping[str, Any], path: str, comments: Mapping[str, str]) -> list[str]:
    lines = []
    for key, value in values.items():
        if not isinstance(value, Mapping):
            remark = comments.get(f"{path}{key}")
            lines.append(f"{_key(key)} = {scalar(value)}" + (f"  # {remark}" if remark else ""))
    for key, value in values.items():
        if isinstance(value, Mapping):
            header = f"{path}{_key(key)}"
            lines += ["", f"[{header}]", *_section(value, f"{header}.", comments)]
    return lines


def _key(key: str) -> str:
    bare = key.isascii() and key.replace("-", "").replace("_", "").isalnum()
    return key if bare else json.dumps(key, ensure_ascii=False)


# One value of a configuration, made to fit the type of its field.


@dataclass(frozen=True)
class WrittenValue:
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
        value: From TOML, or `WrittenValue`.
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
    plain = value.read() if isinstance(value, WrittenValue) else value
    if kind in (str, Path):
        # 1.1 and 2024-01-01 are fine names, though TOML reads them as something else.
        text = value.text if isinstance(value, WrittenValue) and not isinstance(plain, str) else plain
        if not isinstance(text, str):
            raise _wrong(value, kind, name)
        return Path(text).expanduser() if kind is Path else text
    if kind is float and isinstance(plain, int) and not isinstance(plain, bool):
        try:
            return float(plain)
        except OverflowError:
            raise _wrong(value, kind, name) from None
    if kind not in WORDS:
        raise TypeError(f"{name}: a config field cannot be of type {kind}")
    if type(plain) is not kind:
        raise _wrong(value, kind, name)
    return plain


def _tuple(value: Any, kinds: tuple[Any, ...], name: str) -> tuple[Any, ...]:
    items = value.read() if isinstance(value, WrittenValue) else value
    if isinstance(value, WrittenValue) and not isinstance(items, list):
        items = [WrittenValue(part.strip()) for part in value.text.split(",") if part.strip()]
    if not isinstance(items, list | tuple):
        raise ConfigError(f"'{name}' is {items!r}; it must be a list")
    if len(kinds) == 2 and kinds[1] is Ellipsis:
        kinds = (kinds[0],) * len(items)
    if len(items) != len(kinds):
        raise ConfigError(f"'{name}' has {len(items)} items; it must have {len(kinds)}")
    return tuple(convert(item, kind, f"{name}[{i}]") for i, (item, kind) in enumerate(zip(items, kinds, strict=True)))


def _is_empty(value: Any) -> bool:
    return value is None or value == "" or (isinstance(value, WrittenValue) and value.read() == "")


def _wrong(value: Any, kind: Any, name: str) -> ConfigError:
    shown = f"'{value.text}'" if isinstance(value, WrittenValue) else repr(value)
    return ConfigError(f"'{name}' is {shown}; it must be {WORDS[kind]}")


def to_values(config: Any) -> dict[str, Any]:
    """Return a config as nested mappings, sockets with their `kind`."""
    values: dict[str, Any] = {}
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if dataclasses.is_dataclass(value):
            kinds = _kinds(field)
            chosen = {} if kinds is None else {KIND: kinds.name_of(value)}
            values[field.name] = chosen | to_values(value)
        else:
            values[field.name] = value
    return values


def to_toml(config: Any, provenance: Mapping[str, Any] | None = None) -> str:
    """Return a config as TOML that `read_toml` and `updated` make the same config of.

    Args:
        config: The tree.
        provenance: How it came about; written below, and not read back.
    """
    values = to_values(config) | ({PROVENANCE: provenance} if provenance else {})
    remarks = {
        f"{field.name}.{KIND}": " | ".join(kinds.names())
        for field in dataclasses.fields(config)
        if (kinds := _kinds(field)) is not None
    }
    return as_toml(values, remarks)


def read_toml(path: Path) -> dict[str, Any]:
    """Read a config file as nested mappings for `updated`.

    Raises:
        ConfigError: The file is missing or no TOML.
    """
    try:
        values = tomllib.loads(read_text(path))
    except (FileNotFoundError, IsADirectoryError):
        raise ConfigError(f"{path}: no such config file") from None
    except (OSError, UnicodeError) as error:
        raise ConfigError(f"{path}: cannot be read as text ({error})") from error
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{path}: not a TOML file: {error}") from error
    values.pop(PROVENANCE, None)
    return values


def updated(config: C, values: Mapping[str, Any], source: str = "") -> C:
    """Return a config with some values replaced.

    Where a socket's `kind` changes, its other keys start from the new kind's defaults.

    Args:
        config: The tree.
        values: Nested mappings.
        source: Their source, such as a file; prefix of error messages.

    Raises:
        ConfigError: A key is unknown (the message names the nearest), or a value has the wrong type.
    """
    try:
        changed: C = _updated(config, values, ())
        check(changed, relations=False)  # a file and the command line may be sound together only
        return changed
    except ConfigError as error:
        if not source:
            raise
        raise ConfigError(f"{source}: {error}") from None


def with_overrides(config: C, overrides: Iterable[str]) -> C:
    """Return a config with `section.key=value` applied; of a key that comes twice, the last counts.

    Values are written as in TOML; text needs no quotes, and a list may be written with commas alone.

    Raises:
        ConfigError: An override is malformed, its key unknown, or its value of the wrong type.
    """
    tree: dict[str, Any] = {}
    for override in overrides:
        key, equals, text = override.partition("=")
        parts = [part.strip() for part in key.split(".")]
        if not equals or not all(parts):
            raise ConfigError(f"'{override}' sets nothing; write it like tracking.min_inliers=20")
        section = tree
        for part in parts[:-1]:
            inner = section.setdefault(part, {})
            if not isinstance(inner, dict):
                raise ConfigError(f"'{override}': {part} was given a value before, so it has no keys")
            section = inner
        section[parts[-1]] = WrittenValue(text.strip())
    return updated(config, tree)


def _updated(config: Any, values: Mapping[str, Any], path: tuple[str, ...], kind: str = "") -> Any:
    fields = {field.name: field for field in dataclasses.fields(config) if field.init}
    hints = typing.get_type_hints(type(config))
    changes: dict[str, Any] = {}
    for key, value in values.items():
        name = ".".join((*path, key))
        if key not in fields:
            if _is_retired(name, f"{'.'.join(path)}={kind}.{key}"):
                continue
            raise ConfigError(f"unknown key '{name}'; did you mean '{_nearest(config, name, path)}'?")
        present, kinds = getattr(config, key), _kinds(fields[key])
        if not dataclasses.is_dataclass(present):
            if isinstance(value, Mapping):
                raise ConfigError(f"'{name}' is a value, not a section: it has no key '{next(iter(value), '')}'")
            changes[key] = convert(value, hints[key], name)
            continue
        section = value.read() if isinstance(value, WrittenValue) else value
        if not isinstance(section, Mapping):
            raise ConfigError(
                f"'{name}' is a section; set one of its keys, such as '{_first_key(present, kinds, name)}'"
            )
        if kinds is None:
            changes[key] = _updated(present, section, (*path, key))
        else:
            changes[key] = _plugged(kinds, present, section, (*path, key))
    return dataclasses.replace(config, **changes)


def _is_retired(name: str, name_with_kind: str) -> bool:
    """Return whether a key was a setting once; a warning says that it is ignored."""
    names = (name, name_with_kind)
    reason = next((why for pattern, why in RETIRED.items() if any(re.fullmatch(pattern, each) for each in names)), None)
    if reason is not None:
        log.warning("'%s' is ignored: %s", name, reason)
    return reason is not None


def _plugged(kinds: Kinds, present: Any, values: Mapping[str, Any], path: tuple[str, ...]) -> Any:
    """Return the config in a socket, of another class where `kind` changes it."""
    if KIND in values:
        chosen = kinds.find(convert(values[KIND], str, ".".join((*path, KIND))))
        if chosen is not type(present):
            present = chosen()
    own = {key: value for key, value in values.items() if key != KIND}
    try:
        return _updated(present, own, path, kinds.name_of(present))
    except ConfigError as error:
        raise ConfigError(f"{error} (with {'.'.join(path)}.{KIND} = '{kinds.name_of(present)}')") from None


def _kinds(field: Any) -> Kinds | None:
    found: Kinds | None = field.metadata.get("kinds")
    return found


def _keys(config: Any, path: tuple[str, ...]) -> list[str]:
    """Return the dotted names of all values of a tree."""
    names = []
    for field in dataclasses.fields(config):
        value, own = getattr(config, field.name), (*path, field.name)
        if dataclasses.is_dataclass(value):
            if _kinds(field) is not None:
                names.append(".".join((*own, KIND)))
            names += _keys(value, own)
        else:
            names.append(".".join(own))
    return names


def _first_key(section: Any, kinds: Kinds | None, name: str) -> str:
    return f"{name}.{KIND}" if kinds is not None else _keys(section, (name,))[0]


def _nearest(config: Any, wrong: str, path: tuple[str, ...]) -> str:
    """Return the name most like a wrong one; its last part, without a section, counts as much as the whole."""

    def likeness(name: str) -> float:
        whole = SequenceMatcher(None, wrong, name).ratio()
        last = SequenceMatcher(None, wrong.rpartition(".")[2], name.rpartition(".")[2]).ratio()
        return max(whole, last)

    sections = [".".join((*path, field.name)) for field in dataclasses.fields(config)]
    return max([*sections, *_keys(config, path)], key=likeness, default=f"{'.'.join(path)}.{KIND}")
