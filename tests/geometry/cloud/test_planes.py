"""Planes in rooms whose every depth is known: what stands, leans and is carried in them must not become plane."""

from dataclasses import dataclass

import numpy as np
import pytest

from stillroom.geometry.arrays import F32, F64, Bool
from stillroom.geometry.camera import Camera
from stillroom.geometry.cloud.backproject import back_project, ray_grid
from stillroom.geometry.cloud.planes import PlaneLimits, Planes, find_planes

CAMERA = Camera(640, 480, 540.0, 540.0, 320.0, 240.0, distortion=(0.04, -0.1, 0.0, 0.0, 0.0))
GRID = ray_grid(CAMERA, 480, 640, 4)
TILT = 0.28  # the camera looks a little down: y of the room's frame is not y of the camera's
DOWN = np.array([0.0, np.cos(TILT), np.sin(TILT)])
AHEAD = np.array([0.0, -np.sin(TILT), np.cos(TILT)])
FLOOR_M, WALL_M, SIDE_M = 1.4, 3.5, 1.6


@dataclass
class Room:
    """Depths of the grid's samples, and what each of them is."""

    depth_m: F64
    what: np.ndarray

    def add(self, name: str, depth_m: F64) -> "Room":
        nearer = depth_m < self.depth_m
        self.depth_m[nearer] = depth_m[nearer]
        self.what[nearer] = name
        return self

    def cloud(self, noise_seed: int | None) -> F32:
        """The sensor's cloud: noise grows with the square of the depth."""
        depth = np.where(np.isfinite(self.depth_m), self.depth_m, 0.0)
        if noise_seed is not None:
            depth += np.random.default_rng(noise_seed).normal(size=depth.shape) * 0.0016 * depth**2
        full = np.zeros((480, 640), dtype=np.float32)
        full[np.ix_(GRID.rows, GRID.columns)] = depth
        return back_project(full, GRID, 0.2, 6.0)

    def is_any(self, *names: str) -> Bool:
        return np.isin(self.what, names)


RAYS = np.dstack((GRID.rays, np.ones(GRID.shape))).astype(np.float64)
LEFTWARDS, DOWNWARDS, FORWARDS = RAYS[..., 0], RAYS @ DOWN, RAYS @ AHEAD


def hit(along: F64, distance_m: float) -> F64:
    """Depth at which rays reach a distance along a direction."""
    with np.errstate(divide="ignore"):
        return np.where(along > 1e-9, distance_m / along, np.inf)


def patch(depth_m: F64, x: tuple[float, float], height: tuple[float, float], ahead: tuple[float, float]) -> F64:
    """Keep a surface within limits right, above the floor, and ahead [m]."""
    depth = np.where(np.isfinite(depth_m), depth_m, 1e3)
    inside = (depth * LEFTWARDS >= x[0]) & (depth * LEFTWARDS <= x[1])
    above = FLOOR_M - depth * DOWNWARDS
    inside &= (above >= height[0]) & (above <= height[1])
    inside &= (depth * FORWARDS >= ahead[0]) & (depth * FORWARDS <= ahead[1])
    return np.where(inside, depth, np.inf)


def figure(x: float, ahead: float, radius: float = 0.17, tall: float = 1.75) -> F64:
    """A person: an upright cylinder that stands on the floor."""
    a = LEFTWARDS**2 + FORWARDS**2
    b = LEFTWARDS * x + FORWARDS * ahead
    root = b * b - a * (x * x + ahead * ahead - radius * radius)
    depth = np.where(root > 0, (b - np.sqrt(np.maximum(root, 0.0))) / a, np.inf)
    everywhere = (-10.0, 10.0)
    return patch(depth, everywhere, (0.0, tall), everywhere)


def board(x: tuple[float, float], height: tuple[float, float], ahead: float) -> F64:
    """An upright board that faces the camera."""
    return patch(hit(FORWARDS, ahead), x, height, (-10.0, 10.0))


def empty_room() -> Room:
    room = Room(np.full(GRID.shape, np.inf), np.full(GRID.shape, "nothing", dtype="<U8"))
    room.add("floor", hit(DOWNWARDS, FLOOR_M)).add("wall", hit(FORWARDS, WALL_M))
    return room.add("side", hit(LEFTWARDS, SIDE_M))


def find(room: Room, noise_seed: int | None = 0) -> Planes:
    return find_planes(room.cloud(noise_seed), GRID.ray_area, PlaneLimits())


@pytest.mark.parametrize("noise_seed", [None, 0, 1])
def test_walls_and_floor_are_planes_where_they_are(noise_seed: int | None) -> None:
    room = empty_room()
    planes = find(room, noise_seed)
    truth = {"floor": (*-DOWN, FLOOR_M), "wall": (*-AHEAD, WALL_M), "side": (-1.0, 0.0, 0.0, SIDE_M)}
    assert len(planes.coefficients) == 3
    for name, (*normal, offset_m) in truth.items():
        there = room.is_any(name)
        found, counts = np.unique(planes.plane_of[there], return_counts=True)
        # In the corners a sample may be given to either.
        assert counts.max() > 0.9 * there.sum(), name
        assert (planes.plane_of[there] >= 0).mean() > 0.99, name
        plane = planes.coefficients[found[np.argmax(counts)]]
        assert np.degrees(np.arccos(np.clip(plane[:3] @ normal, -1, 1))) < 1.0
        assert abs(plane[3] - offset_m) < 0.02


def test_areas_are_those_of_what_is_seen() -> None:
    room = Room(np.full(GRID.shape, np.inf), np.full(GRID.shape, "nothing", dtype="<U8"))
    room.add("board", board((-0.7, 0.7), (0.4, 1.5), 2.0))
    (area_m2,) = find(room, None).area_m2
    assert area_m2 == pytest.approx(1.4 * 1.1, rel=0.03)


