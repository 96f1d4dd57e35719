"""A disk that fills up."""

import builtins
import errno
import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest


class FullDisk:
    """Lets no more than `n` writes into files below a folder succeed; the others find no room.

    Attributes:
        n_tried: How many were tried.
    """

    def __init__(self, folder: Path, n: float) -> None:
        self.folder, self.n, self.n_tried = folder.resolve(), n, 0

    def take(self) -> None:
        """Take room for one write, if there is any."""
        self.n_tried += 1
        if self.n_tried > self.n:
            raise OSError(errno.ENOSPC, "No space left on device")

    @contextmanager
    def mounted(self) -> Iterator["FullDisk"]:
        """Let everything that Python code writes below the folder go to this disk."""
        honest = io.open

        def opened(file: Any, mode: str = "r", *given: Any, **named: Any) -> Any:
            handle = honest(file, mode, *given, **named)
            is_ours = not isinstance(file, int) and self.folder in Path(file).resolve().parents
            return _Handle(handle, self) if is_ours and set(mode) & set("wax+") else handle

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(io, "open", opened)
            patch.setattr(builtins, "open", opened)
            yield self


class _Handle:
    """An open file whose writes need room."""

    def __init__(self, inner: Any, disk: FullDisk) -> None:
        self._inner, self._disk = inner, disk

    def write(self, content: Any) -> int:
        self._disk.take()
        return int(self._inner.write(content))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)

    def __enter__(self) -> "_Handle":
        return self

    def __exit__(self, *ended: object) -> None:
        self._inner.close()
