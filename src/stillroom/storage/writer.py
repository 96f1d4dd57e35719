"""Writing a map as it grows: each commit writes what has changed since the last one, atomically."""

import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import astuple
from pathlib import Path
from types import TracebackType

from stillroom.data.map import Map
from stillroom.geometry.camera import Camera
from stillroom.storage import opening
from stillroom.storage.changes import Changes, Statements, insert
from stillroom.storage.pictures import Pictures
from stillroom.storage.schema import POSES, FrameNote, Session, StoredMap


def save_map(path: Path, stored: StoredMap) -> None:
    """Write a whole map into a new file.

    Raises:
        MapError: The file exists already or cannot be written.
    """
    with MapWriter.create(path, stored.world, stored.camera) as writer:
        for session in stored.sessions:
            writer.begin(session)
        writer.commit(stored.frames)


class MapWriter:
    """Keeps a file in sync with a map. As a context manager it leaves one file; after an error, the last commit.

    Calls may come from any thread, one at a time; they hold the map's lock while they read it, not while they write.
    """

    def __init__(self, connection: sqlite3.Connection, path: Path, world: Map, changes: Changes) -> None:
        """Write on an open connection; `create` and `go_on` make one."""
        self.path = path
        self._connection, self._world, self._changes = connection, world, changes
        self._is_open = True

    @classmethod
    def create(cls, path: Path, world: Map, camera: Camera) -> "MapWriter":
        """Start a new file.

        Raises:
            MapError: There is one already, or it cannot be made.
        """
        sizes = camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy
        depth = camera.depth_factor, camera.bf
        scales = world.scales.factor, world.scales.count
        head = (1, *sizes, *camera.distortion, *depth, *scales, 0)
        writer = cls(opening.create(path, world.sensor), path, world, Changes(world))
        with writer._transaction() as database:
            insert(database, "map", [head])
        return writer

    @classmethod
    def go_on(cls, path: Path, world: Map) -> "MapWriter":
        """Extend the file that a map was loaded from, before anything has changed in the map.

        Raises:
            MapError: Another process is writing it, or it cannot be written.
        """
        changes = Changes(world)
        changes.forget()
        return cls(opening.open_to_write(path), path, world, changes)

    def begin(self, session: Session) -> int:
        """Begin a session; return its number."""
        with self._transaction() as database:
            number = int(database.execute("SELECT count(*) FROM sessions").fetchone()[0])
            insert(database, "sessions", [(number, *astuple(session))])
        return number

    def commit(self, frames: Iterable[FrameNote] = (), pictures: Pictures | None = None) -> None:
        """Write what has changed since the last commit.

        Args:
            frames: Frames that were tracked since.
            pictures: Depth and colours of a keyframe.

        Raises:
            MapError: The disk is full, or the like. The file then holds the last commit, and the next one writes
                what this one should have.
        """
        statements = Statements()
        with self._world.lock:
            self._changes.write(statements)
        try:
            with self._transaction() as database:
                statements.execute_on(database)
                self._changes.rescale_frames(database)
                insert(database, "frames", map(_row, self._changes.as_stored(frames)))
                if pictures is not None:
                    insert(database, "images", [astuple(pictures)])
        except BaseException:
            with self._world.lock:
                self._changes.write_again()
            raise
        self._changes.committed()

    def close(self, frames: Iterable[FrameNote] = ()) -> None:
        """Write what has changed, the counts of all points too, and leave one file.

        Raises:
            MapError: The disk is full, or the like; what was committed is safe.
        """
        self._changes.expect_all()
        self.commit(frames)
        self.abandon()

    def abandon(self) -> None:
        """Leave one file at the last commit; do nothing if already closed.

        Raises:
            MapError: The disk is full, or the like; what was committed is safe.
        """
        if self._is_open:
            self._is_open = False
            opening.close_written(self._connection, self.path)

    def __enter__(self) -> "MapWriter":
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Close it; after an error without writing, for the map may be half changed."""
        if kind is None:
            self.close()
        else:
            self.abandon()

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        with opening.naming(self.path):
            self._connection.execute("BEGIN IMMEDIATE")
            try:
                yield self._connection
                self._connection.execute("COMMIT")
            except BaseException:
                if self._connection.in_transaction:
                    self._connection.execute("ROLLBACK")
                raise


def _row(frame: FrameNote) -> tuple[int, int, float, int, bytes]:
    pose = POSES.pack(frame.T_reference_cam)
    return frame.session, frame.image_index, frame.timestamp_s, frame.reference_keyframe, pose
