"""Out of space at every write of a map, and power cuts at any byte: it opens, and holds all that was committed."""

import shutil
import sqlite3
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from random_map import EventfulLife, assert_same_map, notes, session
from small_world import CAMERA

from stillroom.data.map import Map
from stillroom.errors import MapError
from stillroom.storage import load_map
from stillroom.storage.check import check_map
from stillroom.storage.opening import log_of
from stillroom.storage.writer import MapWriter

SEED, N_COMMITS, EVENTS = 3, 6, 6


def lives_of(n_commits: int) -> Map:
    """The map as it is at a commit."""
    life = EventfulLife(SEED)
    for _ in range(n_commits):
        life.happen(EVENTS)
    return life.world


def assert_holds(path: Path, n_commits: int) -> None:
    assert check_map(path) == []
    assert_same_map(load_map(path).world, lives_of(n_commits), with_counts=False)


def started(path: Path) -> tuple[EventfulLife, MapWriter]:
    life = EventfulLife(SEED)
    writer = MapWriter.create(path, life.world, CAMERA)
    writer.begin(session())
    writer.commit()
    return life, writer


def commit_while_there_is_room(life: EventfulLife, writer: MapWriter) -> int:
    """Return how many commits found room; the next one is not finished."""
    for n in range(N_COMMITS):
        life.happen(EVENTS)
        try:
            writer.commit(notes(2, first=2 * n))
        except MapError as error:
            refused = str(error)
        else:
            continue
        assert refused.endswith("[see troubleshooting: disk-full]") or "disk I/O error" in refused
        return n
    return N_COMMITS


class Breaking:
    """A connection that finds no room at the n-th statement."""

    def __init__(self, inner: sqlite3.Connection, n: int) -> None:
        self.inner, self.n = inner, n

    def _count(self) -> None:
        self.n -= 1
        if self.n == 0:
            raise sqlite3.OperationalError("database or disk is full")

    def execute(self, *given: object) -> sqlite3.Cursor:
        if given[0] != "ROLLBACK":
            self._count()
        return self.inner.execute(*given)  # type: ignore[arg-type]

    def executemany(self, *given: object) -> sqlite3.Cursor:
        self._count()
        return self.inner.executemany(*given)  # type: ignore[arg-type]

    @property
    def in_transaction(self) -> bool:
        return self.inner.in_transaction


def test_no_room_at_any_page(tmp_path: Path) -> None:
    """SQLite itself refuses to take another page, whichever it is."""
    found = set()
    for extra in range(60):
        path = tmp_path / f"{extra}.stillmap"
        life, writer = started(path)
        n_pages = writer._connection.execute("PRAGMA page_count").fetchone()[0]
        writer._connection.execute(f"PRAGMA max_page_count = {n_pages + extra}")
        n = commit_while_there_is_room(life, writer)
        writer.abandon()
        assert not log_of(path).exists()
        assert_holds(path, n)
        found.add(n)
        if n == N_COMMITS:
            break
    assert {0, N_COMMITS} < found


def test_no_room_at_any_statement_and_then_room_again(tmp_path: Path) -> None:
    """What a commit could not write, the next one writes."""
    n_failed = 0
    for n in range(1, 400, 3):
        path = tmp_path / f"{n}.stillmap"
        life, writer = started(path)
        honest = writer._connection
        writer._connection = Breaking(honest, n)  # type: ignore[assignment]
        for done in range(N_COMMITS):
            life.happen(EVENTS)
            try:
                writer.commit()
            except MapError:
                n_failed += 1
                if n % 9 == 1 and done:
                    copy = tmp_path / "copy.stillmap"
                    for file, to in ((path, copy), (log_of(path), log_of(copy))):
                        shutil.copy(file, to)
                    assert_holds(copy, done)
        left = writer._connection.n  # type: ignore[attr-defined]
        writer._connection = honest
        writer.close()
        assert check_map(path) == []
        assert_same_map(load_map(path).world, life.world)
        path.unlink()
        if left > 0:
            break
    assert n_failed > 20
    assert left > 0, "there are statements that were not tried"


def test_no_room_for_any_byte(tmp_path: Path) -> None:
    """The system refuses to let a file grow, so that pages are written in part, and the log cannot be folded back."""
    resource = pytest.importorskip("resource", reason="this system cannot limit how far a file may grow")
    before, found = resource.getrlimit(resource.RLIMIT_FSIZE), set()
    for place, limit in enumerate(np.geomspace(40_000, 4_000_000, 32).astype(int).tolist()):
        path = tmp_path / f"{place}.stillmap"
        life, writer = started(path)
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
        try:
            n = commit_while_there_is_room(life, writer)
            try:
                writer.abandon()
            except MapError:
                assert log_of(path).exists()
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
        assert_holds(path, n)
        found.add(n)
    assert {0, N_COMMITS} <= found
    assert len(found) >= 4


def test_a_power_cut_at_any_byte_of_the_log(tmp_path: Path) -> None:
    """What was written last may be there in part: what was committed before it is whole."""
    path, copy = tmp_path / "room.stillmap", tmp_path / "cut.stillmap"
    life, writer = started(path)
    ends = [log_of(path).stat().st_size]
    for _ in range(N_COMMITS):
        life.happen(EVENTS)
        writer.commit()
        ends.append(log_of(path).stat().st_size)
    whole, base = log_of(path).read_bytes(), path.read_bytes()
    writer.abandon()
    assert sorted(set(ends)) == ends, "every commit writes to the log, and nothing is folded back yet"
    rng = np.random.default_rng(0)
    cuts = sorted({*ends, *(end - 1 for end in ends[1:]), *rng.integers(ends[0], ends[-1], 20).tolist()})
    for cut in cuts:
        copy.write_bytes(base)
        log_of(copy).write_bytes(whole[:cut])
        n = int(np.searchsorted(ends, cut, side="right")) - 1
        assert_holds(copy, n)


CHILD = f"""
import os, signal, sys
from pathlib import Path
from random_map import EventfulLife, session
from small_world import CAMERA
from stillroom.storage.writer import MapWriter

path, moment = Path(sys.argv[1]), int(sys.argv[2])
life = EventfulLife({SEED})
writer = MapWriter.create(path, life.world, CAMERA)
writer.begin(session())
writer.commit()
os.write(1, b"0")
left = [moment]

def count():
    left[0] -= 1
    if left[0] == 0:
        os.kill(os.getpid(), signal.SIGKILL)
    return 0

writer._connection.set_progress_handler(count, 25)
for n in range({N_COMMITS}):
    life.happen({EVENTS})
    writer.commit()
    os.write(1, str(n + 1).encode())
writer.close()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows sends no SIGKILL")
@pytest.mark.parametrize("moment", np.random.default_rng(1).integers(1, 120, 5).tolist())
def test_kill_9_between_writes(moment: int, tmp_path: Path) -> None:
    """In the middle of a statement, every so many instructions of SQLite's machine."""
    path = tmp_path / "room.stillmap"
    fabricated = str(Path(__file__).parents[1] / "fabricated")
    code = f"import sys; sys.path.insert(0, {fabricated!r})\n{CHILD}"
    done = subprocess.run([sys.executable, "-c", code, str(path), str(moment)], capture_output=True, check=False)
    assert done.returncode == -9, done.stderr.decode()
    n = int(done.stdout.decode()[-1])
    assert log_of(path).exists()
    assert_holds(path, n)
