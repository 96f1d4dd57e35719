"""What is no map, or no longer one, is said in one line and left as it is."""

import hashlib
import os
import sqlite3
import stat
import sys
from collections.abc import Callable
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from random_map import EventfulLife, notes, session
from small_world import CAMERA

from stillroom.errors import MapError
from stillroom.storage import StoredMap, load_map, opening, save_map
from stillroom.storage.check import check_map
from stillroom.storage.map_export import keyframe_trajectories, trajectories
from stillroom.storage.reader import keyframe_images
from stillroom.storage.schema import VERSION, column_types
from stillroom.storage.writer import MapWriter


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The bytes of a sound map."""
    life, path = EventfulLife(1), tmp_path_factory.mktemp("maps") / "room.stillmap"
    life.happen(30)
    save_map(path, StoredMap(life.world, CAMERA, (session(),), tuple(notes(5))))
    return path.read_bytes()


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "a room é %20?#.stillmap"


def refusals(path: Path) -> list[str]:
    """What each way of opening a file says; none of them may do anything to it."""
    said = []
    ways: list[Callable[[Path], object]] = [load_map, check_map, opening.open_to_write]
    for way in ways:
        with pytest.raises(MapError) as caught:
            way(path)
        said.append(str(caught.value))
        assert "\n" not in said[-1]
        assert str(path) in said[-1]
    return said


def assert_refused_untouched(path: Path, *words: str) -> None:
    before, listed = path.read_bytes(), sorted(path.parent.iterdir())
    for said in refusals(path):
        assert all(word in said for word in words), said
    with pytest.raises(MapError, match="exists already"):
        opening.create(path)
    assert path.read_bytes() == before
    assert sorted(path.parent.iterdir()) == listed


def header_with(whole: bytes, offset: int, value: int) -> bytes:
    return whole[:offset] + value.to_bytes(4, "big") + whole[offset + 4 :]


def test_a_sound_map_is_none_of_this(whole: bytes, path: Path) -> None:
    path.write_bytes(whole)
    assert len(load_map(path).world.keyframes) > 3
    assert check_map(path) == []
    assert path.read_bytes() == whole


def test_a_map_of_a_newer_version(whole: bytes, path: Path) -> None:
    path.write_bytes(header_with(whole, 60, VERSION + 2))
    assert_refused_untouched(path, f"map format {VERSION + 2}", f"up to {VERSION}", "update Stillroom", "not touched")


def test_a_map_of_no_version(whole: bytes, path: Path) -> None:
    path.write_bytes(header_with(whole, 60, 0))
    assert_refused_untouched(path, "map format 0")


@pytest.mark.parametrize("share", [0.02, 0.3, 0.7, 0.999])
def test_a_map_that_is_cut_short(share: float, whole: bytes, path: Path) -> None:
    path.write_bytes(whole[: int(share * len(whole))])
    assert_refused_untouched(path, "cut short", f"of {len(whole)} bytes")


@pytest.mark.parametrize("n_bytes", [16, 40, 99])
def test_a_map_that_is_cut_within_its_header(n_bytes: int, whole: bytes, path: Path) -> None:
    path.write_bytes(whole[:n_bytes])
    assert_refused_untouched(path, f"cut short after {n_bytes} bytes")


@pytest.mark.parametrize(
    "content",
    [b"this is a shopping list\n" * 50, np.random.default_rng(0).bytes(5000), b"SQLite", b"\x00" * 4096],
    ids=["text", "noise", "a few letters", "zeros"],
)
def test_a_file_that_is_no_map(content: bytes, path: Path) -> None:
    path.write_bytes(content)
    assert_refused_untouched(path, "is no map of Stillroom", "not touched")


def test_an_empty_file(path: Path) -> None:
    path.touch()
    assert_refused_untouched(path, "is empty")


def test_another_database(path: Path) -> None:
    database = sqlite3.connect(path)
    database.executescript("CREATE TABLE friends (name TEXT); INSERT INTO friends VALUES ('Ada');")
    database.close()
    assert_refused_untouched(path, "an SQLite database, but no map of Stillroom")


def test_no_file(path: Path) -> None:
    for said in refusals(path):
        assert "no such map" in said
    assert not path.exists()


def test_a_folder(path: Path) -> None:
    path.mkdir()
    for said in refusals(path):
        assert "is a folder" in said
    with pytest.raises(MapError, match="is a folder"):
        opening.create(path)
    assert list(path.iterdir()) == []


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has other permissions")
@pytest.mark.skipif(getattr(os, "geteuid", lambda: 0)() == 0, reason="root may read everything")
def test_a_file_that_may_not_be_read(whole: bytes, path: Path) -> None:
    path.write_bytes(whole)
    path.chmod(0)
    for said in refusals(path):
        assert "cannot be read" in said


def test_a_file_that_may_not_be_written_is_read_all_the_same(whole: bytes, path: Path) -> None:
    path.write_bytes(whole)
    path.chmod(stat.S_IRUSR)
    path.parent.chmod(stat.S_IRUSR | stat.S_IXUSR)
    try:
        assert len(load_map(path).world.keyframes) > 3
        assert check_map(path) == []
    finally:
        path.parent.chmod(stat.S_IRWXU)
    assert list(path.parent.iterdir()) == [path]


def test_a_name_that_is_taken_by_the_log_of_another_map(path: Path) -> None:
    opening.log_of(path).write_bytes(b"left over")
    with pytest.raises(MapError, match="belongs to a map that is gone"):
        opening.create(path)
    assert not path.exists()


def test_a_map_that_is_being_written_is_left_alone(whole: bytes, path: Path) -> None:
    path.write_bytes(whole)
    world = load_map(path).world
    with MapWriter.go_on(path, world) as writer:
        writer.begin(session())
        for said in refusals(path):
            assert "in use by another run" in said
        writer.commit(notes(1, number=1))
    assert len(load_map(path).frames) == 6


def outcome(way: Callable[[Path], object], path: Path) -> Any:
    """What a way of opening a file returns, or the error that it raises."""
    try:
        return way(path)
    except MapError as error:
        return error


@pytest.mark.parametrize("seed", range(30))
def test_a_map_with_wrong_bytes_never_does_worse_than_an_error(seed: int, whole: bytes, path: Path) -> None:
    """Most damage lies in descriptors and the like, where any byte is a fine byte: then it is read."""
    rng = np.random.default_rng(seed)
    damaged = np.frombuffer(whole, dtype=np.uint8).copy()
    if seed % 2:
        damaged[rng.integers(100, len(damaged), 30)] = rng.integers(0, 256, 30)
    else:
        start = int(rng.integers(100, len(damaged) - 8192))
        damaged[start : start + 8192] = 0
    path.write_bytes(damaged.tobytes())
    digest = hashlib.sha256(path.read_bytes()).digest()
    checked, loaded = outcome(check_map, path), outcome(load_map, path)
    said = checked if isinstance(checked, list) else [str(checked)]
    assert all("\n" not in line for line in said)
    if isinstance(loaded, MapError):
        assert str(path) in str(loaded)
        assert said
    else:
        world = loaded.world
        # What is loaded can be worked with: nothing hangs, nothing reaches beyond an array.
        for keyframe in range(len(world.keyframes)):
            world.keyframe_pose(keyframe)
        alive = np.flatnonzero(world.points.is_alive)
        world.refresh(alive.astype(np.int32))
        world.observations(alive)
    assert hashlib.sha256(path.read_bytes()).digest() == digest


def used(path: Path) -> None:
    """Do with a map what `stillroom map export` does."""
    stored = load_map(path)
    trajectories(stored)
    keyframe_trajectories(stored)
    list(keyframe_images(path))


ODD = ("../../outside", b"", None, -1, 2**31, 2**62, np.inf)


KEYS = ("id", "session", "image_index", "keyframe", "block", "older", "newer", "place")


@pytest.mark.parametrize(("table", "column"), [(t, c) for t, columns in column_types().items() for c in columns])
def test_a_value_that_no_run_writes_never_does_worse_than_an_error(
    table: str, column: str, whole: bytes, path: Path
) -> None:
    """SQLite keeps any value in any column, and the file's bytes may be fine all the same."""
    n_refused = 0
    for value in ODD:
        path.write_bytes(whole)
        with closing(sqlite3.connect(path, isolation_level=None)) as database:
            if database.execute(f"SELECT count(*) FROM {table}").fetchone() == (0,):
                zeros = ", ".join("0" for _ in column_types()[table])
                database.execute(f"INSERT INTO {table} VALUES ({zeros})")
            database.execute("PRAGMA ignore_check_constraints = 1")
            with suppress(sqlite3.IntegrityError):  # what SQLite itself does not take
                last = f"{column} = (SELECT max({column}) FROM {table})" if column in KEYS else "true"
                database.execute(f"UPDATE {table} SET {column} = ? WHERE {last}", (value,))
        checked, done = outcome(check_map, path), outcome(used, path)
        said = checked if isinstance(checked, list) else [str(checked)]
        said = said if done is None else [*said, str(done)]
        assert all("\n" not in line for line in said)
        n_refused += len(said) > 0
    assert n_refused > 0 or column in KEYS  # of which SQLite takes whole numbers only, and some stand for nothing


