"""Reading a map file. It is opened read-only, read whole, and closed again."""

import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from stillroom.data.frame import ScaleLevels
from stillroom.data.image import Image
from stillroom.data.map import Map
from stillroom.data.sensor import Sensor
from stillroom.errors import CalibrationError, MapError
from stillroom.geometry.camera import Camera
from stillroom.storage.integrity import problems_of
from stillroom.storage.opening import reading
from stillroom.storage.pictures import Pictures, restore
from stillroom.storage.schema import (
    KEYPOINTS,
    OBSERVATIONS,
    POINT_IDS,
    POINTS,
    POSES,
    RGBD_VERSION,
    FrameNote,
    Packed,
    Session,
    StoredMap,
    column_types,
)

IMAGES = "images"
MOST_LEVELS, MOST_KEYPOINTS, MOST_POINTS_A_KEYPOINT = 255, 1_000_000, 100
"""Far more than any run makes; a damaged number must not make room for what is not there."""


def load_map(path: Path, whole: bool = True) -> StoredMap:
    """Return what a map file holds.

    Args:
        path: The file.
        whole: Whether to refuse an inconsistent map.

    Raises:
        MapError: There is no such file, it is no map, of a newer version, cut short or damaged.
    """
    with reading(path) as database:
        try:
            stored = _read(database)
        except MapError as error:
            raise MapError(f"{path}: {error}") from error
        except (TypeError, ValueError, OverflowError) as error:  # a number where an array should be, and the like
            raise MapError(f"{path}: is damaged ({error}); 'stillroom map check {path}' says more") from error
    # Dangling references would crash a run, or hang it.
    for problem in problems_of(stored) if whole else ():
        raise MapError(f"{path}: is damaged: {problem}; 'stillroom map check {path}' says more")
    return stored


def keyframe_images(path: Path) -> Iterator[tuple[int, Image]]:
    """Yield the images of the keyframes of which they were kept, with the keyframe's id, oldest first.

    Raises:
        MapError: As for `load_map`.
    """
    with reading(path) as database:
        _require_types(database, IMAGES)
        factor = float(database.execute("SELECT depth_factor FROM map").fetchone()[0])
        rows = database.execute(
            "SELECT keyframe, depth_png, rgb_jpeg, image_index, timestamp_s FROM images JOIN keyframes USING (keyframe)"
            " ORDER BY keyframe"
        )
        for keyframe, depth_png, rgb_jpeg, image_index, timestamp_s in rows:
            try:
                yield keyframe, restore(Pictures(keyframe, depth_png, rgb_jpeg), image_index, timestamp_s, factor)
            except MapError as error:
                raise MapError(f"{path}: {error}") from error


def _read(database: sqlite3.Connection) -> StoredMap:
    for table in column_types():
        if table != IMAGES:  # they are looked at when they are read
            _require_types(database, table)
    head = _head(database)
    camera = _camera(head)
    if not (1 <= head["n_levels"] <= MOST_LEVELS and 1.0 < head["scale_factor"] < np.inf):
        raise MapError(f"{head['n_levels']} pyramid levels of {head['scale_factor']} cannot be; the map is damaged")
    sensor = _sensor(database)
    world = Map(ScaleLevels.of(camera, sensor, head["scale_factor"], head["n_levels"]), sensor)
    _read_keyframes(database, world)
    _read_points(database, world, head["n_points"])
    edges = database.execute("SELECT older, newer, weight FROM covisibility ORDER BY older, newer").fetchall()
    world.covisibility.restore(np.array(edges, dtype=np.int32).reshape(-1, 3))
    world.loop_edges[:] = database.execute("SELECT known, returned FROM loops ORDER BY place").fetchall()
    sessions = database.execute(
        "SELECT first_keyframe, started, stillroom, source_commit, sequence, method, seed,"
        " vocabulary, vocabulary_digest, config FROM sessions ORDER BY session"
    )
    frames = database.execute(
        "SELECT session, image_index, timestamp_s, reference_keyframe, T_reference_cam FROM frames"
        " ORDER BY session, image_index"
    )
    return StoredMap(
        world,
        camera,
        tuple(Session(*row) for row in sessions),
        tuple(_frame(row) for row in frames),
    )


def _require_types(database: sqlite3.Connection, table: str) -> None:
    """Refuse values of another type than their column's: SQLite itself keeps any value in any column."""
    types = column_types()[table]
    found = database.execute(
        f"SELECT {', '.join(f'typeof({name})' for name in types)} FROM {table}"
        f" WHERE {' OR '.join(f'typeof({name}) <> {kind!r}' for name, kind in types.items())} LIMIT 1"
    ).fetchone()
    for (name, kind), is_kind in zip(types.items(), found or (), strict=found is not None):
        if is_kind != kind:
            raise MapError(f"{name} in the table {table} is {is_kind}, not {kind}; the map is damaged")


def _frame(row: tuple[int, int, float, int, bytes]) -> FrameNote:
    session, image_index, timestamp_s, keyframe, pose = row
    T_reference_cam = POSES.unpack(pose, 1, f"the pose of frame {image_index}")[0]
    return FrameNote(session, image_index, timestamp_s, keyframe, T_reference_cam)


