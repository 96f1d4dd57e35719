"""Maps by command: made, looked at, gone on in; and every misuse in one line."""

import hashlib
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest
from random_map import EventfulLife, notes, session
from small_world import CAMERA

from stillroom.data.trajectory import read_tum
from stillroom.storage import StoredMap, load_map, save_map
from stillroom.storage.check import check_map

FEW = ("--pictures", "0", "--method", "orb-slam2")


@pytest.fixture
def small(tmp_path: Path) -> Path:
    """A small map that nobody tracked."""
    life, path = EventfulLife(1), tmp_path / "small.stillmap"
    life.happen(20)
    life.world.keyframes.submap[:] = 0
    life.world.keyframes.timestamp_s[:] = range(len(life.world.keyframes))
    save_map(path, StoredMap(life.world, CAMERA, (session(), session(3, "another")), tuple(notes(5))))
    return path


def sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def test_a_map_is_made_tracked_against_and_gone_on_in(stillroom: Callable, recorded: Path, tmp_path: Path) -> None:
    made = stillroom("run", recorded, "--frames", ":16", "--map", "room.stillmap", "--out", "first", *FEW)
    assert (made.code, made.errors) == (0, [])
    assert "map file: room.stillmap" in made.out
    path = Path("room.stillmap")
    digest = sha256(path)

    looked = stillroom(
        "run", recorded, "--frames", "8:", "--reverse", "--map", path, "--localize", "--out", "second", *FEW
    )
    assert (looked.code, looked.errors) == (0, [])
    assert len(read_tum(Path("second/trajectory.tum"))) == 16
    assert sha256(path) == digest
    said = tomllib.loads(Path("second/config.toml").read_text())
    assert (said["run"]["map"], said["run"]["map_use"]) == ("room.stillmap", "localize")
    assert said["run"]["source"]["reverse"] is True
    assert said["keyframes"]["enabled"] is False

    gone_on = stillroom("run", recorded, "--frames", "12:", "--map", path, "--continue", "--out", "third", *FEW)
    assert (gone_on.code, gone_on.errors) == (0, [])
    assert len(load_map(path).sessions) == 2
    checked = stillroom("map", "check", path)
    assert (checked.code, checked.out) == (0, "room.stillmap: whole\n")
    described = stillroom("map", "info", path)
    assert described.code == 0
    for word in ("map format 1", "640×480", "room", "orb-slam2", "0 to 15", "12 to 23", "no images"):
        assert word in described.out, described.out
    assert sorted(file.name for file in Path().iterdir()) == ["first", "room.stillmap", "second", "third"]


def test_export_writes_what_is_asked_for(stillroom: Callable, small: Path) -> None:
    said = stillroom("map", "export", small)
    assert said.code == 0
    folder = small.with_suffix("")
    names = {"trajectory_0.tum", "trajectory_1.tum", "keyframes_0.tum", "keyframes_1.tum"}
    assert {file.name for file in folder.iterdir()} == names
    assert len(read_tum(folder / "trajectory_0.tum")) == 5


def test_colmap_is_refused_where_there_are_no_images(stillroom: Callable, small: Path) -> None:
    said = stillroom("map", "export", small, "--format", "colmap", "--out", "elsewhere")
    assert said.code == 1
    [error] = said.errors
    assert "make it again with --set storage.images=true [see troubleshooting: colmap]" in error
    assert not Path("elsewhere").exists()


def test_colmap_names_images_that_are_there(stillroom: Callable, recorded: Path) -> None:
    options = ("--set", "storage.images=true", "--map", "room.stillmap", "--out", "results", *FEW)
    assert stillroom("run", recorded, "--frames", ":6", *options).code == 0
    said = stillroom("map", "export", "room.stillmap")
    assert (said.code, said.errors) == (0, [])
    heads = [line.split() for line in Path("room/images.txt").read_text(encoding="utf-8").splitlines()[::2]]
    assert len(heads) >= 1
    for head in heads:
        assert (Path("room/images") / head[9]).is_file()
    points = [line.split() for line in Path("room/points3D.txt").read_text(encoding="utf-8").splitlines()]
    assert len({tuple(point[4:7]) for point in points}) > 50


def test_dense_formats_come_from_images_in_the_map(stillroom: Callable, recorded: Path) -> None:
    options = ("--set", "storage.images=true", "--map", "room.stillmap", "--out", "results", *FEW)
    assert stillroom("run", recorded, "--frames", ":6", *options).code == 0
    said = stillroom("map", "export", "room.stillmap", "--format", "ply,trajectory")
    assert (said.code, said.errors) == (0, [])
    assert {file.name for file in Path("room").iterdir()} == {"cloud.ply", "trajectory.tum", "keyframes.tum"}


def test_the_check_names_the_damage_and_fails(stillroom: Callable, small: Path) -> None:
    import sqlite3

    database = sqlite3.connect(small)
    database.execute("UPDATE keyframes SET timestamp_s = 9e999")
    database.commit()
    database.close()
    said = stillroom("map", "check", small)
    assert said.code == 1
    assert "the time of keyframe 0 is not finite" in said.out
    [error] = said.errors
    assert "is damaged in" in error


MISUSES: dict[str, tuple[list[str], str]] = {
    "continue without a map": (["--continue"], "--continue needs a map: name its file with --map"),
    "localize without a map": (["--localize"], "--localize needs a map"),
    "both": (["--map", "SMALL", "--continue", "--localize"], "leave one of them out"),
    "a new map over an old one": (["--map", "SMALL"], "exists already; extend it with --continue"),
    "no map to go on in": (["--map", "none.stillmap", "--continue"], "none.stillmap: no such map"),
    "no map to track against": (["--map", "none.stillmap", "--localize"], "none.stillmap: no such map"),
    "a folder": (["--map", "."], "is a folder"),
    "a folder to go on in": (["--map", ".", "--continue"], "is a folder"),
    "another camera": (["--map", "SMALL", "--continue"], "was made with another camera"),
    "other pyramids": (["--map", "SMALL", "--localize", "--set", "features.n_levels=4"], "8 pyramid levels"),
}


@pytest.mark.parametrize("name", MISUSES)
def test_a_misuse_is_one_line_and_touches_nothing(name: str, stillroom: Callable, recorded: Path, small: Path) -> None:
    arguments, expected = MISUSES[name]
    before = sha256(small)
    said = stillroom("run", recorded, *(small if word == "SMALL" else word for word in arguments), *FEW)
    assert said.code == 1
    [error] = said.errors
    assert expected in error
    assert sha256(small) == before
    assert check_map(small) == []
    assert not list(Path().glob("*.stillmap*"))


@pytest.mark.parametrize("command", ["info", "check", "export"])
@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (None, "no such map"),
        (b"", "is empty"),
        (b"a shopping list", "is no map of Stillroom"),
    ],
)
def test_what_is_no_map_is_one_line(
    command: str, content: bytes | None, expected: str, stillroom: Callable, tmp_path: Path
) -> None:
    path = tmp_path / "room.stillmap"
    if content is not None:
        path.write_bytes(content)
    said = stillroom("map", command, path)
    assert (said.code, said.out) == (1, "")
    [error] = said.errors
    assert expected in error
    assert not (tmp_path / "room").exists()


def test_a_format_that_does_not_exist_is_said(stillroom: Callable, small: Path) -> None:
    said = stillroom("map", "export", small, "--format", "obj")
    assert said.code == 1
    assert "--format obj: no such format; known: trajectory, colmap, ply" in said.errors[0]
    assert not small.with_suffix("").exists()
