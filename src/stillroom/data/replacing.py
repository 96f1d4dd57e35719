"""Atomic writing of a file."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from stillroom.errors import StillroomError


@contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """Open a temporary file that replaces `path` when all is written; an older file stays until then.

    Raises:
        StillroomError: It cannot be written.
    """
    unfinished = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with unfinished.open("wb") as file:
            yield file
        unfinished.replace(path)
    except OSError as error:
        raise StillroomError(f"{path}: cannot be written ({error.strerror or error})") from error
    finally:
        with suppress(OSError):  # The error that matters is already on its way.
            unfinished.unlink(missing_ok=True)
