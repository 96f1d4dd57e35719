"""The check finds every kind of damage, and names it."""

import sqlite3
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from random_map import EventfulLife, notes, session
from small_world import CAMERA

from stillroom.errors import MapError
from stillroom.storage import StoredMap, load_map, save_map
from stillroom.storage.check import check_map
from stillroom.storage.integrity import are_rigid

Damage = Callable[[sqlite3.Connection], object]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    life = EventfulLife(3)
    life.happen(40)
    path = tmp_path / "room.stillmap"
    save_map(path, StoredMap(life.world, CAMERA, (session(), session(2)), tuple(notes(4))))
    assert check_map(path) == []
    return path


def in_blob(table: str, column: str, dtype: str, change: Callable[[np.ndarray], object], row: int = 0) -> Damage:
    """Change an array in the n-th row of a table."""

    def damage(database: sqlite3.Connection) -> None:
        key = database.execute(f"SELECT rowid FROM {table} ORDER BY rowid LIMIT 1 OFFSET {row}").fetchone()[0]
        blob = database.execute(f"SELECT {column} FROM {table} WHERE rowid = ?", (key,)).fetchone()[0]
        values = np.frombuffer(blob, dtype).copy()
        change(values)
        database.execute(f"UPDATE {table} SET {column} = ? WHERE rowid = ?", (values.tobytes(), key))

    return damage


def sql(text: str) -> Damage:
    return lambda database: database.execute(text)


def put(place: int, value: float) -> Callable[[np.ndarray], object]:
    return lambda values: values.__setitem__(place, value)


def first_seen(value: int) -> Callable[[np.ndarray], object]:
    return lambda values: values.__setitem__(int(np.flatnonzero(values >= 0)[0]), value)


def see_twice(values: np.ndarray) -> None:
    first, second = np.flatnonzero(values >= 0)[:2]
    values[first] = values[second]


def drop_first(values: np.ndarray) -> None:
    values[int(np.flatnonzero(values >= 0)[0])] = -1


