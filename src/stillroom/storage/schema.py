"""The tables of a map file. docs/map-file.md describes them; a change here needs a new `VERSION`."""

import functools
import sqlite3
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stillroom.data.map import Map
from stillroom.data.result import FrameSummary
from stillroom.errors import MapError
from stillroom.geometry.arrays import F64
from stillroom.geometry.camera import Camera

APPLICATION_ID = 0x5374696C
"""The application id in the file's header: "Stil" in ASCII."""
VERSION = 2
"""The newest version of the format, in the header's `user_version`."""
RGBD_VERSION = 1
"""The version of maps of RGB-D images, which have no table of the sensor; programs that know no other can read them."""
SENSOR_TABLE = """
CREATE TABLE sensor (
    id INTEGER PRIMARY KEY CHECK (id = 1),
    sensor TEXT NOT NULL
);
"""
POINTS_A_BLOCK = 256
"""Points are stored in blocks of this many ids: a block is written again when one of its points has changed."""
TABLES = """
CREATE TABLE map (
    id INTEGER PRIMARY KEY CHECK (id = 1),
    width INTEGER NOT NULL, height INTEGER NOT NULL,
    fx REAL NOT NULL, fy REAL NOT NULL, cx REAL NOT NULL, cy REAL NOT NULL,
    k1 REAL NOT NULL, k2 REAL NOT NULL, p1 REAL NOT NULL, p2 REAL NOT NULL, k3 REAL NOT NULL,
    depth_factor REAL NOT NULL, bf REAL NOT NULL,
    scale_factor REAL NOT NULL, n_levels INTEGER NOT NULL,
    n_points INTEGER NOT NULL
);
CREATE TABLE sessions (
    session INTEGER PRIMARY KEY,
    first_keyframe INTEGER NOT NULL,
    started TEXT NOT NULL, stillroom TEXT NOT NULL, source_commit TEXT NOT NULL,
    sequence TEXT NOT NULL, method TEXT NOT NULL, seed INTEGER NOT NULL,
    vocabulary TEXT NOT NULL, vocabulary_digest TEXT NOT NULL, config TEXT NOT NULL
);
CREATE TABLE keyframes (
    keyframe INTEGER PRIMARY KEY,
    timestamp_s REAL NOT NULL, image_index INTEGER NOT NULL, n_keypoints INTEGER NOT NULL,
    submap INTEGER NOT NULL, is_alive INTEGER NOT NULL, parent INTEGER NOT NULL,
    T_world_cam BLOB NOT NULL, T_parent_cam BLOB NOT NULL
);
CREATE TABLE keypoints (
    keyframe INTEGER PRIMARY KEY,
    px BLOB NOT NULL, octave BLOB NOT NULL, angle_rad BLOB NOT NULL, right_px BLOB NOT NULL, depth_m BLOB NOT NULL,
    descriptors BLOB NOT NULL, is_static BLOB NOT NULL
);
CREATE TABLE observations (
    keyframe INTEGER PRIMARY KEY,
    point BLOB NOT NULL, older_row BLOB NOT NULL
);
CREATE TABLE points (
    block INTEGER PRIMARY KEY,
    id BLOB NOT NULL,
    position_m BLOB NOT NULL, descriptors BLOB NOT NULL, normal BLOB NOT NULL,
    min_distance_m BLOB NOT NULL, max_distance_m BLOB NOT NULL,
    first_row BLOB NOT NULL, n_observations BLOB NOT NULL, n_keyframes BLOB NOT NULL, first_keyframe BLOB NOT NULL,
    n_visible BLOB NOT NULL, n_found BLOB NOT NULL
);
CREATE TABLE covisibility (
    older INTEGER NOT NULL, newer INTEGER NOT NULL, weight INTEGER NOT NULL,
    PRIMARY KEY (older, newer)
) WITHOUT ROWID;
CREATE INDEX covisibility_newer ON covisibility (newer);
CREATE TABLE loops (
    place INTEGER PRIMARY KEY,
    known INTEGER NOT NULL, returned INTEGER NOT NULL
);
CREATE TABLE frames (
    session INTEGER NOT NULL, image_index INTEGER NOT NULL,
    timestamp_s REAL NOT NULL, reference_keyframe INTEGER NOT NULL, T_reference_cam BLOB NOT NULL,
    PRIMARY KEY (session, image_index)
) WITHOUT ROWID;
CREATE TABLE images (
    keyframe INTEGER PRIMARY KEY,
    depth_png BLOB NOT NULL, rgb_jpeg BLOB NOT NULL
);
"""
POSE = np.dtype("<f8")


