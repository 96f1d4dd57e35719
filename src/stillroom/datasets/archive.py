"""Archives of sequences, read as they are: unpacked once into the user's cache.

A compressed tar can only be read from its start, so frames in any order need the files on disk.
"""

import gzip
import hashlib
import logging
import lzma
import os
import shutil
import struct
import tarfile
import tempfile
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import IO

from stillroom.data.locations import cache_folder
from stillroom.errors import DatasetError


class BrokenArchiveError(DatasetError):
    """The archive itself is damaged: reading it again will not help."""


log = logging.getLogger(__name__)

SUFFIXES = (".tgz", ".tar.gz", ".tar", ".tar.bz2", ".tar.xz", ".zip")
MACOS_FOLDER, MACOS_PREFIX = "__MACOSX", "._"
UNREADABLE = (
    tarfile.TarError,
    zipfile.BadZipFile,
    gzip.BadGzipFile,
    zlib.error,
    lzma.LZMAError,
    EOFError,
    RuntimeError,  # zipfile's word for an encrypted member, and for a compression that it does not know
    ValueError,  # a member's name that is no text or holds a zero byte; a number that is none
    OverflowError,
    struct.error,
)
ON_WINDOWS = os.name == "nt"
DEVICES = frozenset(
    (
        "con",
        "prn",
        "aux",
        "nul",
        "conin$",
        "conout$",
        *(f"{port}{n}" for port in ("com", "lpt") for n in "123456789¹²³"),
    )
)
"""What Windows takes for a device in any folder, whatever the suffix."""


def is_archive(path: Path) -> bool:
    """Return whether a path names an archive."""
    return path.name.lower().endswith(SUFFIXES)


def stem(archive: Path) -> str:
    """Return an archive's name without its suffix."""
    suffix = next((s for s in sorted(SUFFIXES, key=len, reverse=True) if archive.name.lower().endswith(s)), "")
    return archive.name[: len(archive.name) - len(suffix)]


def unpacked(archive: Path) -> Path:
    """Return the folder with an archive's content, unpacking it into the cache the first time.

    Raises:
        BrokenArchiveError: The archive is no archive, is cut off, or holds a path that leads out of it.
        DatasetError: It cannot be opened, or there is no room for its content.
    """
    try:
        found = archive.stat()
    except OSError as error:
        raise DatasetError(f"{archive}: cannot be read ({error.strerror})") from error
    # Another archive under the same path, say the same sequence fetched again, gets a folder of its own.
    identity = f"{archive.resolve()}|{found.st_size}|{found.st_mtime_ns}"
    key = hashlib.sha256(identity.encode()).hexdigest()[:12]
    folder = cache_folder() / "unpacked" / f"{stem(archive)}-{key}"
    if not folder.is_dir():
        log.info("unpacking %s into %s, once", archive, folder)
        unpack(archive, folder)
    return folder


def unpack(archive: Path, folder: Path) -> None:
    """Unpack an archive into a new folder, which appears only when it is complete.

    Only folders and plain files are made: an archive of images needs no links or devices.

    Raises:
        BrokenArchiveError: The archive is no archive, is cut off, or holds a path that leads out of it.
        DatasetError: It cannot be opened, or there is no room for its content.
    """
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        half_done = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    except OSError as error:
        raise DatasetError(f"{folder.parent}: cannot unpack into it ({error.strerror})") from error
    try:
        for name, content in _members(archive):
            if _is_of_macos(name):
                continue
            target = _inside(archive, half_done, name)
            target.parent.mkdir(parents=True, exist_ok=True)
            with target.open("wb") as file:
                shutil.copyfileobj(content, file, 1 << 20)
        half_done.chmod(0o755)
        if not folder.exists():  # another run may have been faster
            half_done.rename(folder)
    except UNREADABLE as error:
        reason = str(error).partition(":")[0]  # tarfile appends one message for each kind of compression
        raise BrokenArchiveError(f"{archive}: not a whole archive ({reason}); delete it and fetch it again") from error
    except OSError as error:
        raise DatasetError(f"{archive}: cannot be unpacked into {folder.parent} ({error.strerror or error})") from error
    finally:
        shutil.rmtree(half_done, ignore_errors=True)


def _members(archive: Path) -> Iterator[tuple[str, IO[bytes]]]:
    """Yield name and content of each plain file, in the archive's order, which is the fastest to read."""
    if archive.name.lower().endswith(".zip"):
        with zipfile.ZipFile(archive) as zipped:
            for info in zipped.infolist():
                name = _with_slashes(info.filename)  # no other separator ends a folder's name
                if not name.endswith("/"):
                    with zipped.open(info) as content:
                        yield name, content
        return
    with tarfile.open(archive, mode="r:*") as tar:
        for member in tar:
            content_or_none = tar.extractfile(member) if member.isreg() else None
            if content_or_none is not None:
                with content_or_none as content:
                    yield _with_slashes(member.name), content
        # The tar ends before its compressed stream does, and the stream's checksum stands at its very end.
        while tar.fileobj is not None and tar.fileobj.read(1 << 20):
            pass


def _with_slashes(name: str) -> str:
    """Return a member's name as the formats want it: some Windows programs write backslashes."""
    return name.replace("\\", "/")


def _is_of_macos(name: str) -> bool:
    """Return whether a member is what macOS puts beside files into an archive, under names that look like theirs."""
    parts = PurePosixPath(name).parts
    return MACOS_FOLDER in parts or (bool(parts) and parts[-1].startswith(MACOS_PREFIX))


def _inside(archive: Path, folder: Path, name: str) -> Path:
    """Return where a member goes; a path that leads out on any system is refused on all.

    Raises:
        BrokenArchiveError: It leads out of the folder, or to a device.
    """
    target = (folder / name).resolve()
    if not target.is_relative_to(folder.resolve()) or PureWindowsPath(name).drive:
        raise BrokenArchiveError(f"{archive}: holds the path '{name}', which leads out of it; not unpacked")
    if ON_WINDOWS and any(":" in part or _is_device(part) for part in PurePosixPath(name).parts):
        raise BrokenArchiveError(f"{archive}: holds the path '{name}', which Windows takes for a device; not unpacked")
    return target


def _is_device(part: str) -> bool:
    return part.partition(".")[0].rstrip(" ").lower() in DEVICES
