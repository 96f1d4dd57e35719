"""The floor plan of a room that is known, read the way ROS's map_server reads it."""

import json
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from oriented_clouds import Surfaces
from scipy.spatial.transform import Rotation

from stillroom.data.dense_cloud import DenseCloud
from stillroom.dense.export.floor import FloorConfig, find_floor
from stillroom.dense.export.occupancy import OccupancyConfig
from stillroom.errors import ConfigError, MapError
from stillroom.geometry import se3
from stillroom.geometry.arrays import F64

VOXEL_M = 0.02
R_CAMERA_ROOM = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
"""A camera that looks along x, upright: its x is the room's −y, its y the room's −z."""

FREE = {
    "the middle of the first room": (1.5, 1.0),
    "the middle of the second": (4.5, 2.5),
    "the door": (3.0, 2.0),
    "left in the door": (3.0, 1.65),
    "right in the door": (3.0, 2.35),
    "under the lamp": (4.5, 1.0),
    "on the sill, which is driven over": (5.2, 3.2),
}
OCCUPIED = {
    "the wall between, one side": (3.0, 1.0),
    "the wall between, the other": (3.0, 3.0),
    "the outer wall": (0.0, 2.0),
    "the table's middle": (1.5, 3.0),
    "the table's edge": (1.1, 3.0),
    "the crate": (5.5, 0.5),
}
UNKNOWN = {"outside": (-0.3, 2.0), "behind the outer wall": (5.5, 4.3), "beyond": (6.3, 1.0)}


def two_rooms() -> Surfaces:
    """Six metres by four, z up, a wall with a door of 0.9 m between, a table, a lamp, a crate and a low sill."""
    room = Surfaces(density_per_m2=6000.0)
    room.rectangle((0, 0, 0), (6, 0, 0), (0, 4, 0))
    room.rectangle((0, 0, 0), (0, 0, 2.5), (6, 0, 0)).rectangle((0, 4, 0), (6, 0, 0), (0, 0, 2.5))
    room.rectangle((0, 0, 0), (0, 4, 0), (0, 0, 2.5)).rectangle((6, 0, 0), (0, 0, 2.5), (0, 4, 0))
    for low, high in (((2.98, 0.0, 0.0), (3.02, 1.55, 2.5)), ((2.98, 2.45, 0.0), (3.02, 4.0, 2.5))):
        room.without((*low[:2], -1.0), high).box(low, high)  # no floor is seen inside a wall
    room.rectangle((2.98, 1.55, 2.1), (0.04, 0, 0), (0, 0.9, 0))  # the lintel
    room.rectangle((1.0, 2.6, 0.72), (1.0, 0, 0), (0, 0.8, 0))
    room.rectangle((4.2, 0.7, 2.0), (0.6, 0, 0), (0, 0.6, 0))
    room.box((5.3, 0.3, 0.0), (5.7, 0.7, 0.4))
    return room.rectangle((5.0, 3.0, 0.06), (0.4, 0, 0), (0, 0.4, 0))


def standing(tilt_deg: float, seed: int) -> F64:
    """`T_world_room` of a first camera 1.2 m above the floor, turned about z at will, and then tilted by an angle."""
    random = np.random.default_rng(seed)
    axis = random.normal(size=2)
    tilt = Rotation.from_rotvec(np.radians(tilt_deg) * np.array([axis[0], 0, axis[1]]) / np.linalg.norm(axis))
    R = tilt.as_matrix() @ R_CAMERA_ROOM @ Rotation.from_euler("z", random.uniform(0, 2 * np.pi)).as_matrix()
    return se3.from_rotation_translation(R, -R @ np.array([1.5, 1.2, 1.2]))