def test_a_full_disk_is_said_and_loses_nothing(path: Path) -> None:
    life = EventfulLife(2)
    writer = MapWriter.create(path, life.world, CAMERA)
    writer.begin(session())
    writer.commit()
    n_pages = writer._connection.execute("PRAGMA page_count").fetchone()[0]
    writer._connection.execute(f"PRAGMA max_page_count = {n_pages + 1}")
    committed = len(life.world.keyframes)
    for _ in range(4):
        life.add_keyframe()
    with pytest.raises(MapError, match="full") as caught:
        writer.commit()
    assert str(path) in str(caught.value)
    writer.abandon()
    assert len(load_map(path).world.keyframes) == committed
    assert check_map(path) == []


def test_a_folder_that_cannot_be_made_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(MapError, match="cannot be written"):
        opening.create(tmp_path / "file" / "room.stillmap")
    assert (tmp_path / "file").read_text() == "in the way"


def test_a_new_map_makes_its_folders_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "maps" / "of today" / "room.stillmap"
    life = EventfulLife(3)
    with MapWriter.create(path, life.world, CAMERA):
        pass
    assert [file for file in tmp_path.rglob("*") if file.is_file()] == [path]


def test_what_sqlite_quotes_of_a_damaged_file_stays_in_one_line(tmp_path: Path) -> None:
    with (
        pytest.raises(MapError, match=r"is damaged \(malformed schema \( 1\), w\)\)") as raised,
        opening.naming(tmp_path / "m"),
    ):
        raise sqlite3.DatabaseError("malformed schema ( 1),\n    w)")
    assert "\n" not in str(raised.value)
