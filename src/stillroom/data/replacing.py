"""Atomic writing of a file."""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from stillroom.errors import StillroomError

NO_ROOM = frozenset(getattr(errno, name) for name in ("ENOSPC", "EDQUOT", "EFBIG") if hasattr(errno, name))
"""What a system says where a disk, a share of it, or a file may not grow any more."""


@contextmanager
def replacing(path: Path, durable: bool = True) -> Iterator[BinaryIO]:
    """Open a file beside `path` that takes its place when all is written; what was there stays until then.

    Args:
        path: The file.
        durable: Whether it must be on the disk before it takes the place, so that a power cut leaves the old file or
            the new one; not worth the wait for what is only looked at.

    Raises:
        StillroomError: It cannot be written.
    """
    unfinished = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with unfinished.open("wb") as file:
            yield file
            if durable:
                file.flush()
                os.fsync(file.fileno())
        unfinished.replace(path)
    except OSError as error:
        raise cannot_be_written(path, error) from error
    finally:
        with suppress(OSError):  # The error that matters is already on its way.
            unfinished.unlink(missing_ok=True)


def replace_text(path: Path, text: str) -> None:
    """Write a whole text file in UTF-8, line ends as they are in the text.

    Raises:
        StillroomError: It cannot be written; what was there is there still.
    """
    with replacing(path) as file:
        file.write(text.encode("utf-8"))


def cannot_be_written(path: Path | str, error: OSError) -> StillroomError:
    """Return what the system says of a file that cannot be written, as one line."""
    row = " [see troubleshooting: disk-full]" if error.errno in NO_ROOM else ""
    return StillroomError(f"{path}: cannot be written ({error.strerror or error}){row}")
