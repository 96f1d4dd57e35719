"""Walls with openings, floors, ceilings and the passages between cells, each built around its own origin.

A cell is built in a local frame with the origin in the middle of its floor and is then moved to its place. So every
cell has the lamps of `builder.LAMPS_WORLD_M` above its middle.
"""

from dataclasses import dataclass

import numpy as np

from stillroom.geometry import se3
from stillroom.geometry.arrays import F64
from stillroom_scenes.scene import surfaces
from stillroom_scenes.scene.builder import SceneBuilder, placed
from stillroom_scenes.scene.layout import HEIGHT_M
from stillroom_scenes.worlds.plan import Cell

TEXELS_PER_M = 170
FLOOR_TEXELS_PER_M = 130
DOOR_WIDTH_M, DOOR_HEIGHT_M = 1.0, 2.05
WALL_M = 0.2  # between two cells
SIDES = ("north", "east", "south", "west")


@dataclass(frozen=True)
class Doorway:
    """A hole in a wall, from x on along it (the wall's frame, see `wall_frame`)."""

    x_m: float
    width_m: float = DOOR_WIDTH_M
    height_m: float = DOOR_HEIGHT_M


@dataclass(frozen=True)
class Shell:
    """A rectangular cell around the local origin.

    Attributes:
        half_x_m, half_y_m: Half its size.
        doorways: The holes in its walls, (side, hole) each.
        open_sides: Sides without a wall.
    """

    half_x_m: float
    half_y_m: float
    doorways: tuple[tuple[str, Doorway], ...] = ()
    open_sides: tuple[str, ...] = ()

    def wall_frame(self, side: str) -> F64:
        """Return `T_local_wall` (4, 4): origin at the middle of its foot, x right as seen from inside, −y inwards."""
        away = {"north": self.half_y_m, "east": self.half_x_m, "south": self.half_y_m, "west": self.half_x_m}[side]
        x, y, yaw = {
            "north": (0.0, away, 0.0),
            "east": (away, 0.0, -np.pi / 2),
            "south": (0.0, -away, np.pi),
            "west": (-away, 0.0, np.pi / 2),
        }[side]
        return placed(x, y, 0.0, yaw)

    def half_m(self, side: str) -> float:
        """Return half the length of a wall."""
        return self.half_x_m if side in ("north", "south") else self.half_y_m

    def cell(self, name: str, T_world_local: F64) -> Cell:
        """Return the cell on the floor plan."""
        corners = np.array([[-self.half_x_m, -self.half_y_m, 0.0], [self.half_x_m, self.half_y_m, 0.0]])
        moved = se3.transform(T_world_local, corners)[:, :2]
        low, high = moved.min(axis=0).tolist(), moved.max(axis=0).tolist()
        return Cell(name, (low[0], low[1]), (high[0], high[1]))


@dataclass(frozen=True)
class Finish:
    """The textures of a shell's large surfaces; −1 where there is no wall."""

    walls: tuple[int, int, int, int]
    floor: int
    ceiling: int


def plain_finish(
    builder: SceneBuilder, rng: np.random.Generator, shell: Shell, wall: surfaces.Rgb, floor: int, ceiling: int
) -> Finish:
    """Draw plaster for each wall; floor and ceiling have textures of `floor_and_ceiling`."""
    walls = []
    for side in SIDES:
        if side in shell.open_sides:
            walls.append(-1)
            continue
        width_px = int(2 * shell.half_m(side) * TEXELS_PER_M)
        picture = surfaces.plaster(rng, width_px, int(HEIGHT_M * TEXELS_PER_M), wall)
        walls.append(builder.texture(surfaces.darken_borders(picture, 45, 0.22)))
    return Finish((walls[0], walls[1], walls[2], walls[3]), floor, ceiling)


def floor_and_ceiling(
    builder: SceneBuilder, rng: np.random.Generator, size_m: float, floor: surfaces.Rgb
) -> tuple[int, int]:
    """Draw a square of carpet and one of ceiling tiles, which cells as long as that share."""
    size_px, tiles = int(size_m * FLOOR_TEXELS_PER_M), max(2, round(size_m / 0.6))
    carpet = builder.texture(surfaces.carpet(rng, size_px, floor, tiles))
    return carpet, builder.texture(surfaces.ceiling(rng, size_px, tiles))


def add_shell(builder: SceneBuilder, shell: Shell, finish: Finish, height_m: float = HEIGHT_M) -> None:
    """Add walls, floor and ceiling; a cell that is not square shows the middle of its floor's texture."""
    for side, texture in zip(SIDES, finish.walls, strict=True):
        if side not in shell.open_sides:
            holes = [hole for where, hole in shell.doorways if where == side]
            _add_wall(builder, shell.wall_frame(side), shell.half_m(side), texture, holes, height_m)
    x, y = shell.half_x_m, shell.half_y_m
    wide, high = 0.5 * x / max(x, y), 0.5 * y / max(x, y)
    window = (0.5 - wide, 0.5 - high, 0.5 + wide, 0.5 + high)
    builder.face(np.eye(4), (-x, -y, 0), (2 * x, 0, 0), (0, 2 * y, 0), finish.floor, window)
    builder.face(np.eye(4), (-x, y, height_m), (2 * x, 0, 0), (0, -2 * y, 0), finish.ceiling, window)


def _add_wall(
    builder: SceneBuilder, wall: F64, half_m: float, texture: int, holes: list[Doorway], height_m: float
) -> None:
    """Add the parts of a wall beside and above its holes; together they show the texture as one."""

    def part(left_m: float, right_m: float, low_m: float) -> None:
        if right_m - left_m > 1e-9:
            window = (0.5 + 0.5 * left_m / half_m, 0.0, 0.5 + 0.5 * right_m / half_m, 1.0 - low_m / height_m)
            size = (right_m - left_m, 0, 0), (0, 0, height_m - low_m)
            builder.face(wall, (left_m, 0, low_m), *size, texture, window)

    at_m = -half_m
    for hole in sorted(holes, key=lambda hole: hole.x_m):
        part(at_m, hole.x_m, 0.0)
        part(hole.x_m, hole.x_m + hole.width_m, hole.height_m)
        at_m = hole.x_m + hole.width_m
    part(at_m, half_m, 0.0)


PASSAGE = Shell(DOOR_WIDTH_M / 2, WALL_M / 2, open_sides=("north", "south"))


def add_passage(builder: SceneBuilder, frame: int, sill: int) -> None:
    """Add what lies in the thickness of a wall at a doorway: two jambs, a sill, and the underside of the lintel."""
    add_shell(builder, PASSAGE, Finish((frame, frame, frame, frame), sill, frame), DOOR_HEIGHT_M)
