"""The kernels and types that a warm-up is known to need, `signatures.json`: what is known, several processes compile.

The list is a hint. What it lacks is compiled by the warm-up's own run, and what no longer fits is left out, so that one
that is out of date costs time and nothing else. `python -m stillroom.warmup` rewrites it, in a few minutes.
"""

import importlib
import json
import re
from importlib.resources import files
from typing import Any

from numba import types
from numba.core.registry import CPUDispatcher

NAME = "signatures.json"
LAYOUTS = {"C": "::1", "A": ":"}
_ARRAY = re.compile(r"(\w+)(?:\[([:,1 ]+)\])?")

Signature = tuple[Any, ...]
"""Numba's types of a kernel's arguments."""


def listed() -> dict[str, list[Signature]]:
    """Return the signatures of each kernel, by module and name; without those that name what is no longer there."""
    text = (files("stillroom.warmup") / NAME).read_text(encoding="utf-8")
    found: dict[str, list[Signature]] = {}
    for name, signatures in json.loads(text).items():
        for signature in signatures:
            try:
                found.setdefault(name, []).append(tuple(map(type_of, signature)))
            except (AttributeError, ImportError, ValueError):  # a class that was renamed, or is another one now
                continue
    return found


def kernel_of(name: str) -> Any:
    """Return the kernel of a module and a name; None where there is none."""
    module, _, inner = name.rpartition(".")
    try:
        kernel = getattr(importlib.import_module(module), inner, None)
    except ImportError:
        return None
    return kernel if isinstance(kernel, CPUDispatcher) else None


# Types as JSON: "float64", "float64[:, ::1]", a list for a tuple, {"class": …, "of": […]} for a named one.


def described(kind: Any) -> Any:
    """Return a type as `type_of` takes it.

    Raises:
        ValueError: It is of a sort that no list holds, such as a literal: kernels pass these to each other.
    """
    if isinstance(kind, types.BaseNamedTuple):
        place = f"{kind.instance_class.__module__}:{kind.instance_class.__qualname__}"
        return {"class": place, "of": [described(each) for each in kind]}
    if isinstance(kind, types.BaseTuple):
        return [described(each) for each in kind]
    if isinstance(kind, types.Array) and kind.layout in LAYOUTS and kind.mutable and kind.aligned:
        axes = [":"] * (kind.ndim - 1) + [LAYOUTS[kind.layout]]
        return f"{described(kind.dtype)}[{', '.join(axes)}]"
    if isinstance(kind, types.Number | types.Boolean) and getattr(types, str(kind), None) == kind:
        return str(kind)
    raise ValueError(f"{kind!r} cannot be listed")


def type_of(description: Any) -> Any:
    """Return numba's type of a description.

    Raises:
        AttributeError, ImportError, ValueError: It names what is not there.
    """
    if isinstance(description, dict):
        module, _, name = description["class"].partition(":")
        named = getattr(importlib.import_module(module), name)
        inner = [type_of(each) for each in description["of"]]
        if len(inner) != len(named._fields):
            raise ValueError(f"{name} has {len(named._fields)} fields, not {len(inner)}")
        return types.BaseTuple.from_types(inner, named)
    if isinstance(description, list):
        return types.BaseTuple.from_types([type_of(each) for each in description])
    match = _ARRAY.fullmatch(description)
    if match is None:
        raise ValueError(f"'{description}' is no type")
    scalar = getattr(types, match[1])
    if match[2] is None:
        return scalar
    layout = "C" if match[2].endswith(LAYOUTS["C"]) else "A"
    return types.Array(scalar, match[2].count(",") + 1, layout)


def as_text(signatures: dict[str, list[Signature]]) -> str:
    """Return the list as JSON, a signature a line; without those that cannot be listed."""
    blocks = []
    for name in sorted(signatures):
        lines = []
        for signature in signatures[name]:
            try:
                lines.append("    " + json.dumps([described(kind) for kind in signature]))
            except ValueError:  # a literal, which a kernel that is listed hands on to this one
                continue
        if lines:
            blocks.append(f'  "{name}": [\n' + ",\n".join(sorted(lines)) + "\n  ]")
    return "{\n" + ",\n".join(blocks) + "\n}\n"