@functools.cache
def column_types() -> dict[str, dict[str, str]]:
    """Return, for each table, its columns and what SQLite's `typeof` must say of all their values."""
    with closing(sqlite3.connect(":memory:")) as database:
        database.executescript(TABLES)
        names = [name for (name,) in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
        rows = {name: database.execute(f"PRAGMA table_info({name})").fetchall() for name in names}
    return {name: {row[1]: row[2].lower() for row in columns} for name, columns in rows.items()}


# The contents of a map file in addition to the tables of the map itself.


@dataclass(frozen=True)
class Session:
    """One run that created or extended the map.

    Attributes:
        first_keyframe: Id from which on the keyframes are this session's, until the next one's.
        started: When, ISO 8601.
        stillroom: Version of the program.
        source_commit: Its git commit, where known.
        sequence: Name of the sequence.
        method: Name of the method.
        seed: Seed of all random choices.
        vocabulary: The file of the vocabulary by which it recognised places; "" for the one that is shipped.
        vocabulary_digest: Identifies the vocabulary. No words are stored: they are computed again.
        config: The effective config as TOML.
    """

    first_keyframe: int
    started: str
    stillroom: str
    source_commit: str
    sequence: str
    method: str
    seed: int
    vocabulary: str
    vocabulary_digest: str
    config: str


@dataclass(frozen=True)
class FrameNote:
    """A tracked frame, with its pose relative to its reference keyframe.

    Attributes:
        session: Which session it belongs to, from 0.
        image_index: Number of the image in its sequence.
        timestamp_s: Its time [s].
        reference_keyframe: Id of its reference keyframe.
        T_reference_cam: Its pose in that keyframe (4, 4), as `Map.noted_in` notes it.
    """

    session: int
    image_index: int
    timestamp_s: float
    reference_keyframe: int
    T_reference_cam: F64

    @classmethod
    def of(cls, result: FrameSummary, session: int) -> "FrameNote | None":
        """Return the entry of a frame; None for one that was lost."""
        if result.T_reference_cam is None:
            return None
        return cls(session, result.index, result.timestamp_s, result.reference_keyframe, result.T_reference_cam)


@dataclass(frozen=True)
class StoredMap:
    """All that a map file holds, but the images of its keyframes.

    Attributes:
        world: The map.
        camera: The camera that took it.
        sessions: The runs that made it, oldest first.
        frames: The frames that they tracked, in order of session and image.
    """

    world: Map
    camera: Camera
    sessions: tuple[Session, ...] = ()
    frames: tuple[FrameNote, ...] = ()


@dataclass(frozen=True)
class Packed:
    """An array column: rows of shape `tail` one after the other, little-endian.

    Attributes:
        stored: Type in the file.
        kept: Type in memory; the file's type holds all values that occur.
        tail: Shape of a row.
    """

    stored: str
    kept: type[np.generic]
    tail: tuple[int, ...] = ()

    def pack(self, values: NDArray[Any]) -> bytes:
        """Return rows (N, *tail) as they are stored."""
        return np.ascontiguousarray(values, dtype=self.stored).tobytes()

    def unpack(self, blob: bytes, n_rows: int, what: str) -> NDArray[Any]:
        """Return rows (N, *tail) of what was stored.

        Args:
            blob: What was stored.
            n_rows: How many rows it must hold.
            what: Where it comes from, for the message.

        Raises:
            MapError: It has another size.
        """
        dtype = np.dtype(self.stored)
        expected = n_rows * int(np.prod(self.tail, dtype=np.int64)) * dtype.itemsize
        if len(blob) != expected:
            raise MapError(f"{what} has {len(blob)} bytes; it must have {expected}; the map is damaged")
        return np.frombuffer(blob, dtype=dtype).reshape(n_rows, *self.tail).astype(self.kept)


KEYPOINTS = {
    "px": Packed("<f4", np.float32, (2,)),
    "octave": Packed("u1", np.int32),
    "angle_rad": Packed("<f4", np.float32),
    "right_px": Packed("<f4", np.float32),
    "depth_m": Packed("<f4", np.float32),
    "descriptors": Packed("u1", np.uint8, (32,)),
    "is_static": Packed("u1", np.bool_),
}

OBSERVATIONS = {"point": Packed("<i4", np.int32), "older_row": Packed("<i4", np.int32)}

POINT_IDS = Packed("<i4", np.int32)

POINTS = {
    "position_m": Packed("<f8", np.float64, (3,)),
    "descriptors": Packed("u1", np.uint8, (32,)),
    "normal": Packed("<f8", np.float64, (3,)),
    "min_distance_m": Packed("<f8", np.float64),
    "max_distance_m": Packed("<f8", np.float64),
    "first_row": Packed("<i4", np.int32),
    "n_observations": Packed("<i4", np.int32),
    "n_keyframes": Packed("<i4", np.int32),
    "first_keyframe": Packed("<i4", np.int32),
    "n_visible": Packed("<i4", np.int32),
    "n_found": Packed("<i4", np.int32),
}

POSES = Packed("<f8", np.float64, (4, 4))
