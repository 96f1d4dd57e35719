"""Plug-ins of installed packages: one group of entry points for each socket that accepts them.

A package names what it adds in its `pyproject.toml`; `CONTRIBUTING.md` shows the lines of each group::

    [project.entry-points."stillroom.methods"]
    my-slam = "my_package.my_slam:METHOD"
"""

import functools
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Generic, TypeVar

from stillroom.errors import ConfigError

T = TypeVar("T")


@dataclass(frozen=True)
class PluginGroup(Generic[T]):
    """A group of entry points.

    Attributes:
        group: Its name, such as "stillroom.methods".
        noun: What an entry point of it adds, for messages.
        must_be: What it must name, for messages.
        accepts: Whether an object is what it must name.
    """

    group: str
    noun: str
    must_be: str
    accepts: Callable[[object], bool]

    def all_with(self, own: Iterable[T], name_of: Callable[[T], str]) -> dict[str, T]:
        """Return Stillroom's own objects by name, and after them those of all installed packages.

        Args:
            own: Stillroom's own.
            name_of: Returns the name of an object; that of its entry point does not count.

        Raises:
            ConfigError: An entry point cannot be imported, names something of another type, or has a name that is
                taken.
        """
        found = {name_of(one): one for one in own}
        for entry in self._entries():
            offered = self.load(entry)
            self._refuse_taken(entry, name_of(offered), found)
            found[name_of(offered)] = offered
        return found

    def by_entry_name(self, own: Iterable[str]) -> dict[str, EntryPoint]:
        """Return the entry points by their names, none imported yet.

        Args:
            own: Names of Stillroom's own.

        Raises:
            ConfigError: A name is taken.
        """
        taken = set(own)
        found: dict[str, EntryPoint] = {}
        for entry in self._entries():
            self._refuse_taken(entry, entry.name, taken | found.keys())
            found[entry.name] = entry
        return found

    def load(self, entry: EntryPoint) -> T:
        """Import what an entry point names.

        Raises:
            ConfigError: It cannot be imported, or is of another type.
        """
        try:
            offered: T = entry.load()
        except Exception as error:  # a foreign package may fail in any way when it is imported
            reason = " ".join(f"{type(error).__name__}: {error}".split())  # on one line
            raise ConfigError(
                f"{_origin(entry)}: cannot be imported ({reason}); repair or uninstall that package"
            ) from error
        if not self.accepts(offered):
            what = f"class {offered.__name__}" if isinstance(offered, type) else type(offered).__name__
            raise ConfigError(f"{_origin(entry)}: '{entry.value}' is a {what}; it must be {self.must_be}")
        return offered

    def _entries(self) -> list[EntryPoint]:
        """Return the entry points in an order that does not depend on that of the installed packages on disk."""
        found = _installed(tuple(sys.path)).select(group=self.group)
        return sorted(found, key=lambda entry: (entry.name, entry.value))

    def _refuse_taken(self, entry: EntryPoint, name: str, taken: Iterable[str]) -> None:
        if name in taken:
            raise ConfigError(f"{_origin(entry)}: there is a {self.noun} '{name}' already; it needs another name")


@functools.lru_cache(maxsize=1)
def _installed(search_path: tuple[str, ...]) -> Any:
    """Return the entry points of all packages on `sys.path`, read once: that opens a file of each package."""
    return entry_points()


def _origin(entry: EntryPoint) -> str:
    package = entry.dist.name if entry.dist else "an unknown package"
    return f"entry point '{entry.name}' of {package}, group {entry.group}"
