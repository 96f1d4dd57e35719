"""A map on a full or read-only disk is read where that is safe; else one line says what to copy where."""

import shutil
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from random_map import EventfulLife, assert_same_map, notes, session
from small_world import CAMERA

from stillroom.errors import MapError
from stillroom.storage import StoredMap, load_map, save_map
from stillroom.storage.check import check_map
from stillroom.storage.opening import journal_of, log_of
from stillroom.storage.writer import MapWriter

resource = pytest.importorskip("resource", reason="this system cannot limit how far a file may grow")


@contextmanager
def no_room() -> Iterator[None]:
    """Let no file grow by a byte."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.fixture
def life() -> EventfulLife:
    life = EventfulLife(1)
    life.happen(10)
    return life


@pytest.fixture
def left_with_log(life: EventfulLife, tmp_path: Path) -> Path:
    """A map as a killed run leaves it."""
    path, left = tmp_path / "made" / "room.stillmap", tmp_path / "left" / "room.stillmap"
    left.parent.mkdir()
    with MapWriter.create(path, life.world, CAMERA) as writer:
        writer.begin(session())
        writer.commit(notes(3))
        for file in (path, log_of(path)):
            shutil.copy(file, left.with_name(file.name))
    assert log_of(left).stat().st_size > 0
    return left


def test_a_map_that_was_closed_needs_no_room(life: EventfulLife, tmp_path: Path) -> None:
    path = tmp_path / "room.stillmap"
    save_map(path, StoredMap(life.world, CAMERA, (session(),)))
    with no_room():
        stored = load_map(path)
    assert_same_map(stored.world, life.world)
    log_of(path).touch()  # an empty log holds nothing
    with no_room():
        assert check_map(path) == []


def test_with_a_log_a_line_says_what_to_copy_where(life: EventfulLife, left_with_log: Path, tmp_path: Path) -> None:
    with no_room(), pytest.raises(MapError) as caught:
        load_map(left_with_log)
    said = str(caught.value)
    assert "\n" not in said
    assert "copy room.stillmap and room.stillmap-wal together into a folder with room" in said
    assert said.endswith("[see troubleshooting: map-read-only]")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    for file in (left_with_log, log_of(left_with_log)):
        shutil.copy(file, elsewhere)
    assert_same_map(load_map(elsewhere / "room.stillmap").world, life.world)


def test_what_was_cut_off_while_a_map_was_closed_is_put_back(life: EventfulLife, tmp_path: Path) -> None:
    """Read without its journal, such a file would be a mixture of old and new pages."""
    path, left = tmp_path / "room.stillmap", tmp_path / "left" / "room.stillmap"
    save_map(path, StoredMap(life.world, CAMERA, (session(),)))
    left.parent.mkdir()
    database = sqlite3.connect(path, isolation_level=None)
    database.execute("PRAGMA cache_size = 2")
    database.execute("BEGIN")
    database.execute("UPDATE points SET block = block + 1000")
    for file in (path, journal_of(path)):
        shutil.copy(file, left.with_name(file.name))
    database.close()
    assert left.read_bytes() != path.read_bytes()
    with no_room(), pytest.raises(MapError, match=r"room\.stillmap-journal together into a folder with room"):
        load_map(left)
    assert_same_map(load_map(left).world, life.world)
    assert not journal_of(left).exists()