DAMAGES: dict[str, tuple[Damage, str]] = {
    "a keyframe is missing": (sql("DELETE FROM keyframes WHERE keyframe = 1"), "keyframes are missing"),
    "keypoints are missing": (sql("DELETE FROM keypoints WHERE keyframe = 0"), "keyframe 0 has no keypoints"),
    "observations are missing": (sql("DELETE FROM observations WHERE keyframe = 0"), "keyframe 0 has no observations"),
    "keypoints of no keyframe": (sql("UPDATE keypoints SET keyframe = 999 WHERE keyframe = 0"), "does not exist"),
    "a short array": (sql("UPDATE keypoints SET px = substr(px, 9) WHERE keyframe = 0"), "px of keyframe 0 has"),
    "a pose with a NaN": (
        in_blob("keyframes", "T_world_cam", "<f8", put(3, np.nan)),
        "pose of keyframe 0 is not rigid",
    ),
    "a pose that stretches": (in_blob("keyframes", "T_world_cam", "<f8", put(0, 1.01)), "keyframe 0 is not rigid"),
    "a time that is none": (sql("UPDATE keyframes SET timestamp_s = 9e999 WHERE keyframe = 0"), "time of keyframe 0"),
    "a parent that does not exist": (sql("UPDATE keyframes SET parent = 777 WHERE keyframe = 2"), "has the parent 777"),
    "a culled one without parent": (
        sql(
            "UPDATE keyframes SET parent = -1 WHERE keyframe = (SELECT min(keyframe) FROM keyframes WHERE NOT is_alive)"
        ),
        "has no ancestor that is alive",
    ),
    "culled ones in a circle": (
        sql("UPDATE keyframes SET parent = keyframe WHERE NOT is_alive"),
        "has no ancestor that is alive",
    ),
    "a point that does not exist": (in_blob("observations", "point", "<i4", first_seen(99999)), "does not exist"),
    "an observation that no list knows": (in_blob("observations", "point", "<i4", drop_first), "leads to a keypoint"),
    "a point seen twice": (in_blob("observations", "point", "<i4", see_twice), "twice"),
    "a list that runs in a circle": (
        in_blob("observations", "older_row", "<i4", lambda values: values.__setitem__(slice(None), 0)),
        "list of point",
    ),
    "a list that leads nowhere": (
        in_blob("observations", "older_row", "<i4", lambda values: values.__setitem__(slice(None), 10**6)),
        "list of point",
    ),
    "a wrong count": (in_blob("points", "n_keyframes", "<i4", lambda values: values.__iadd__(1)), "it counts"),
    "a wrong count of depths": (in_blob("points", "n_observations", "<i4", put(0, 99)), "it counts"),
    "a point at infinity": (in_blob("points", "position_m", "<f8", put(4, np.inf)), "position_m of point"),
    "a point without direction": (in_blob("points", "normal", "<f8", put(1, np.nan)), "normal of point"),
    "points that are gone": (sql("DELETE FROM points"), "which is gone"),
    "points out of order": (in_blob("points", "id", "<i4", put(1, 0)), "out of order"),
    "a keypoint nowhere": (in_blob("keypoints", "px", "<f4", put(0, np.nan)), "px of keypoint row 0"),
    "a level that does not exist": (in_blob("keypoints", "octave", "u1", put(5, 8)), "pyramid level 8"),
    "an edge to nobody": (sql("INSERT INTO covisibility VALUES (0, 555, 20)"), "keyframes 0 and 555"),
    "an edge without weight": (sql("UPDATE covisibility SET weight = 0"), "by 0 points"),
    "a loop with nobody": (sql("INSERT INTO loops VALUES (99, 0, 333)"), "a loop joins keyframes 0 and 333"),
    "a frame on no keyframe": (sql("UPDATE frames SET reference_keyframe = 444 WHERE image_index = 1"), "frame 1 of"),
    "a frame of no session": (sql("UPDATE frames SET session = 5 WHERE image_index = 2"), "belongs to no session"),
    "a frame with a crooked pose": (
        sql("UPDATE frames SET T_reference_cam = zeroblob(128) WHERE image_index = 3"),
        "frame 3 is not rigid",
    ),
    "sessions out of order": (sql("UPDATE sessions SET first_keyframe = 9999 WHERE session = 0"), "out of order"),
    "a config that is none": (sql("UPDATE sessions SET config = 'a = = b' WHERE session = 1"), "is no TOML"),
    "no head": (sql("DELETE FROM map"), "head is missing"),
    "a camera that cannot be": (sql("UPDATE map SET fx = -1"), "fx is -1"),
    "a number for an array": (sql("UPDATE keypoints SET px = 5 WHERE keyframe = 0"), "damaged"),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_damage_is_found_and_named(name: str, path: Path) -> None:
    damage, said = DAMAGES[name]
    database = sqlite3.connect(path)
    damage(database)
    database.commit()
    database.close()
    problems = check_map(path)
    assert problems, "nothing was found"
    assert any(said in problem for problem in problems), problems[:5]
    assert all("\n" not in problem for problem in problems)


@pytest.mark.parametrize(
    "name", ["a parent that does not exist", "a point that does not exist", "culled ones in a circle"]
)
def test_what_would_crash_or_hang_is_not_even_loaded(name: str, path: Path) -> None:
    database = sqlite3.connect(path)
    DAMAGES[name][0](database)
    database.commit()
    database.close()
    with pytest.raises(MapError, match=r"is damaged: .*; 'stillroom map check"):
        load_map(path)


def test_a_page_that_is_damaged_is_found(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[2 * 8192 : 3 * 8192] = b"\xff" * 8192
    path.write_bytes(content)
    with pytest.raises(MapError, match="damaged"):
        load_map(path)
    with pytest.raises(MapError, match="damaged"):  # so badly that SQLite cannot even look for more
        check_map(path)


def test_rigid_motions_are_told_from_others() -> None:
    rng = np.random.default_rng(0)
    Q, _ = np.linalg.qr(rng.normal(size=(50, 3, 3)))
    poses = np.tile(np.eye(4), (50, 1, 1))
    poses[:, :3, :3] = Q
    poses[:, :3, 3] = rng.normal(size=(50, 3)) * 100
    np.testing.assert_array_equal(are_rigid(poses), np.linalg.det(Q) > 0)
    poses[:, 3, 0] = 1e-3
    assert not are_rigid(poses).any()
    assert are_rigid(np.zeros((0, 4, 4))).shape == (0,)
