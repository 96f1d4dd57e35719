"""A map file knows its sensor; those of the first version are of RGB-D images."""

import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from random_map import EventfulLife, assert_same_map, session
from small_world import CAMERA, SCALES, SmallMap, SmallWorld, pose

from stillroom.data.map import Map, submaps
from stillroom.data.sensor import Sensor
from stillroom.errors import MapError
from stillroom.storage import StoredMap, load_map, save_map
from stillroom.storage.check import check_map
from stillroom.storage.opening import inspect
from stillroom.storage.schema import RGBD_VERSION, VERSION
from stillroom.storage.writer import MapWriter


def kept(path: Path, sensor: Sensor) -> Path:
    life = EventfulLife(0)
    life.world.sensor = sensor
    for _ in range(8):
        life.happen(0)
    save_map(path, StoredMap(life.world, CAMERA, (session(),)))
    assert_same_map(load_map(path).world, life.world)
    return path


def changed(path: Path, statement: str) -> None:
    with closing(sqlite3.connect(path)) as database:
        database.execute(statement)
        database.commit()


@pytest.mark.parametrize("sensor", list(Sensor))
def test_a_map_is_read_back_with_its_sensor(sensor: Sensor, tmp_path: Path) -> None:
    path = kept(tmp_path / "room.stillmap", sensor)
    stored = load_map(path)
    assert stored.world.sensor is sensor
    assert check_map(path) == []
    assert inspect(path).version == (RGBD_VERSION if sensor is Sensor.RGBD else VERSION)
    with MapWriter.go_on(path, stored.world) as writer:
        writer.begin(session())
    assert load_map(path).world.sensor is sensor


def test_maps_of_rgbd_images_stay_as_they_were(tmp_path: Path) -> None:
    """An older Stillroom, which knows version 1 only, reads them."""
    path = kept(tmp_path / "room.stillmap", Sensor.RGBD)
    with closing(sqlite3.connect(path)) as database:
        tables = {name for (name,) in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
        assert database.execute("PRAGMA user_version").fetchone() == (1,)
    assert "sensor" not in tables


@pytest.mark.parametrize(
    ("statement", "message"),
    [
        ("UPDATE sensor SET sensor = 'sonar'", "its sensor is 'sonar'; the map is damaged"),
        ("DELETE FROM sensor", "the map is damaged"),
        ("DROP TABLE sensor", "no such table"),
    ],
)
def test_a_damaged_sensor_is_refused_in_one_line(statement: str, message: str, tmp_path: Path) -> None:
    path = kept(tmp_path / "room.stillmap", Sensor.STEREO)
    changed(path, statement)
    with pytest.raises(MapError, match=message) as raised:
        load_map(path)
    assert "\n" not in str(raised.value)


def mapped(sensor: Sensor) -> Map:
    small = SmallMap(SmallWorld.of(0, 300), Map(SCALES, sensor))
    for k in range(3):
        small.add(pose(0.1 * k), depth_share=0.0)
    return small.map


@pytest.mark.parametrize("n_submaps", [1, 2])
def test_a_map_of_which_a_young_one_was_dropped_is_not_damaged(n_submaps: int, tmp_path: Path) -> None:
    world = mapped(Sensor.MONOCULAR)
    if n_submaps == 2:
        world.keyframes.parent[2] = -1
        world.keyframes.submap[2] = 1
    submaps.discard(0, world)
    path = tmp_path / "room.stillmap"
    save_map(path, StoredMap(world, CAMERA, (session(),)))
    assert check_map(path) == []
    again = load_map(path).world
    assert again.is_empty == (n_submaps == 1)
    for keyframe in range(3):
        np.testing.assert_allclose(again.keyframe_pose(keyframe), world.keyframe_pose(keyframe), atol=1e-12)


def test_a_culled_origin_of_a_sub_map_that_is_there_is_damage(tmp_path: Path) -> None:
    """Also that of a metric map as a whole: only what a single camera begins is ever dropped."""
    for sensor, culled in ((Sensor.MONOCULAR, [0]), (Sensor.RGBD, [0, 1, 2])):
        world = mapped(sensor)
        for keyframe in culled[::-1]:
            world.remove_keyframe(keyframe)
        path = tmp_path / f"{sensor}.stillmap"
        save_map(path, StoredMap(world, CAMERA, (session(),)))
        assert any("no ancestor that is alive" in problem for problem in check_map(path))
