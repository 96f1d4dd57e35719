"""A nested mapping as TOML; the standard library only reads it."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any


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
        raise TypeError(f"{type(value).__name__} has no place in a TOML file")
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
