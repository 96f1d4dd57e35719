"""Commands that installed packages add, by entry points of the group `stillroom.commands`.

The name of an entry point is the command, its value a function, or a Typer app for a command with commands of its
own. A dot stands between two words: `train.pspnet` is `stillroom train pspnet`, and `export.pspnet` gives
`stillroom export` a second word. The list of commands imports what entry points name, for their summaries; modules
that hold commands import nothing heavy.
"""

import inspect
from collections.abc import Iterable, Mapping
from importlib.metadata import EntryPoint
from typing import Any, TypeAlias

import typer

from stillroom.errors import ConfigError
from stillroom.plugins import PluginGroup

ALONE = ""
"""The second word of a command that is one word."""

BySecondWord: TypeAlias = Mapping[str, EntryPoint]


def _is_command(found: object) -> bool:
    return callable(found) and not isinstance(found, type)


GROUP: PluginGroup[Any] = PluginGroup("stillroom.commands", "command", "a function or a Typer app", _is_command)


def installed(own: Iterable[str]) -> dict[str, BySecondWord]:
    """Return the entry points by first and second word; none is imported.

    Args:
        own: Names of Stillroom's own commands, with a dot between two words.

    Raises:
        ConfigError: A name is taken.
    """
    found: dict[str, dict[str, EntryPoint]] = {}
    for name, entry in GROUP.by_entry_name(own).items():
        first, _, second = name.partition(".")
        found.setdefault(first, {})[second] = entry
    return dict(found)


def summary_of(commands: BySecondWord) -> str:
    """Return the summary of the commands with one first word; of one that cannot be imported, the error."""
    entries = [commands[ALONE]] if ALONE in commands else commands.values()
    return " ".join(map(_summary, entries))


def _summary(entry: EntryPoint) -> str:
    try:
        loaded = GROUP.load(entry)
    except ConfigError as error:
        return str(error)
    text = loaded.info.help if isinstance(loaded, typer.Typer) else inspect.getdoc(loaded)
    return text.partition("\n")[0] if isinstance(text, str) else ""
