"""What of a map has changed since it was last written."""

import sqlite3
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stillroom.data.map import Map
from stillroom.geometry.arrays import F64, I32, I64, Bool
from stillroom.storage.schema import KEYPOINTS, OBSERVATIONS, POINT_IDS, POINTS, POINTS_A_BLOCK, POSES, FrameNote


class Changes:
    """Finds and writes the changes of a map.

    The map marks points and keyframes whose links changed (`is_unsaved`); poses, which are few, are compared. Counts of
    how often a point was visible and found change with every frame and are not marked: they are written along with a
    point's other changes.

    In the file poses that are noted in keyframes are in lengths as they are now: `KeyframeTable.scale` is 1 there, and
    where a map up to scale was corrected the notes are written again.
    """

    def __init__(self, world: Map) -> None:
        """Start with nothing written."""
        self._world = world
        self._known, self._present = _Poses.of(world, 0), _Poses.of(world, 0)
        self._loops: list[tuple[int, int]] = []
        self._present_loops: list[tuple[int, int]] = []
        self.write_again()

    def forget(self) -> None:
        """Mark everything as written."""
        world = self._world
        self._known = _Poses.of(world, len(world.keyframes))
        self._loops = list(world.loop_edges)
        world.points.is_unsaved[:] = False
        world.keyframes.is_unsaved[:] = False
        world.covisibility.unsaved.clear()
        world.moved_keypoints.clear()

    def expect_all(self) -> None:
        """Mark all points as changed."""
        self._world.points.is_unsaved[:] = True

    def write_again(self) -> None:
        """Take all marks as set: what was written since the last `committed` is not in the file."""
        self.expect_all()
        self._world.keyframes.is_unsaved[:] = True
        self._world.covisibility.unsaved.update(range(len(self._world.keyframes)))
        self._world.moved_keypoints.update(range(len(self._world.keyframes)))

    def committed(self) -> None:
        """Take what `write` wrote last as written for good."""
        self._known = self._present
        self._loops = self._present_loops

    def as_stored(self, frames: Iterable[FrameNote]) -> list[FrameNote]:
        """Return notes of frames in lengths as `write` found them last."""
        scale = self._present.scale
        if (scale == 1.0).all():
            return list(frames)
        return [
            replace(note, T_reference_cam=_grown(note.T_reference_cam, scale[note.reference_keyframe]))
            for note in frames
        ]

    def rescale_frames(self, database: sqlite3.Connection) -> None:
        """Write the frames of earlier commits again whose keyframes have another scale than then."""
        n = len(self._known)
        growth = self._present.scale[:n] / self._known.scale
        if (growth == 1.0).all():
            return
        rows = database.execute("SELECT session, image_index, reference_keyframe, T_reference_cam FROM frames")
        grown = [
            (POSES.pack(_grown(POSES.unpack(pose, 1, "the pose of a frame")[0], growth[k])), session, index)
            for session, index, k, pose in rows
            if k < n and growth[k] != 1.0
        ]
        database.executemany("UPDATE frames SET T_reference_cam = ? WHERE session = ? AND image_index = ?", grown)

    def write(self, database: "Statements") -> None:
        """Write the changes, with the map's lock held; `committed` or `write_again` must follow."""
        present = self._present = _Poses.of(self._world, len(self._world.keyframes))
        self._write_keyframes(database, present)
        self._write_observations(database, present)
        self._write_points(database)
        self._write_edges(database)
        self._write_loops(database)

    def _write_keyframes(self, database: "Statements", present: "_Poses") -> None:
        table, keypoints, n_known = self._world.keyframes, self._world.keypoints, len(self._known)
        for k in range(n_known, len(present)):
            row = float(table.timestamp_s[k]), int(table.image_index[k]), int(table.n_rows[k])
            insert(database, "keyframes", [(k, *row, *present.row(k))])
        update = (
            "UPDATE keyframes SET submap = ?, is_alive = ?, parent = ?, T_world_cam = ?, T_parent_cam = ?"
            " WHERE keyframe = ?"
        )
        database.executemany(update, [(*present.row(k), k) for k in present.differing(self._known)])
        # Of a culled keyframe only its pose is kept; a loop that is undone may bring it back.
        was_alive = np.append(self._known.is_alive, np.zeros(len(present) - n_known, dtype=np.bool_))
        culled = np.flatnonzero(was_alive & ~present.is_alive)
        database.executemany("DELETE FROM keypoints WHERE keyframe = ?", [(int(k),) for k in culled])
        was_alive[list(self._world.moved_keypoints)] = False  # those are in the file where they are no more
        self._world.moved_keypoints.clear()
        for k in np.flatnonzero(present.is_alive & ~was_alive).tolist():
            rows = self._world.rows(k)
            blobs = [packed.pack(getattr(keypoints, name)[rows]) for name, packed in KEYPOINTS.items()]
            insert(database, "keypoints", [(k, *blobs)])

    def _write_observations(self, database: "Statements", present: "_Poses") -> None:
        table = self._world.keypoints
        for k in _taken(self._world.keyframes.is_unsaved).tolist():
            if not present.is_alive[k]:
                database.execute("DELETE FROM observations WHERE keyframe = ?", (k,))
                continue
            rows = self._world.rows(k)
            point = OBSERVATIONS["point"].pack(table.point[rows])
            older_row = OBSERVATIONS["older_row"].pack(table.next_row[rows])
            insert(database, "observations", [(k, point, older_row)])

    def _write_points(self, database: "Statements") -> None:
        points = self._world.points
        database.execute("UPDATE map SET n_points = ?", (len(points),))
        blocks = np.unique(_taken(points.is_unsaved) // POINTS_A_BLOCK)
        ids = (blocks[:, None] * POINTS_A_BLOCK + np.arange(POINTS_A_BLOCK)).ravel()
        ids = ids[ids < len(points)]
        ids = ids[points.is_alive[ids]]
        # Columns are gathered for all blocks at once and cut where a block ends, which is many times faster.
        ends = np.searchsorted(ids, (blocks + 1) * POINTS_A_BLOCK)
        columns = [_cut(POINT_IDS.pack(ids), ends, len(ids))]
        columns += [_cut(packed.pack(getattr(points, name)[ids]), ends, len(ids)) for name, packed in POINTS.items()]
        rows = list(zip(blocks.tolist(), *columns, strict=True))
        insert(database, "points", [row for row in rows if len(row[1]) > 0])
        database.executemany("DELETE FROM points WHERE block = ?", [(row[0],) for row in rows if len(row[1]) == 0])

    def _write_edges(self, database: "Statements") -> None:
        graph = self._world.covisibility
        changed = sorted(graph.unsaved)
        graph.unsaved.clear()
        for k in changed:
            database.execute("DELETE FROM covisibility WHERE older = ?", (k,))
            database.execute("DELETE FROM covisibility WHERE newer = ?", (k,))
            edges = [(min(k, other), max(k, other), weight) for other, weight in graph.edges_of(k).items()]
            insert(database, "covisibility", edges)

    def _write_loops(self, database: "Statements") -> None:
        loops = self._present_loops = list(self._world.loop_edges)
        if loops != self._loops:
            database.execute("DELETE FROM loops")
            insert(database, "loops", [(place, int(known), int(back)) for place, (known, back) in enumerate(loops)])


class Statements:
    """SQL statements with copies of their values, so that the map is not held up while a disk is written."""

    def __init__(self) -> None:
        """Start with none."""
        self._all: list[tuple[str, list[tuple[Any, ...]]]] = []

    def execute(self, statement: str, values: tuple[Any, ...] = ()) -> None:
        """Add a statement with one row of values."""
        self._all.append((statement, [values]))

    def executemany(self, statement: str, rows: Iterable[tuple[Any, ...]]) -> None:
        """Add a statement with many rows of values."""
        self._all.append((statement, list(rows)))

    def execute_on(self, database: sqlite3.Connection) -> None:
        """Execute all of them, in order."""
        for statement, rows in self._all:
            database.executemany(statement, rows)


def insert(database: "sqlite3.Connection | Statements", table: str, rows: Iterable[tuple[Any, ...]]) -> None:
    """Write rows into a table, over those of the same key."""
    rows = list(rows)
    if rows:
        marks = ", ".join("?" * len(rows[0]))
        database.executemany(f"INSERT OR REPLACE INTO {table} VALUES ({marks})", rows)


@dataclass(frozen=True)
class _Poses:
    """A copy of what may change of the keyframes themselves; K of them."""

    submap: I32
    is_alive: Bool
    parent: I32
    T_world_cam: F64
    T_parent_cam: F64
    scale: F64

    @classmethod
    def of(cls, world: Map, n: int) -> "_Poses":
        """Copy those of the first `n` keyframes."""
        table = world.keyframes
        submap, is_alive, parent = table.submap[:n].copy(), table.is_alive[:n].copy(), table.parent[:n].copy()
        T_parent_cam, scale = table.T_parent_cam[:n].copy(), table.scale[:n].copy()
        T_parent_cam[:, :3, 3] *= np.where(parent >= 0, table.scale[parent], 1.0)[:, None]
        return cls(submap, is_alive, parent, table.T_world_cam[:n].copy(), T_parent_cam, scale)

    def __len__(self) -> int:
        return len(self.parent)

    def row(self, k: int) -> tuple[int, int, int, bytes, bytes]:
        """Return the values of a keyframe as they are stored."""
        poses = POSES.pack(self.T_world_cam[k]), POSES.pack(self.T_parent_cam[k])
        return int(self.submap[k]), int(self.is_alive[k]), int(self.parent[k]), *poses

    def differing(self, earlier: "_Poses") -> list[int]:
        """Return which of the earlier keyframes are not as they were."""
        n = len(earlier)
        changed = (self.is_alive[:n] != earlier.is_alive) | (self.parent[:n] != earlier.parent)
        changed |= self.submap[:n] != earlier.submap
        for now, before in ((self.T_world_cam, earlier.T_world_cam), (self.T_parent_cam, earlier.T_parent_cam)):
            changed |= np.any(now[:n] != before, axis=(1, 2))
        return [int(k) for k in np.flatnonzero(changed)]


def _grown(T: F64, growth: float) -> F64:
    grown = T.copy()
    grown[:3, 3] *= growth
    return grown


def _taken(is_unsaved: Bool) -> I64:
    """Return the marked rows; none is marked any more."""
    rows = np.flatnonzero(is_unsaved)
    is_unsaved[rows] = False
    return rows


def _cut(packed: bytes, ends: NDArray[np.integer[Any]], n_rows: int) -> list[memoryview]:
    """Cut packed rows where each block ends."""
    row_bytes = len(packed) // max(1, n_rows)
    view, edges = memoryview(packed), [0, *(ends * row_bytes).tolist()]
    return [view[start:stop] for start, stop in pairwise(edges)]