def test_a_person_is_not_plane_and_his_feet_do_not_join_the_floor() -> None:
    room = empty_room().add("person", figure(0.1, 2.4))
    plane_of = find(room).plane_of
    person = room.is_any("person")
    assert (plane_of[person] >= 0).mean() < 0.02
    shins = person & (FLOOR_M - room.depth_m * DOWNWARDS < 0.3) & (FLOOR_M - room.depth_m * DOWNWARDS > 0.06)
    assert shins.sum() > 40
    assert (plane_of[shins] >= 0).mean() < 0.05
    assert (plane_of[~person] >= 0).mean() > 0.95


@pytest.mark.parametrize("gap_m", [0.05, 0.15, 0.4])
def test_a_person_close_to_the_wall_does_not_become_wall(gap_m: float) -> None:
    ahead = WALL_M - gap_m - 2 * 0.17
    room = empty_room().add("person", figure(-0.2, ahead))
    plane_of = find(room).plane_of
    person = room.is_any("person")
    assert (plane_of[person] >= 0).mean() < 0.05
    assert (plane_of[room.is_any("wall")] >= 0).mean() > 0.93


def test_a_wall_cut_in_two_by_a_person_is_one_plane() -> None:
    room = empty_room().add("person", figure(-0.1, 1.0, radius=0.25, tall=2.4))
    planes = find(room)
    left, right = (room.is_any("wall") & side for side in (LEFTWARDS < -0.4, LEFTWARDS > 0.2))
    main = [np.bincount(planes.plane_of[side][planes.plane_of[side] >= 0]).argmax() for side in (left, right)]
    assert main[0] == main[1]


def test_a_carried_board_and_a_flat_back_stay_with_the_clusters() -> None:
    room = empty_room()
    room.add("board", board((-0.9, -0.2), (0.6, 1.25), 2.2))  # 0.45 m²
    room.add("back", board((0.3, 0.75), (0.05, 1.7), 2.6))  # 0.74 m², but narrow
    plane_of = find(room).plane_of
    assert (plane_of[room.is_any("board", "back")] >= 0).mean() < 0.02


def test_two_flat_people_abreast_are_no_plane() -> None:
    room = empty_room()
    for x in (-0.8, 0.0, 0.8):
        room.add("person", board((x - 0.21, x + 0.21), (0.0, 1.75), 2.4))
    plane_of = find(room).plane_of
    assert (plane_of[room.is_any("person")] >= 0).mean() < 0.03


def test_flat_people_abreast_are_no_plane_where_nothing_is_seen_behind_them() -> None:
    hall = Room(np.full(GRID.shape, np.inf), np.full(GRID.shape, "nothing", dtype="<U8"))
    hall.add("floor", patch(hit(DOWNWARDS, FLOOR_M), (-9.0, 9.0), (-1.0, 1.0), (0.0, 3.0)))
    for x in (-0.8, 0.0, 0.8):
        hall.add("person", board((x - 0.21, x + 0.21), (0.05, 1.75), 2.4))
    assert (find(hall).plane_of[hall.is_any("person")] >= 0).mean() < 0.03


def test_floor_and_wall_of_which_people_leave_pieces_are_planes() -> None:
    room = empty_room()
    for x in range(-4, 5):
        room.add("person", figure(0.5 * x, 1.6, radius=0.15))  # their feet are below the image
    behind = room.is_any("floor", "wall")
    planes = find(room)
    assert (planes.plane_of[behind] >= 0).mean() > 0.97
    assert (planes.plane_of[room.is_any("person")] >= 0).mean() < 0.03
    strict = find_planes(room.cloud(0), GRID.ray_area, PlaneLimits(min_piece_m2=PlaneLimits().min_area_m2))
    assert (strict.plane_of[behind] >= 0).mean() < 0.3, "the scene is too easy: they are in one piece"


def test_a_table_top_is_a_plane() -> None:
    room = empty_room().add("top", patch(hit(DOWNWARDS, FLOOR_M - 0.72), (-1.0, 0.6), (0.0, 2.0), (1.6, 2.6)))
    plane_of = find(room).plane_of
    assert (plane_of[room.is_any("top")] >= 0).mean() > 0.93


def test_a_wall_that_the_camera_bends_is_plane_all_over() -> None:
    room = empty_room()
    bent = room.cloud(0)
    inverse = np.where(bent[..., 2] > 0, 1.0 / np.maximum(bent[..., 2], 1e-6), 0.0)
    radius2 = GRID.rays[..., 0] ** 2 + GRID.rays[..., 1] ** 2
    # 15 cm in the corners at 3.5 m: more than any tolerance of a plane.
    bent *= (inverse / (inverse + 0.025 * radius2))[..., None].astype(np.float32)
    plane_of = find_planes(bent, GRID.ray_area, PlaneLimits()).plane_of
    assert (plane_of[room.is_any("wall", "floor")] >= 0).mean() > 0.95


def test_the_same_cloud_gives_the_same_planes() -> None:
    room = empty_room().add("person", figure(0.3, 2.0))
    first, second = find(room), find(room)
    np.testing.assert_array_equal(first.plane_of, second.plane_of)
    assert first.coefficients.tobytes() == second.coefficients.tobytes()


@pytest.mark.parametrize("shape", [(1, 1), (3, 3), (5, 4), (6, 40), (120, 160)])
def test_nothing_to_see_is_no_plane(shape: tuple[int, int]) -> None:
    planes = find_planes(np.zeros((*shape, 3), dtype=np.float32), GRID.ray_area, PlaneLimits())
    assert planes.coefficients.shape == (0, 4)
    assert (planes.plane_of == -1).all()
    assert planes.plane_of.shape == shape
