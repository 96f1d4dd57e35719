"""The rooms: which furniture stands where."""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from stillroom.geometry.arrays import F64, U8
from stillroom_scenes.scene import furniture, pictures, surfaces
from stillroom_scenes.scene.atlas import AtlasBuilder
from stillroom_scenes.scene.builder import Footprint, SceneBuilder, placed
from stillroom_scenes.scene.patches import Patches

HALF_X_M, HALF_Y_M, HEIGHT_M = 3.0, 2.6, 2.7
FLOOR_PX = 1024


@dataclass(frozen=True)
class StillRoom:
    """The room without anyone in it.

    Attributes:
        patches: Its surfaces, instance 0.
        footprints: Where furniture stands.
    """

    patches: Patches
    footprints: tuple[Footprint, ...]


@dataclass(frozen=True)
class Walls:
    """`T_world_wall` (4, 4) of each wall: origin at the middle of its foot, x right as seen from inside, −y inwards."""

    north: F64
    east: F64
    south: F64
    west: F64


WALLS = Walls(
    placed(0, HALF_Y_M),
    placed(HALF_X_M, 0, 0, -np.pi / 2),
    placed(0, -HALF_Y_M, 0, np.pi),
    placed(-HALF_X_M, 0, 0, np.pi / 2),
)


def build_room(name: str, seed: int, tables: tuple[tuple[float, float], ...], atlas: AtlasBuilder) -> StillRoom:
    """Build a room; its textures go into the atlas.

    Args:
        name: One of `ROOMS`.
        seed: Chooses colours, pictures and small things; the furniture's places stay.
        tables: Where small tables stand in the middle, centres on the floor [m].
        atlas: Takes the textures.
    """
    rng = np.random.default_rng([seed, sorted(ROOMS).index(name), 11])
    builder = SceneBuilder(atlas)
    ROOMS[name](builder, rng)
    for x, y in tables:
        furniture.small_table(builder, rng, placed(x, y))
    _shell(builder, rng)
    return StillRoom(builder.build(), tuple(builder.footprints))


def _shell(builder: SceneBuilder, rng: np.random.Generator) -> None:
    tones: tuple[surfaces.Rgb, ...] = ((222, 218, 206), (206, 214, 216), (224, 208, 188), (208, 216, 202))
    for wall, half_m in (
        (WALLS.north, HALF_X_M),
        (WALLS.east, HALF_Y_M),
        (WALLS.south, HALF_X_M),
        (WALLS.west, HALF_Y_M),
    ):
        colour = tones[int(rng.integers(len(tones)))]
        picture = surfaces.darken_borders(surfaces.plaster(rng, 1024, 512, colour), 45, 0.22)
        texture = builder.texture(picture)
        builder.face(wall, (-half_m, 0, 0), (2 * half_m, 0, 0), (0, 0, HEIGHT_M), texture)
    floor = surfaces.carpet(rng, FLOOR_PX, ((112, 118, 128), (128, 112, 98), (104, 116, 108))[int(rng.integers(3))], 10)
    floor = _with_shadows(surfaces.darken_borders(floor, 60, 0.3), builder.footprints)
    lower_left, x_axis, y_axis = (-HALF_X_M, -HALF_Y_M, 0), (2 * HALF_X_M, 0, 0), (0, 2 * HALF_Y_M, 0)
    builder.face(np.eye(4), lower_left, x_axis, y_axis, builder.texture(floor))
    above = builder.texture(surfaces.darken_borders(surfaces.ceiling(rng, 768, 10), 40, 0.2))
    builder.face(np.eye(4), (-HALF_X_M, HALF_Y_M, HEIGHT_M), x_axis, (0, -2 * HALF_Y_M, 0), above)


def _with_shadows(floor: U8, footprints: list[Footprint]) -> U8:
    """Darken the floor softly under and around what stands on it."""
    shade = np.zeros((FLOOR_PX, FLOOR_PX), dtype=np.float32)
    for place in footprints:
        columns = (np.array([place.x_min_m, place.x_max_m]) + HALF_X_M) / (2 * HALF_X_M) * FLOOR_PX
        rows = (HALF_Y_M - np.array([place.y_max_m, place.y_min_m])) / (2 * HALF_Y_M) * FLOOR_PX
        low = int(columns[0]) - 8, int(rows[0]) - 8
        cv2.rectangle(shade, low, (int(columns[1]) + 8, int(rows[1]) + 8), 1.0, -1)
    shade = np.asarray(cv2.GaussianBlur(shade, (0, 0), 16), dtype=np.float32)
    return (floor * (1.0 - 0.5 * shade[..., None])).astype(np.uint8)


def _gallery(
    builder: SceneBuilder, rng: np.random.Generator, wall: F64, places: tuple[tuple[float, float, float, float], ...]
) -> None:
    """Hang posters at places (x, z, width, height) [m]."""
    for x, z, width, height in places:
        art = pictures.poster(rng, int(380 * width), int(380 * height))
        furniture.hang(builder, wall, x, z, (width, height), art)