@dataclass
class Reader:
    """A floor plan as map_server takes it from its two files: wiki.ros.org/map_server, "Value interpretation"."""

    folder: Path

    def __post_init__(self) -> None:
        self.values = yaml.safe_load((self.folder / "map.yaml").read_text(encoding="utf-8"))
        self.picture = cv2.imread(str(self.folder / self.values["image"]), cv2.IMREAD_UNCHANGED)
        self.T_map_world = np.array(json.loads((self.folder / "map_frame.json").read_text())["T_map_world"])

    def at(self, x_m: float, y_m: float) -> str:
        left_m, bottom_m, yaw_rad = self.values["origin"]
        assert yaw_rad == 0.0
        column = int((x_m - left_m) // self.values["resolution"])
        row = int((y_m - bottom_m) // self.values["resolution"])
        if not (0 <= row < self.picture.shape[0] and 0 <= column < self.picture.shape[1]):
            return "unknown"
        color = int(self.picture[::-1][row, column])
        p = color / 255 if self.values["negate"] else (255 - color) / 255
        if p > self.values["occupied_thresh"]:
            return "occupied"
        return "free" if p < self.values["free_thresh"] else "unknown"


@dataclass
class Drawn:
    """A plan of the two rooms, and where they are in it."""

    read: Reader
    T_map_room: F64

    def at(self, x_m: float, y_m: float) -> str:
        place_m = se3.transform(self.T_map_room, np.array([[x_m, y_m, 0.0]]))[0]
        return self.read.at(place_m[0], place_m[1])


@cache
def seen(tilt_deg: float, seed: int, voxel_m: float = VOXEL_M) -> tuple[DenseCloud, F64]:
    """The two rooms from a first camera that stands so; also `T_world_room`."""
    T_world_room = standing(tilt_deg, seed)
    return two_rooms().cloud(voxel_m, T_world_room, noise_m=0.003), T_world_room


def drawn(view: tuple[DenseCloud, F64], folder: Path, config: OccupancyConfig | None = None) -> Drawn:
    cloud, T_world_room = view
    (config or OccupancyConfig()).build()(cloud).write(folder)
    read = Reader(folder)
    return Drawn(read, read.T_map_world @ T_world_room)


@pytest.fixture(scope="module", params=[(0.0, 0), (20.0, 1), (35.0, 2), (50.0, 3)], ids=lambda p: f"{p[0]:.0f}°")
def plan(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Drawn:
    return drawn(seen(*request.param), tmp_path_factory.mktemp("plan"))


def test_the_map_frame_stands_on_the_floor(plan: Drawn) -> None:
    up, height_m = plan.T_map_room[2, :3], plan.T_map_room[2, 3]
    assert np.degrees(np.arccos(min(1.0, up[2]))) < 0.1
    assert abs(height_m) < 0.005
    assert np.linalg.det(plan.T_map_room[:3, :3]) == pytest.approx(1.0)
    # The first camera is above its origin, and looked along x.
    camera_m = plan.read.T_map_world[:3, 3]
    np.testing.assert_allclose(camera_m, [0, 0, 1.2], atol=0.01)
    forward = plan.read.T_map_world[:3, 2]
    assert forward[0] > 0
    assert abs(forward[1]) < 1e-6


@pytest.mark.parametrize(("places", "answer"), [(FREE, "free"), (OCCUPIED, "occupied"), (UNKNOWN, "unknown")])
def test_known_places(plan: Drawn, places: dict[str, tuple[float, float]], answer: str) -> None:
    assert {name: plan.at(*place) for name, place in places.items()} == dict.fromkeys(places, answer)


def test_the_door_stays_open_as_wide_as_it_is(plan: Drawn) -> None:
    across = [plan.at(3.0, y_m) for y_m in np.arange(1.3, 2.7, 0.01)]
    assert 0.01 * across.count("free") == pytest.approx(0.9, abs=2 * 0.05)
    assert across[0] == across[-1] == "occupied"


def test_most_of_the_floor_is_free_and_the_walls_have_no_holes(plan: Drawn) -> None:
    random = np.random.default_rng(0)
    inside = random.uniform([0.1, 0.1], [2.85, 2.5], (2000, 2))
    assert np.mean([plan.at(*place) == "free" for place in inside]) > 0.995
    along = np.arange(0.05, 4.0, 0.01)
    for x_m in (0.0, 6.0):
        reached = [any(plan.at(x_m + off_m, y_m) == "occupied" for off_m in (-0.03, 0, 0.03)) for y_m in along]
        assert np.mean(reached) > 0.99


def test_the_files_are_what_a_map_server_reads(plan: Drawn) -> None:
    values, picture = plan.read.values, plan.read.picture
    assert list(values) == ["image", "mode", "resolution", "origin", "negate", "occupied_thresh", "free_thresh"]
    assert (values["image"], values["mode"], values["negate"]) == ("map.pgm", "trinary", 0)
    assert (values["resolution"], values["occupied_thresh"], values["free_thresh"]) == (0.05, 0.65, 0.196)
    assert (plan.read.folder / "map.pgm").read_bytes().startswith(b"P5\n")
    assert picture.dtype == np.uint8
    assert set(np.unique(picture)) == {0, 205, 254}
    # A margin of unknown all around.
    for edge in (picture[0], picture[-1], picture[:, 0], picture[:, -1]):
        assert (edge == 205).all()
    comment = (plan.read.folder / "map.yaml").read_text().splitlines()
    rows = [json.loads(line.removeprefix("#")) for line in comment if line.startswith("#   [")]
    np.testing.assert_allclose(rows, plan.read.T_map_world, atol=1e-8)


def test_the_band_of_obstacles_can_be_chosen(tmp_path: Path) -> None:
    config = OccupancyConfig(obstacle_from_m=0.04, obstacle_to_m=2.2, resolution_m=0.1)
    plan = drawn(seen(20.0, 1), tmp_path, config)
    assert plan.read.values["resolution"] == 0.1
    assert plan.at(*FREE["under the lamp"]) == "occupied"
    assert plan.at(*FREE["on the sill, which is driven over"]) == "occupied"
    assert plan.at(*FREE["the middle of the first room"]) == "free"
    low = drawn(seen(20.0, 1), tmp_path, OccupancyConfig(obstacle_to_m=0.6))
    assert low.at(*OCCUPIED["the table's middle"]) == "free"


def test_cells_are_never_finer_than_the_voxels_can_fill(tmp_path: Path) -> None:
    plan = drawn(seen(0.0, 0, voxel_m=0.1), tmp_path, OccupancyConfig(resolution_m=0.01))
    assert plan.read.values["resolution"] == pytest.approx(0.15)
    assert plan.at(*FREE["the middle of the first room"]) == "free"


def test_walls_larger_than_the_floor_and_a_ceiling_are_not_taken_for_it() -> None:
    """A corridor seen with a camera that is held askew: each wall has four times the floor's area."""
    hall = Surfaces(density_per_m2=6000.0)
    hall.rectangle((0, 0, 0), (0, 0, 4), (8, 0, 0)).rectangle((0, 1, 0), (8, 0, 0), (0, 0, 4))
    hall.rectangle((0, 0, 0), (8, 0, 0), (0, 1, 0)).rectangle((0, 0, 4), (0, 1, 0), (8, 0, 0))
    T_world_room = standing(25.0, 11)
    floor = find_floor(hall.cloud(VOXEL_M, T_world_room), FloorConfig())
    T_map_room = floor.T_map_world @ T_world_room
    assert T_map_room[2, 2] > 0.9999
    assert abs(T_map_room[2, 3]) < 0.01
    assert floor.area_m2 == pytest.approx(8.0, rel=0.15)
    assert floor.tilt_deg == pytest.approx(25.0, abs=0.2)
    assert floor.above > 0.999


@pytest.mark.parametrize(
    ("table_m2", "floor_m2", "wall_m2"),
    [(3.0, 1.25, 0.0), (6.0, 1.0, 0.0), (3.0, 0.7, 15.0)],
    ids=["a desk", "much of the map lies below the table", "little does, but it is a fair part of the table"],
)
def test_a_table_larger_than_the_floor_seen_is_not_the_floor(table_m2: float, floor_m2: float, wall_m2: float) -> None:
    desk = Surfaces(density_per_m2=8000.0).rectangle((0, 0, 0.7), (table_m2 / 1.5, 0, 0), (0, 1.5, 0))
    desk.rectangle((-0.5, -0.5, 0), (0.5, 0, 0), (0, floor_m2 / 0.5, 0)).box((0.5, 0.5, 0.7), (0.9, 0.8, 1.1))
    if wall_m2:
        desk.rectangle((0, 1.5, 0.7), (wall_m2 / 2.5, 0, 0), (0, 0, 2.5))
    T_world_room = standing(30.0, 7)
    floor = find_floor(desk.cloud(VOXEL_M, T_world_room), FloorConfig())
    assert abs((floor.T_map_world @ T_world_room)[2, 3]) < 0.01


def test_the_foot_of_something_is_no_floor(tmp_path: Path) -> None:
    """The side of a plinth, too low for an obstacle, beside floor that was not seen."""
    plinth = Surfaces(density_per_m2=8000.0).rectangle((0, 0, 0), (2, 0, 0), (0, 2, 0))
    plinth.rectangle((3, 0.5, 0), (0, 0, 0.08), (0, 1, 0))
    T_world_room = standing(0.0, 3)
    plan = drawn((plinth.cloud(VOXEL_M, T_world_room), T_world_room), tmp_path)
    assert plan.at(1.0, 1.0) == "free"
    assert {plan.at(3.0 + off_m, 1.0) for off_m in (-0.05, 0.0, 0.05)} == {"unknown"}


def test_the_answer_does_not_hang_on_the_seed_and_repeats() -> None:
    cloud, _ = seen(35.0, 2)
    found = [find_floor(cloud, FloorConfig(seed=seed)).T_map_world for seed in (0, 0, 1, 2)]
    np.testing.assert_array_equal(found[0], found[1])
    for other in found[2:]:
        np.testing.assert_allclose(other, found[0], atol=2e-3)


def only_walls() -> Surfaces:
    walls = Surfaces(density_per_m2=6000.0)
    return walls.rectangle((0, 0, 0), (0, 0, 2.5), (6, 0, 0)).rectangle((0, 0, 0), (0, 4, 0), (0, 0, 2.5))


def speck() -> Surfaces:
    return Surfaces().rectangle((0, 0, 0), (0.1, 0, 0), (0, 0.1, 0))


def only_a_ceiling() -> Surfaces:
    return Surfaces(density_per_m2=6000.0).rectangle((0, 0, 2), (0, 4, 0), (6, 0, 0))


@pytest.mark.parametrize("scene", [only_walls, speck, only_a_ceiling])
def test_where_there_is_no_floor_one_line_says_so(scene: object) -> None:
    assert callable(scene)
    cloud = scene().cloud(VOXEL_M, standing(0.0, 0))
    with pytest.raises(MapError) as raised:
        OccupancyConfig().build()(cloud)
    assert "no floor found" in str(raised.value)
    assert "\n" not in str(raised.value)


def test_a_cloud_without_a_point_has_no_floor(tmp_path: Path) -> None:
    empty = DenseCloud(
        *(np.empty((0, 3), t) for t in (np.float32, np.float32, np.uint8)), np.empty(0, np.float32), 0.02
    )
    with pytest.raises(MapError, match="no floor found"):
        OccupancyConfig().build()(empty)


def test_a_plan_that_would_be_too_large_is_refused() -> None:
    cloud, _ = seen(0.0, 0)
    far_m = cloud.positions_m.copy()
    far_m[0] = [4e5, 0.7, 4e5]
    with pytest.raises(MapError, match=r"the floor plan would have .* set a larger occupancy\.resolution_m"):
        OccupancyConfig(obstacle_to_m=1e6).build()(replace(cloud, positions_m=far_m))


@pytest.mark.parametrize(
    ("config", "words"),
    [
        (OccupancyConfig(resolution_m=0.0), "occupancy.resolution_m"),
        (
            OccupancyConfig(obstacle_from_m=2.0),
            "occupancy.obstacle_to_m' is 1.8; it must be above 'occupancy.obstacle_from_m', 2",
        ),
        (OccupancyConfig(obstacle_from_m=0.0), "occupancy.obstacle_from_m"),
    ],
)
def test_values_that_cannot_be_are_refused(config: OccupancyConfig, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        config.build()
