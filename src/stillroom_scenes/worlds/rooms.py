"""A building: rooms on both sides of a corridor, and a way through all of them and back."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from stillroom.geometry import se3
from stillroom.geometry.arrays import F64
from stillroom_scenes.camera_path import WALK
from stillroom_scenes.render import World
from stillroom_scenes.scene import furniture, pictures, surfaces
from stillroom_scenes.scene.builder import SceneBuilder, placed
from stillroom_scenes.scene.people.script import Script
from stillroom_scenes.worlds import decor
from stillroom_scenes.worlds.assembly import Assembly
from stillroom_scenes.worlds.building import BuildingScene
from stillroom_scenes.worlds.look_alikes import (
    DOOR_X_M,
    ROOM,
    TURN_CENTRE_M,
    Model,
    build_model,
)
from stillroom_scenes.worlds.shell import (
    DOOR_WIDTH_M,
    PASSAGE,
    WALL_M,
    Doorway,
    Finish,
    Shell,
    add_passage,
    add_shell,
    floor_and_ceiling,
    plain_finish,
)
from stillroom_scenes.worlds.walk import Walk

MOST_ROOMS = 40
ROOM_FLOOR: surfaces.Rgb = (112, 118, 128)
BAY_M = 2 * ROOM.half_x_m + WALL_M
HALF_WIDTH_M = 1.5
PACE_M_S = 1.55
TURN_RADIUS_M = 0.95
START_X_M = -0.4  # on the way back, which leads straight to the first room again
LANE_M = 0.35  # the camera keeps so far to the right of the corridor's middle


@dataclass(frozen=True)
class Place:
    """A room on the plan: its bay of the corridor, and `T_world_room` (4, 4)."""

    bay: int
    T_world_room: F64

    @property
    def is_north(self) -> bool:
        """Whether it lies on the left of someone who comes from the entrance."""
        return bool(self.T_world_room[1, 3] > 0)


def places(rooms: int) -> list[Place]:
    """Return where the rooms are: left and right by turns; those on the right are turned, so that all doors agree."""
    away_m = HALF_WIDTH_M + WALL_M + ROOM.half_y_m
    turned = ((away_m, 0.0), (-away_m, np.pi))
    return [Place(k // 2, placed(k // 2 * BAY_M, turned[k % 2][0], 0.0, turned[k % 2][1])) for k in range(rooms)]


def building(rooms: int, alike: bool, figures: str, seed: int) -> World:
    """Return a building; the camera goes through all rooms in order, back to the entrance, and begins again.

    Args:
        rooms: How many.
        alike: Whether rooms have nine tenths of their looks in common; else only their layout.
        figures: "walking" (one in each room) or "none".
        seed: Chooses textures, things, clothes and speeds.
    """
    return World(_scene(rooms, alike, figures, seed), Walk(_tour(places(rooms)), PACE_M_S, WALK, seed))


@lru_cache(maxsize=1)
def _scene(rooms: int, alike: bool, figures: str, seed: int) -> BuildingScene:
    """Build the building, or take it from a moment ago: it is never changed."""
    assembly, rows = Assembly(), places(rooms)
    bays = _add_corridor(assembly, rows, seed)
    _add_rooms(assembly, rows, bays, alike, seed)
    return assembly.build(_pacers(rows, seed) if figures == "walking" else (), seed)


def _add_corridor(assembly: Assembly, rows: list[Place], seed: int) -> list[int]:
    """Add the corridor, bay by bay; bays share plaster and carpet, pictures and signs are their own."""
    count = rows[-1].bay + 1
    rng = np.random.default_rng([seed, 83])
    finish: Finish | None = None
    bays = []
    for bay in range(count):
        doorways = []
        for place in (place for place in rows if place.bay == bay):
            side, at_m = ("north", DOOR_X_M) if place.is_north else ("south", DOOR_X_M)
            doorways.append((side, Doorway(at_m - DOOR_WIDTH_M / 2)))
        ends = (("west",) if bay > 0 else ()) + (("east",) if bay < count - 1 else ())
        shell = Shell(0.5 * BAY_M, HALF_WIDTH_M, tuple(doorways), ends)
        builder = SceneBuilder(assembly.atlas)
        if finish is None:
            closed = Shell(shell.half_x_m, shell.half_y_m)
            covers = floor_and_ceiling(builder, rng, BAY_M, (104, 116, 108))
            finish = plain_finish(builder, rng, closed, (206, 214, 216), *covers)
        add_shell(builder, shell, finish)
        _decorate(builder, np.random.default_rng([seed, 89, bay]), shell, bay)
        bays.append(assembly.add(f"bay {bay}", shell, builder.build(), placed(bay * BAY_M, 0.0)))
        if bay:
            assembly.join(bays[-2], bays[-1])
    return bays


def _decorate(builder: SceneBuilder, rng: np.random.Generator, shell: Shell, bay: int) -> None:
    """Hang pictures and signs in a bay of the corridor; on the walls that end it, a notice board."""
    for side in ("north", "south"):
        wall = shell.wall_frame(side)
        door_end_m = DOOR_X_M + DOOR_WIDTH_M / 2
        furniture.hang(builder, wall, door_end_m + 0.12, 1.4, (0.24, 0.24), decor.sign(rng, f"{bay}{side[0].upper()}"))
        for x_m in (-2.4, -0.05, 0.75, 1.6):
            size_m = 0.6 if x_m > -2 else 0.5, float(rng.uniform(0.6, 0.85))
            furniture.hang(builder, wall, x_m, float(rng.uniform(1.0, 1.35)), size_m, decor.poster(size_m)(rng))
    for side in ("east", "west"):
        if side not in shell.open_sides:
            furniture.hang(builder, shell.wall_frame(side), -0.7, 1.0, (1.4, 1.0), pictures.notes(rng))


def _add_rooms(assembly: Assembly, rows: list[Place], bays: list[int], alike: bool, seed: int) -> None:
    rng = np.random.default_rng([seed, 97])
    builder = SceneBuilder(assembly.atlas)
    frame = builder.texture(surfaces.darken_borders(surfaces.wood(rng, 64, 256, (176, 150, 120), 2), 4, 0.3))
    sill = builder.texture(surfaces.metal(rng, 170, 64, (120, 116, 110)))
    add_passage(builder, frame, sill)
    passage = builder.build()
    covers = floor_and_ceiling(builder, rng, 2 * ROOM.half_x_m, ROOM_FLOOR)
    model: Model | None = None
    for k, place in enumerate(rows):
        own = np.random.default_rng([seed, 101, k])
        if model is None or not alike:
            model = build_model(own, assembly.atlas, covers)
        patches = model.copy(own, assembly.atlas) if alike else model.patches
        room = assembly.add(f"room {k}", ROOM, patches, place.T_world_room)
        T_room_passage = placed(DOOR_X_M, -ROOM.half_y_m - WALL_M / 2)
        door = assembly.add(f"door {k}", PASSAGE, passage, place.T_world_room @ T_room_passage)
        assembly.join(bays[place.bay], door)
        assembly.join(door, room)


def _tour(rows: list[Place]) -> F64:
    """Return the corners (N, 2) of the way: along the corridor, into each room, round its middle, out, and back."""
    corners = [np.array([[START_X_M, LANE_M]])]
    for place in rows:
        x, y = TURN_CENTRE_M
        angles = np.radians([210, 180, 150, 120, 90, 60, 30, 0, -30, -60, -90, -120])
        turn = np.stack((x + TURN_RADIUS_M * np.cos(angles), y + TURN_RADIUS_M * np.sin(angles)), axis=1)
        door_y = -ROOM.half_y_m
        outside = np.array([DOOR_X_M, door_y - WALL_M - HALF_WIDTH_M + LANE_M])
        inside = np.array([DOOR_X_M, door_y + 0.7])
        local = np.concatenate((outside[None], inside[None], turn, inside[None], outside[None]))
        flat = np.column_stack((local, np.zeros(len(local))))
        corners.append(se3.transform(place.T_world_room, flat)[:, :2])
    end_m = float(corners[-1][-1, 0])
    corners.append(np.array([[max(end_m - 0.8, START_X_M + 0.1), LANE_M]]))
    return np.concatenate(corners)


def _pacers(rows: list[Place], seed: int) -> tuple[Script, ...]:
    """Return one figure for each room that paces in the middle, where the camera goes round."""
    rng = np.random.default_rng([seed, 23, 2])
    scripts = []
    for place in rows:
        x, y = TURN_CENTRE_M
        ends = np.array([[x - 0.12, y, 0.0], [x + 0.12, y, 0.0]])
        (a_x, a_y), (b_x, b_y) = se3.transform(place.T_world_room, ends)[:, :2].tolist()
        rest_s = float(rng.uniform(0.4, 1.4))
        script = Script((a_x, a_y), 0.0).stand(rest_s, float(rng.uniform(-3, 3))).loop()
        script.walk((b_x, b_y), 0.3).stand(rest_s, float(rng.uniform(-3, 3)))
        scripts.append(script.walk((a_x, a_y), 0.3).stand(rest_s, float(rng.uniform(-3, 3))))
    return tuple(scripts)