def _office(builder: SceneBuilder, rng: np.random.Generator) -> None:
    north, east, south, west = WALLS.north, WALLS.east, WALLS.south, WALLS.west
    furniture.desk(builder, rng, north, -1.75, 1.5)
    furniture.desk(builder, rng, north, -0.1, 1.5)
    furniture.shelf(builder, rng, north, 1.6, 1.2, 0.8)
    furniture.cabinet(builder, rng, north, -2.75, 0.85, 0.8)
    _gallery(builder, rng, north, ((-2.6, 1.75, 0.55, 0.65), (-1.85, 1.3, 0.55, 0.75), (-1.2, 1.4, 0.6, 0.8)))
    _gallery(builder, rng, north, ((0.75, 1.3, 0.6, 0.8), (-1.15, 2.28, 0.5, 0.32), (0.2, 2.28, 0.7, 0.32)))
    _gallery(builder, rng, north, ((1.6, 1.5, 0.55, 0.7), (2.3, 1.35, 0.55, 0.75), (1.75, 2.28, 0.6, 0.32)))
    furniture.hang(builder, north, -0.45, 1.3, (1.1, 0.85), pictures.scribbles(rng))
    furniture.cabinet(builder, rng, east, -2.0, 1.4, 0.9)
    furniture.shelf(builder, rng, east, -0.4, 1.1, 1.9)
    furniture.cabinet(builder, rng, east, 0.9, 1.1, 1.2)
    _gallery(builder, rng, east, ((-1.9, 1.4, 0.6, 0.8), (-1.1, 1.35, 0.5, 0.7), (0.95, 1.7, 0.8, 0.6)))
    furniture.shelf(builder, rng, west, -2.0, 1.2, 1.8)
    furniture.hang(builder, west, -0.55, 0.95, (1.3, 1.3), pictures.window(rng))
    furniture.cabinet(builder, rng, west, -0.6, 1.4, 0.75)
    furniture.shelf(builder, rng, west, 1.0, 0.9, 2.0)
    furniture.desk(builder, rng, south, -1.4, 1.6)
    furniture.shelf(builder, rng, south, 0.9, 1.2, 1.9)
    furniture.tower(builder, rng, south, -2.2, 0.0, 0.45, 3)
    furniture.hang(builder, south, -1.3, 1.25, (1.4, 0.95), pictures.notes(rng))
    _gallery(builder, rng, south, ((0.2, 1.2, 0.6, 0.8), (-2.3, 1.5, 0.6, 0.8)))


def _workshop(builder: SceneBuilder, rng: np.random.Generator) -> None:
    north, east, south, west = WALLS.north, WALLS.east, WALLS.south, WALLS.west
    furniture.bench(builder, rng, north, -1.6, 1.6)
    furniture.bench(builder, rng, north, 0.2, 1.5)
    furniture.cabinet(builder, rng, north, 1.9, 0.9, 1.6)
    furniture.shelf(builder, rng, north, -2.7, 0.9, 1.7)
    _gallery(
        builder,
        rng,
        north,
        ((-1.5, 1.9, 0.7, 0.6), (-0.6, 1.9, 0.55, 0.6), (0.4, 1.9, 0.5, 0.65), (1.1, 1.9, 0.6, 0.6)),
    )
    furniture.bench(builder, rng, east, -1.8, 1.8)
    furniture.cabinet(builder, rng, east, 0.3, 1.5, 1.2)
    _gallery(builder, rng, east, ((0.5, 1.6, 0.6, 0.8), (-1.7, 1.9, 0.8, 0.6), (1.3, 1.6, 0.6, 0.8)))
    furniture.hang(builder, west, -1.7, 0.95, (1.2, 1.3), pictures.window(rng))
    furniture.hang(builder, west, 0.4, 0.95, (1.2, 1.3), pictures.window(rng))
    furniture.cabinet(builder, rng, west, -1.8, 1.4, 0.8)
    furniture.bench(builder, rng, west, 0.3, 1.2)
    furniture.cabinet(builder, rng, south, -1.9, 1.8, 1.0)
    furniture.shelf(builder, rng, south, 0.2, 1.3, 1.8)
    furniture.hang(builder, south, -1.9, 1.5, (1.4, 0.95), pictures.scribbles(rng))
    _gallery(builder, rng, south, ((1.7, 1.2, 0.6, 0.8),))


def _library(builder: SceneBuilder, rng: np.random.Generator) -> None:
    north, east, south, west = WALLS.north, WALLS.east, WALLS.south, WALLS.west
    for x, width, height in ((-2.7, 1.0, 2.0), (-1.6, 1.2, 0.85), (1.5, 1.3, 0.85)):
        furniture.shelf(builder, rng, north, x, width, height)
    furniture.desk(builder, rng, north, -0.3, 1.7)
    furniture.hang(builder, north, -0.25, 1.35, (1.0, 0.8), pictures.notes(rng))
    _gallery(builder, rng, north, ((-1.5, 1.3, 0.6, 0.8), (-0.8, 1.45, 0.45, 0.6), (0.9, 1.3, 0.6, 0.8)))
    _gallery(builder, rng, north, ((-0.1, 2.25, 0.7, 0.35), (-1.3, 2.2, 0.6, 0.4), (0.9, 2.22, 0.6, 0.4)))
    _gallery(builder, rng, north, ((1.6, 1.55, 0.55, 0.7), (2.3, 1.4, 0.55, 0.75)))
    for wall in (east, west):
        furniture.shelf(builder, rng, wall, -2.0, 1.2, 2.0)
        furniture.desk(builder, rng, wall, -0.7, 1.4)
        furniture.shelf(builder, rng, wall, 0.85, 1.1, 1.7)
        _gallery(builder, rng, wall, ((-0.6, 1.35, 0.6, 0.8), (0.1, 1.4, 0.55, 0.7), (1.1, 2.0, 0.8, 0.5)))
    furniture.cabinet(builder, rng, south, -2.0, 1.8, 0.9)
    furniture.hang(builder, south, -1.9, 1.3, (1.4, 0.95), pictures.scribbles(rng))
    furniture.shelf(builder, rng, south, 0.2, 1.6, 2.0)
    _gallery(builder, rng, south, ((1.95, 1.2, 0.6, 0.8), (-0.35, 1.3, 0.45, 0.6)))


ROOMS: dict[str, Callable[[SceneBuilder, np.random.Generator], None]] = {
    "office": _office,
    "workshop": _workshop,
    "library": _library,
}
