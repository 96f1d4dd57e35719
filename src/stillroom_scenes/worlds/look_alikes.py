"""Rooms that look alike: the same layout, furniture and walls; a tenth of what one sees is each room's own."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from stillroom.geometry.arrays import F64, U8
from stillroom_scenes.scene import furniture, pictures
from stillroom_scenes.scene.atlas import AtlasBuilder
from stillroom_scenes.scene.builder import SceneBuilder
from stillroom_scenes.scene.patches import Patches
from stillroom_scenes.worlds import decor
from stillroom_scenes.worlds.shell import (
    DOOR_HEIGHT_M,
    DOOR_WIDTH_M,
    Doorway,
    Shell,
    add_shell,
    plain_finish,
)

DOOR_X_M = -1.2  # middle of the door, in the room's frame, in its south wall
ROOM = Shell(2.4, 2.2, (("south", Doorway(-DOOR_X_M - DOOR_WIDTH_M / 2)),))
TURN_CENTRE_M = (0.15, 0.1)  # free floor, which the camera goes round
WALL_TONE = (222, 218, 206)
Drawing = Callable[[np.random.Generator], U8]

# Side of the wall, x, z, width, height [m] of pictures: those that all rooms share, and each room's own.
SHARED_PICTURES = (
    ("north", -2.25, 1.3, 0.55, 0.75),
    ("north", -0.5, 1.3, 0.6, 0.8),
    ("north", 1.75, 2.1, 0.5, 0.5),
    ("east", -1.5, 1.35, 0.8, 0.6),
    ("east", 1.0, 1.2, 0.6, 0.8),
    ("west", -1.9, 1.2, 0.6, 0.8),
    ("west", 1.3, 1.3, 0.6, 0.8),
    ("south", -0.95, 1.2, 0.55, 0.8),
)
OWN_PICTURES = (
    ("north", 0.2, 1.2, 0.6, 0.85),
    ("east", -0.5, 1.4, 0.7, 0.8),
    ("west", -1.0, 1.3, 0.6, 0.85),
    ("south", -1.2, 2.05, 0.7, 0.5),
)


@dataclass(frozen=True)
class Model:
    """The room that all others are copies of.

    Attributes:
        patches: Around its own origin.
        own: What each copy has its own of: texture, and what draws another.
    """

    patches: Patches
    own: tuple[tuple[int, Drawing], ...]

    def copy(self, rng: np.random.Generator, atlas: AtlasBuilder) -> Patches:
        """Return another room with its own tenth; what it shares costs nothing."""
        texture = self.patches.kind[:, 1].copy()
        for number, draw in self.own:
            texture[self.patches.kind[:, 1] == number] = atlas.add(draw(rng))
        kind = self.patches.kind.copy()
        kind[:, 1] = texture
        return replace(self.patches, kind=kind)


def build_model(rng: np.random.Generator, atlas: AtlasBuilder, covers: tuple[int, int]) -> Model:
    """Furnish a room with a floor and a ceiling of given textures."""
    builder = SceneBuilder(atlas)
    add_shell(builder, ROOM, plain_finish(builder, rng, ROOM, WALL_TONE, *covers))
    walls = {side: ROOM.wall_frame(side) for side in ("north", "east", "south", "west")}
    _add_furniture(builder, rng, walls)
    for side, x, z, width, height in SHARED_PICTURES:
        furniture.hang(builder, walls[side], x, z, (width, height), decor.poster((width, height))(rng))
    leaf = decor.door(rng, decor.DOOR_TONES[0])
    furniture.hang(builder, walls["south"], -DOOR_X_M - 1.5 * DOOR_WIDTH_M, 0.0, (DOOR_WIDTH_M, DOOR_HEIGHT_M), leaf)
    own = []

    def add_own(wall: F64, corner_m: tuple[float, float, float], right_m: F64, up_m: F64, draw: Drawing) -> None:
        texture = builder.texture(draw(rng))
        builder.face(wall, corner_m, right_m, up_m, texture)
        own.append((texture, draw))

    x_axis, y_axis, z_axis = np.eye(3)
    for side, x, z, width, height in OWN_PICTURES:
        add_own(walls[side], (x, -0.02, z), width * x_axis, height * z_axis, decor.poster((width, height)))
    add_own(walls["north"], (-1.6, -0.02, 1.25), 1.0 * x_axis, 0.8 * z_axis, pictures.scribbles)
    add_own(np.eye(4), (-0.8, -1.0, 0.004), 2.4 * x_axis, 1.7 * y_axis, decor.rug)
    return Model(builder.build(), tuple(own))


def _add_furniture(builder: SceneBuilder, rng: np.random.Generator, walls: dict[str, F64]) -> None:
    """Place furniture before the walls; the middle stays free."""
    furniture.desk(builder, rng, walls["north"], -2.2, 1.5)
    furniture.cabinet(builder, rng, walls["north"], -0.3, 1.1, 0.75)
    furniture.shelf(builder, rng, walls["north"], 1.1, 1.2, 1.9)
    furniture.cabinet(builder, rng, walls["east"], -1.6, 1.2, 0.9)
    furniture.shelf(builder, rng, walls["east"], 0.2, 1.1, 0.85)
    furniture.desk(builder, rng, walls["west"], -0.6, 1.4)
    furniture.shelf(builder, rng, walls["south"], -2.2, 1.2, 1.8)
