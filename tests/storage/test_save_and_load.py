"""What is written is what is read."""

import shutil
import sqlite3
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from random_map import EventfulLife, assert_same_map, notes, session
from small_world import CAMERA, SCALES, SmallMap, SmallWorld, pose

from stillroom.data.frame import ScaleLevels
from stillroom.data.map import Map
from stillroom.data.map.tables import Column, KeyframeTable, KeypointTable, PointTable
from stillroom.geometry.camera import Camera
from stillroom.storage import StoredMap, changes, load_map, save_map
from stillroom.storage.check import check_map
from stillroom.storage.opening import log_of
from stillroom.storage.writer import MapWriter
from stillroom.tracking.undecided import put_back


def content(path: Path) -> list[str]:
    """All that a database holds, as SQL."""
    database = sqlite3.connect(path)
    said = list(database.iterdump())
    database.close()
    return said


def as_after_a_crash(path: Path, folder: Path) -> Path:
    """A copy of a file that is being written, with its log, as the end of the process would leave them."""
    folder.mkdir()
    for file in (path, log_of(path)):
        shutil.copy(file, folder / file.name)
    return folder / path.name


@pytest.mark.parametrize("seed", range(4))
def test_every_commit_holds_the_map_as_it_was_then(seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # A block that is written for the sake of one point would hide that another's change was missed.
    monkeypatch.setattr(changes, "POINTS_A_BLOCK", 1 if seed % 2 else 3)
    life, path = EventfulLife(seed), tmp_path / "room.stillmap"
    with MapWriter.create(path, life.world, CAMERA) as writer:
        writer.begin(session())
        for step in range(25):
            life.happen(int(life.rng.integers(0, 5)))
            writer.commit(notes(2, first=2 * step))
            crashed = as_after_a_crash(path, tmp_path / str(step))
            stored = load_map(crashed)
            assert_same_map(stored.world, life.world, with_counts=False)
            assert len(stored.frames) == 2 * (step + 1)
            assert check_map(crashed) == []
    assert_same_map(load_map(path).world, life.world)
    assert [file.name for file in tmp_path.iterdir() if file.is_file()] == ["room.stillmap"]
    # Written bit by bit, it holds what it would hold if written at once: nothing is left of what is gone.
    save_map(tmp_path / "at once.stillmap", load_map(path))
    assert content(path) == content(tmp_path / "at once.stillmap")
    assert (~life.world.keyframes.is_alive).any()
    assert (~life.world.points.is_alive).sum() > 20


@pytest.mark.parametrize("seed", range(3))
def test_save_load_save_gives_the_same_content(seed: int, tmp_path: Path) -> None:
    life = EventfulLife(seed)
    life.happen(60)
    camera = replace(CAMERA, distortion=(0.1, -0.2, 1e-17, 0.3, -5.0), depth_factor=1234.5678901234567)
    runs = session(), session(2, name="another day")
    frames = (*notes(3), *notes(4, number=1))
    stored = StoredMap(life.world, camera, runs, frames)
    first, second = tmp_path / "first.stillmap", tmp_path / "second.stillmap"
    save_map(first, stored)
    again = load_map(first)
    assert (again.camera, again.sessions) == (camera, runs)
    for found, expected in zip(again.frames, frames, strict=True):
        np.testing.assert_array_equal(found.T_reference_cam, expected.T_reference_cam)
        assert replace(found, T_reference_cam=None) == replace(expected, T_reference_cam=None)
    assert_same_map(again.world, life.world)
    save_map(second, again)
    assert content(second) == content(first)
    assert check_map(second) == []


def test_a_loaded_map_lives_on_as_the_one_that_was_saved(tmp_path: Path) -> None:
    life, path = EventfulLife(5), tmp_path / "room.stillmap"
    life.happen(40)
    save_map(path, StoredMap(life.world, CAMERA))
    twin = EventfulLife(5)
    twin.happen(40)
    twin.small.map = load_map(path).world
    for each in (life, twin):
        each.happen(60)
    assert_same_map(twin.world, life.world)


def test_going_on_adds_to_the_file_what_has_changed_since(tmp_path: Path) -> None:
    life, path = EventfulLife(6), tmp_path / "room.stillmap"
    with MapWriter.create(path, life.world, CAMERA) as writer:
        writer.begin(session())
        life.happen(20)
        writer.commit(notes(3))
    life.small.map = load_map(path).world
    first = len(life.world.keyframes)
    with MapWriter.go_on(path, life.world) as writer:
        assert writer.begin(session(first)) == 1
        before = writer._connection.total_changes
        writer.commit()
        assert writer._connection.total_changes - before == 1  # the number of points, whatever it is
        life.happen(30)
        writer.commit(notes(2, number=1))
    stored = load_map(path)
    assert_same_map(stored.world, life.world)
    assert [run.first_keyframe for run in stored.sessions] == [0, first]
    assert [(frame.session, frame.image_index) for frame in stored.frames] == [(0, 0), (0, 1), (0, 2), (1, 0), (1, 1)]
    assert check_map(path) == []


def test_keypoints_that_were_put_back_are_written_again(tmp_path: Path) -> None:
    """As where a recording turns out to have a global shutter (`tracking/undecided.py`)."""
    small, path = SmallMap.of(SmallWorld.of(0), [pose(), pose(0.1)]), tmp_path / "room.stillmap"
    with MapWriter.create(path, small.map, CAMERA) as writer:
        writer.begin(session())
        small.map.keypoints.px[small.map.rows(1)] += 0.5  # as moved to mid-frame
        writer.commit()
        before = writer._connection.total_changes
        put_back(1, small.frames[1].keypoints, pose(0.1), CAMERA, small.map)
        writer.commit()
        assert_same_map(load_map(as_after_a_crash(path, tmp_path / "crashed")).world, small.map, with_counts=False)
        n_written = writer._connection.total_changes - before
        writer.commit()
        assert writer._connection.total_changes - before - n_written == 1, "the number of points alone"
    assert_same_map(load_map(path).world, small.map)


def test_going_on_after_a_crash_leaves_one_file(tmp_path: Path) -> None:
    life = EventfulLife(8)
    writer = MapWriter.create(tmp_path / "room.stillmap", life.world, CAMERA)
    life.happen(10)
    writer.commit()
    crashed = as_after_a_crash(writer.path, tmp_path / "crashed")
    before = crashed.read_bytes(), log_of(crashed).read_bytes()
    assert check_map(crashed) == []
    life.small.map = load_map(crashed).world
    assert (crashed.read_bytes(), log_of(crashed).read_bytes()) == before
    with MapWriter.go_on(crashed, life.world):
        life.happen(10)
    assert_same_map(load_map(crashed).world, life.world)
    assert [file.name for file in crashed.parent.iterdir()] == ["room.stillmap"]
    writer.abandon()


def test_a_commit_writes_little_of_a_large_map(tmp_path: Path) -> None:
    """A keyframe at the far end of a long map costs as much as one of a short map."""
    sizes = []
    for n_keyframes in (10, 60):
        small, path = SmallMap(SmallWorld.of(0, n=10)), tmp_path / f"{n_keyframes}.stillmap"
        with MapWriter.create(path, small.map, CAMERA) as writer:
            for place in range(n_keyframes):
                # A corridor: each keyframe sees points of its own.
                small.world = SmallWorld.of(place, n=300)
                small.id_of = np.full(300, -1, np.int32)
                k = len(small.map.keyframes)
                frame, seen = small.world.look(pose(), seed=k, index=k)
                small.map.add_keyframe(frame, pose(), small.id_of[seen], frame.is_static, k - 1)
                small.map.add_points(small.world.points_m[seen], small.map.rows(k).start + np.arange(len(seen)))
                small.map.connect(k)
                before = log_of(path).stat().st_size
                writer.commit()
            sizes.append(log_of(path).stat().st_size - before)
    assert sizes[1] < 1.2 * sizes[0]


def test_an_empty_map_is_a_map(tmp_path: Path) -> None:
    path = tmp_path / "room.stillmap"
    with MapWriter.create(path, Map(ScaleLevels(1.5, 3)), CAMERA):
        pass
    stored = load_map(path)
    assert len(stored.world.keyframes) == len(stored.world.points) == len(stored.world.keypoints) == 0
    assert stored.world.scales == ScaleLevels(1.5, 3)
    assert check_map(path) == []


def test_after_an_error_the_last_commit_stays(tmp_path: Path) -> None:
    life, path, committed = EventfulLife(7), tmp_path / "room.stillmap", []

    def fail() -> None:
        with MapWriter.create(path, life.world, CAMERA) as writer:
            writer.commit()
            committed.append(len(life.world.keyframes))
            life.add_keyframe()
            raise RuntimeError("in the middle of mapping")

    with pytest.raises(RuntimeError, match="in the middle"):
        fail()
    assert [len(load_map(path).world.keyframes)] == committed == [5]
    assert check_map(path) == []
    assert not log_of(path).exists()


def test_every_column_of_the_map_is_stored_or_follows_from_others() -> None:
    """Whoever adds a column to the map must say what becomes of it on disk."""
    from stillroom.storage.schema import KEYPOINTS, OBSERVATIONS, POINTS

    def columns(table: type) -> set[str]:
        return {name for name, value in vars(table).items() if isinstance(value, Column)}

    stored = {"next_row" if name == "older_row" else name for name in (*KEYPOINTS, *OBSERVATIONS)}
    # On disk all observations weigh the same: a map that is opened again was static where it was kept.
    assert columns(KeypointTable) == stored | {"keyframe", "p_static"}
    # Nobody asks a map on disk what points were replaced by: those who did were frames of that run.
    assert columns(PointTable) == set(POINTS) | {"is_alive", "replaced_by", "is_unsaved"}
    stored = {"timestamp_s", "image_index", "n_rows", "submap", "is_alive", "parent", "T_world_cam", "T_parent_cam"}
    # What lengths were multiplied by is 1 in a file: what is noted in them is stored as it is now.
    assert columns(KeyframeTable) == stored | {"first_row", "is_unsaved", "scale"}


def test_a_camera_comes_back_to_the_last_bit(tmp_path: Path) -> None:
    camera = Camera(333, 222, np.pi * 100, 1 / 3, -0.1, 1e300, (1e-300, -1.0, 2.0, 1 / 7, 0.0), 0.1, 5e-324)
    path = tmp_path / "room.stillmap"
    save_map(path, StoredMap(Map(SCALES), camera))
    assert load_map(path).camera == camera
