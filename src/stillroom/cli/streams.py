"""Output that nobody reads any more, or that has no room, must not end the work."""

import os
import sys
from contextlib import suppress
from typing import Any


class Unbreakable:
    """Stands for stdout or stderr; once it cannot be written, it is written nowhere.

    The reader of a pipe may have left, the terminal may be closed, the disk that a log goes to may be full. Python
    would try again to write what is left in its buffers when it exits, and change the exit code.
    """

    def __init__(self, name: str) -> None:
        """Stand for `sys.<name>`, whatever that is when something is written."""
        self._name = name

    @property
    def _stream(self) -> Any:
        stream = getattr(sys, self._name)
        # While rich draws a bar it stands in for the stream itself and would call back here.
        return getattr(stream, "rich_proxied_file", stream)

    def write(self, text: str) -> int:
        """Write what can be written."""
        try:
            if self._stream is not None:  # a program without a console has none
                self._stream.write(text)
        except OSError:
            _lead_nowhere(self._stream)
        return len(text)

    def flush(self) -> None:
        """Flush what can be flushed."""
        try:
            if self._stream is not None:
                self._stream.flush()
        except OSError:
            _lead_nowhere(self._stream)

    def __getattr__(self, name: str) -> Any:
        """Answer everything else as the stream does."""
        return getattr(self._stream, name)


def flush_all() -> None:
    """Flush both streams now, while a failure can still be borne."""
    for name in ("stdout", "stderr"):
        Unbreakable(name).flush()


def _lead_nowhere(stream: Any) -> None:
    with suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)
