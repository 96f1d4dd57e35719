"""Opening a map file, with errors in one line; a file that is refused is not modified."""

import os
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from stillroom.data.replacing import cannot_be_written
from stillroom.data.sensor import Sensor
from stillroom.errors import MapError
from stillroom.storage.schema import APPLICATION_ID, RGBD_VERSION, SENSOR_TABLE, TABLES, VERSION

SUFFIX = ".stillmap"
PAGE_BYTES = 8192
LOG_BYTES = 32 << 20
"""The write-ahead log is folded into the file when it has grown to this: each time waits for the disk."""

_HEADER_BYTES = 100
_MAGIC = b"SQLite format 3\x00"
_NO_ROOM = {sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR, sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_READONLY}


@dataclass(frozen=True)
class Header:
    """The header of a SQLite file (sqlite.org/fileformat2.html, section 1.3).

    Attributes:
        n_bytes: How large the file should be.
        version: The format's version.
        application_id: The application of the format.
    """

    n_bytes: int
    version: int
    application_id: int


def log_of(path: Path) -> Path:
    """Return where the write-ahead log of a map lies while it is written, and after a crash."""
    return path.with_name(path.name + "-wal")


def journal_of(path: Path) -> Path:
    """Return where SQLite keeps what it would put back, should it be cut off while it turns the log into the file."""
    return path.with_name(path.name + "-journal")


def inspect(path: Path) -> Header:
    """Return the header of a map file, read without SQLite.

    Raises:
        MapError: There is no such file; it is no map, of a newer version, or cut short.
    """
    if path.is_dir():
        raise MapError(f"{path}: is a folder; a map is a file, such as room{SUFFIX}")
    try:
        with path.open("rb") as file:
            head = file.read(_HEADER_BYTES)
            n_bytes = os.fstat(file.fileno()).st_size
    except FileNotFoundError:
        raise MapError(f"{path}: no such map; 'stillroom run SEQUENCE --map {path}' makes one") from None
    except OSError as error:
        raise MapError(f"{path}: cannot be read ({error.strerror})") from error
    if head[: len(_MAGIC)] != _MAGIC:
        raise MapError(f"{path}: {'is empty' if n_bytes == 0 else 'is no map of Stillroom'}; the file was not touched")
    if n_bytes < _HEADER_BYTES:
        raise MapError(f"{path}: is cut short after {n_bytes} bytes; copy it again from where it is whole")
    page = int.from_bytes(head[16:18], "big")
    header = Header(
        n_bytes=(65536 if page == 1 else page) * int.from_bytes(head[28:32], "big"),
        version=int.from_bytes(head[60:64], "big"),
        application_id=int.from_bytes(head[68:72], "big"),
    )
    if header.application_id != APPLICATION_ID:
        raise MapError(f"{path}: is an SQLite database, but no map of Stillroom; the file was not touched")
    if not 1 <= header.version <= VERSION:
        raise MapError(
            f"{path}: is of map format {header.version}, and this Stillroom knows formats up to {VERSION}; "
            "update Stillroom; the file was not touched"
        )
    # With a log beside it the file may rightly be shorter than it will be.
    if n_bytes < header.n_bytes and not _has_content(log_of(path)):
        raise MapError(
            f"{path}: is cut short: {n_bytes} of {header.n_bytes} bytes; copy it again from where it is whole"
        )
    return header


@contextmanager
def reading(path: Path) -> Iterator[sqlite3.Connection]:
    """Open a map to read; the file stays as it is, byte for byte.

    Raises:
        MapError: It cannot be opened or read; see `inspect`.
    """
    inspect(path)
    if _has_content(journal_of(path)):
        _put_back(path)
    # Without a log nobody is writing: SQLite then needs neither locks nor files beside it.
    how = "mode=ro" if _has_content(log_of(path)) else "mode=ro&immutable=1"
    with naming(path):
        connection = sqlite3.connect(f"{path.resolve().as_uri()}?{how}", uri=True, timeout=0.2)
        connection.text_factory = _text
        try:
            with _needing_room_beside(path):
                connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
            yield connection
        finally:
            connection.close()


def _put_back(path: Path) -> None:
    """Undo what was cut off in the middle, as SQLite does when a file is opened to write."""
    with naming(path), _needing_room_beside(path):
        connection = sqlite3.connect(f"{path.resolve().as_uri()}?mode=rw", uri=True, timeout=0.2)
        try:
            connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
        finally:
            connection.close()


@contextmanager
def _needing_room_beside(path: Path) -> Iterator[None]:
    """Say what to copy where SQLite finds no room for its files beside a map that was not closed.

    Raises:
        MapError: In the place of SQLite's error.
    """
    try:
        yield
    except sqlite3.OperationalError as error:
        beside = [file.name for file in (log_of(path), journal_of(path)) if _has_content(file)]
        if _kind(error) not in _NO_ROOM or not beside:
            raise
        raise MapError(
            f"{path}: was not closed by the run that wrote it, and its folder is full or cannot be written ({error}), "
            f"which reading {beside[0]} needs; copy {path.name} and {' and '.join(beside)} together into a folder with "
            "room, and name the copy [see troubleshooting: map-read-only]"
        ) from error


