"""What hangs, leans and lies in corridors and rooms: doors, signs, rugs, notice boards."""

from collections.abc import Callable

import cv2
import numpy as np

from stillroom.geometry.arrays import F64, U8
from stillroom_scenes.scene import furniture, pictures, surfaces
from stillroom_scenes.scene.builder import SceneBuilder
from stillroom_scenes.scene.surfaces import Rgb
from stillroom_scenes.worlds.shell import DOOR_HEIGHT_M, DOOR_WIDTH_M

DOOR_TONES: tuple[Rgb, ...] = ((150, 108, 70), (92, 116, 138), (124, 134, 108), (176, 150, 120), (132, 84, 78))
POSTER_PX_M = 380


def door(rng: np.random.Generator, colour: Rgb) -> U8:
    """Draw a door leaf with panels, a handle, a notice or two and the marks of use."""
    width, height = int(200 * DOOR_WIDTH_M), int(200 * DOOR_HEIGHT_M)
    upright = surfaces.wood(rng, height, width, colour, 5).transpose(1, 0, 2)
    picture: U8 = np.ascontiguousarray(upright)
    dark = tuple(int(c * 0.5) for c in colour)
    middle = int(rng.uniform(0.42, 0.58) * height)
    for top, low in ((24, middle - 10), (middle + 10, height - 30)):
        cv2.rectangle(picture, (24, top), (width - 24, low), dark, 3)
        cv2.rectangle(picture, (30, top + 6), (width - 30, low - 6), tuple(int(c * 1.15) for c in colour), 1)
    cv2.rectangle(picture, (12, middle - 12), (22, middle + 26), (205, 205, 200), -1)
    cv2.rectangle(picture, (14, middle), (44, middle + 7), (120, 120, 118), -1)
    for _ in range(int(rng.integers(1, 4))):
        x, y = int(rng.integers(36, width - 90)), int(rng.integers(40, middle - 60))
        sheet = np.full((int(rng.integers(40, 60)), int(rng.integers(34, 52)), 3), 240, dtype=np.uint8)
        pictures.write_lines(rng, sheet, 0.3, pictures.any_colour(rng, 0, 120), 0, len(sheet))
        picture[y : y + sheet.shape[0], x : x + sheet.shape[1]] = sheet
    cv2.rectangle(picture, (0, 0), (width - 1, height - 1), (70, 66, 60), 6)
    return picture


def sign(rng: np.random.Generator, text: str) -> U8:
    """Draw a plate with a room's number and some names."""
    picture = np.full((150, 150, 3), pictures.any_colour(rng, 170, 250), dtype=np.uint8)
    cv2.rectangle(picture, (0, 0), (149, 54), pictures.any_colour(rng, 20, 120), -1)
    cv2.putText(picture, text, (14, 44), cv2.FONT_HERSHEY_DUPLEX, 1.4, (250, 250, 250), 3, cv2.LINE_AA)
    pictures.write_lines(rng, picture, 0.42, (30, 30, 30), 56, 146)
    cv2.rectangle(picture, (0, 0), (149, 149), (60, 60, 60), 3)
    return picture


def rug(rng: np.random.Generator, width: int = 320, height: int = 220) -> U8:
    """Draw a woven rug with stripes and lozenges."""
    picture = surfaces.tinted(1.0 + 0.1 * surfaces.speckle(rng, height, width, 1, 4), pictures.any_colour(rng, 60, 180))
    for _ in range(7):
        x, colour = int(rng.integers(width)), pictures.any_colour(rng, 30, 220)
        cv2.line(picture, (x, 0), (x, height), colour, int(rng.integers(2, 9)))
    for _ in range(14):
        x, y, size = int(rng.integers(width)), int(rng.integers(height)), int(rng.integers(8, 26))
        lozenge = np.array([[x - size, y], [x, y - size], [x + size, y], [x, y + size]], dtype=np.int32)
        cv2.fillPoly(picture, [lozenge], pictures.any_colour(rng), cv2.LINE_AA)
    cv2.rectangle(picture, (0, 0), (width - 1, height - 1), pictures.any_colour(rng, 20, 90), 10)
    return picture


def poster(size_m: tuple[float, float]) -> Callable[[np.random.Generator], U8]:
    """Return what draws posters of a size."""
    width, height = int(POSTER_PX_M * size_m[0]), int(POSTER_PX_M * size_m[1])
    return lambda rng: pictures.poster(rng, width, height)


def closed_door(builder: SceneBuilder, rng: np.random.Generator, wall: F64, x_m: float, text: str) -> None:
    """Add a door that is shut, flat on the wall from x on, with its sign."""
    colour = DOOR_TONES[int(rng.integers(len(DOOR_TONES)))]
    furniture.hang(builder, wall, x_m, 0.0, (DOOR_WIDTH_M, DOOR_HEIGHT_M), door(rng, colour))
    furniture.hang(builder, wall, x_m + DOOR_WIDTH_M + 0.12, 1.4, (0.24, 0.24), sign(rng, text))