def _head(database: sqlite3.Connection) -> dict[str, Any]:
    cursor = database.execute("SELECT * FROM map")
    row = cursor.fetchone()
    if row is None:
        raise MapError("its head is missing; the map is damaged")
    return dict(zip((column[0] for column in cursor.description), row, strict=True))


def _sensor(database: sqlite3.Connection) -> Sensor:
    """Return the sensor of a map; those of the first version are of RGB-D images."""
    if database.execute("PRAGMA user_version").fetchone()[0] == RGBD_VERSION:
        return Sensor.RGBD
    row = database.execute("SELECT sensor FROM sensor").fetchone()
    try:
        return Sensor("" if row is None else row[0])
    except ValueError:
        raise MapError(f"its sensor is '{row and row[0]}'; the map is damaged") from None


def _camera(head: dict[str, Any]) -> Camera:
    names = "width", "height", "fx", "fy", "cx", "cy", "depth_factor", "bf"
    k1, k2, p1, p2, k3 = (head[name] for name in ("k1", "k2", "p1", "p2", "k3"))
    try:
        return Camera(**{name: head[name] for name in names}, distortion=(k1, k2, p1, p2, k3))
    except CalibrationError as error:
        raise MapError(f"{error}; the map is damaged") from error


def _read_keyframes(database: sqlite3.Connection, world: Map) -> None:
    keyframes = database.execute(
        "SELECT keyframe, timestamp_s, image_index, n_keypoints, submap, is_alive, parent, T_world_cam, T_parent_cam"
        " FROM keyframes ORDER BY keyframe"
    ).fetchall()
    if not keyframes:
        return
    ids, timestamp_s, image_index, n_rows, submap, is_alive, parent, T_world_cam, T_parent_cam = zip(
        *keyframes, strict=True
    )
    if ids != tuple(range(len(ids))):
        raise MapError("keyframes are missing; the map is damaged")
    if not (min(n_rows) >= 0 and max(n_rows) <= MOST_KEYPOINTS):
        raise MapError(f"a keyframe counts {max(n_rows)} keypoints; the map is damaged")
    first_row = np.cumsum((0, *n_rows))
    world.keyframes.append(
        len(ids),
        timestamp_s=timestamp_s,
        image_index=image_index,
        submap=submap,
        is_alive=is_alive,
        parent=parent,
        T_world_cam=POSES.unpack(b"".join(T_world_cam), len(ids), "the poses of keyframes"),
        T_parent_cam=POSES.unpack(b"".join(T_parent_cam), len(ids), "the poses of culled keyframes"),
        first_row=first_row[:-1],
        n_rows=n_rows,
    )
    world.keypoints.append(int(first_row[-1]), keyframe=np.repeat(np.arange(len(ids)), n_rows))
    columns = {"next_row" if name == "older_row" else name: packed for name, packed in OBSERVATIONS.items()}
    _fill(database, world, "keypoints", KEYPOINTS)
    _fill(database, world, "observations", columns)


def _fill(database: sqlite3.Connection, world: Map, table: str, columns: dict[str, Packed]) -> None:
    """Read a table's arrays of each keyframe into columns of the keypoint table, given by their names in memory."""
    filled = np.zeros(len(world.keyframes), dtype=np.bool_)
    for keyframe, *blobs in database.execute(f"SELECT * FROM {table} ORDER BY keyframe"):
        if not 0 <= keyframe < len(filled):
            raise MapError(f"{table} of keyframe {keyframe}, which does not exist; the map is damaged")
        rows = world.rows(keyframe)
        for (name, packed), blob in zip(columns.items(), blobs, strict=True):
            what = f"{name} of keyframe {keyframe}"
            getattr(world.keypoints, name)[rows] = packed.unpack(blob, rows.stop - rows.start, what)
        filled[keyframe] = True
    missing = np.flatnonzero(world.keyframes.is_alive & ~filled)
    if len(missing):
        raise MapError(f"keyframe {missing[0]} has no {table}; the map is damaged")


def _read_points(database: sqlite3.Connection, world: Map, n_points: int) -> None:
    blocks = database.execute("SELECT * FROM points ORDER BY block").fetchall()
    points = world.points
    if not 0 <= n_points <= MOST_POINTS_A_KEYPOINT * len(world.keypoints):
        raise MapError(f"{n_points} points of {len(world.keypoints)} keypoints cannot be; the map is damaged")
    points.append(n_points, is_alive=False)
    if not blocks:
        return
    id_blobs, *columns = (b"".join(blobs) for blobs in list(zip(*blocks, strict=True))[1:])
    ids = POINT_IDS.unpack(id_blobs, len(id_blobs) // 4, "the ids of points")
    if len(ids) and (np.any(np.diff(ids) <= 0) or ids[0] < 0 or ids[-1] >= n_points):
        raise MapError("the ids of points are out of order; the map is damaged")
    points.is_alive[ids] = True
    for (name, packed), blob in zip(POINTS.items(), columns, strict=True):
        getattr(points, name)[ids] = packed.unpack(blob, len(ids), f"{name} of points")


def count_images(path: Path) -> int:
    """Return how many keyframes have stored images.

    Raises:
        MapError: As for `load_map`.
    """
    with reading(path) as database:
        return int(database.execute("SELECT count(*) FROM images").fetchone()[0])