def require_unused(path: Path) -> None:
    """Check that a new map can have this name.

    Raises:
        MapError: There is a file of this name, or the log of a map that had it.
    """
    if path.is_dir():
        raise MapError(f"{path}: is a folder; a map is a file, such as {path / f'room{SUFFIX}'}")
    if path.exists():
        raise MapError(
            f"{path}: exists already; extend it with --continue, localize in it with --localize, or choose another name"
        )
    for beside in (log_of(path), journal_of(path)):
        if beside.exists():
            raise MapError(f"{beside}: belongs to a map that is gone; remove it, or choose another name")


def create(path: Path, sensor: Sensor = Sensor.RGBD) -> sqlite3.Connection:
    """Make a new, empty map of a sensor and open it to write. It is created atomically.

    Raises:
        MapError: There is a file of this name already, or it cannot be made.
    """
    require_unused(path)
    is_rgbd = sensor is Sensor.RGBD
    version = RGBD_VERSION if is_rgbd else VERSION
    told = "" if is_rgbd else f"{SENSOR_TABLE} INSERT INTO sensor VALUES (1, '{sensor.value}');"
    unfinished = path.with_name(f"{path.name}.{os.getpid()}.new")
    with naming(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            connection = sqlite3.connect(unfinished, isolation_level=None)
            connection.executescript(
                f"PRAGMA page_size = {PAGE_BYTES}; PRAGMA application_id = {APPLICATION_ID};"
                f"PRAGMA user_version = {version}; BEGIN; {TABLES} {told} COMMIT;"
            )
            connection.close()
            unfinished.replace(path)
        finally:
            unfinished.unlink(missing_ok=True)
    return open_to_write(path)


def open_to_write(path: Path) -> sqlite3.Connection:
    """Open a map that is there to write; no other process can open it meanwhile.

    Raises:
        MapError: It cannot be opened, or another process is writing it; see `inspect`.
    """
    inspect(path)
    with naming(path):
        connection = sqlite3.connect(
            f"{path.resolve().as_uri()}?mode=rw", uri=True, isolation_level=None, check_same_thread=False, timeout=0.0
        )
        try:
            # synchronous = NORMAL: what was committed survives the end of the process, and a power cut leaves the
            # map whole, if perhaps without the last few commits.
            connection.executescript(
                "PRAGMA locking_mode = EXCLUSIVE; PRAGMA journal_mode = WAL; PRAGMA synchronous = NORMAL;"
                f"PRAGMA wal_autocheckpoint = {LOG_BYTES // PAGE_BYTES}; BEGIN IMMEDIATE; COMMIT;"
            )
        except sqlite3.Error:
            connection.close()
            raise
    return connection


def close_written(connection: sqlite3.Connection, path: Path) -> None:
    """Close a map that was written: one file is left, without a log.

    Raises:
        MapError: The disk is full, or the like; the log, which then stays, holds what was committed.
    """
    with naming(path):
        try:
            connection.executescript("PRAGMA wal_checkpoint(TRUNCATE); PRAGMA journal_mode = DELETE;")
            # Left by a reader of the map and its log after a crash; unused while this is open.
            path.with_name(path.name + "-shm").unlink(missing_ok=True)
        finally:
            connection.close()


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Turn errors of SQLite and the system into one line.

    Raises:
        MapError: Instead of them.
    """
    try:
        yield
    except sqlite3.OperationalError as error:
        if "locked" in str(error):
            raise MapError(f"{path}: is in use by another run; wait for its end, or choose another map") from error
        row = " [see troubleshooting: disk-full]" if _kind(error) == sqlite3.SQLITE_FULL else ""
        raise MapError(f"{path}: {_in_one_line(error)}{row}") from error
    except (sqlite3.DatabaseError, UnicodeDecodeError) as error:  # what SQLite quotes of a damaged file may be no text
        raise MapError(f"{path}: is damaged ({_in_one_line(error)}); 'stillroom map check {path}' says more") from error
    except OSError as error:
        raise MapError(str(cannot_be_written(path, error))) from error


def _in_one_line(error: Exception) -> str:
    """Return a message without the line breaks of what it quotes of a damaged file."""
    return " ".join(str(error).split())


def _kind(error: sqlite3.Error) -> int | None:
    """Return what SQLite calls the primary code of an error (sqlite.org/rescode.html); None where it gave none."""
    code = getattr(error, "sqlite_errorcode", None)
    return None if code is None else code & 0xFF


def _has_content(path: Path) -> bool:
    try:
        return path.stat().st_size > 0
    except OSError:
        return False


def _text(content: bytes) -> str:
    return content.decode("utf-8", errors="replace")
