"""Pieces of furniture, each built before a wall: local x to the right, −y into the room, z up."""

import numpy as np

from stillroom.geometry.arrays import F64, U8
from stillroom_scenes.scene import pictures, surfaces
from stillroom_scenes.scene.builder import SceneBuilder, Skin

WOODS: tuple[surfaces.Rgb, ...] = ((196, 152, 100), (150, 108, 70), (214, 186, 146), (120, 84, 60))
PAINTS: tuple[surfaces.Rgb, ...] = ((150, 160, 172), (84, 104, 132), (128, 132, 120), (176, 172, 160))


def _plain(builder: SceneBuilder, rng: np.random.Generator, colour: surfaces.Rgb) -> int:
    return builder.texture(surfaces.darken_borders(surfaces.metal(rng, 64, 64, colour), 6, 0.3))


def hang(
    builder: SceneBuilder, T_world_wall: F64, x_m: float, z_m: float, size_m: tuple[float, float], art: U8
) -> None:
    """Hang a picture, its lower left corner at (x, z), two centimetres off the wall."""
    corner = (x_m, -0.02, z_m)
    builder.face(T_world_wall, corner, (size_m[0], 0, 0), (0, 0, size_m[1]), builder.texture(art))


def desk(builder: SceneBuilder, rng: np.random.Generator, T_world_wall: F64, x_m: float, width_m: float) -> None:
    """Place a desk with clutter, a drawer block, monitors, a row of books and a lamp-like post."""
    colour = WOODS[int(rng.integers(len(WOODS)))]
    top = builder.texture(pictures.desk_clutter(rng, int(220 * width_m), 160, colour))
    edge = builder.texture(surfaces.wood(rng, 256, 16, colour, 1))
    dark = _plain(builder, rng, (52, 54, 60))
    front = builder.texture(pictures.drawers(rng, 96, 144, PAINTS[int(rng.integers(4))], 1, 3))
    builder.box(T_world_wall, (x_m, -0.75, 0.71), (width_m, 0.73, 0.04), Skin(edge, edge, top))
    for leg_x in (x_m + 0.03, x_m + width_m - 0.08):
        for leg_y in (-0.72, -0.09):
            builder.box(T_world_wall, (leg_x, leg_y, 0), (0.05, 0.05, 0.71), Skin(dark, dark, dark))
    builder.box(T_world_wall, (x_m + 0.12, -0.68, 0), (0.42, 0.55, 0.62), Skin(front, dark, dark))
    builder.occupy(T_world_wall, (x_m, -0.75), (x_m + width_m, -0.02))
    for k in range(2 if width_m > 1.3 else 1):
        x = x_m + 0.18 + 0.62 * k + float(rng.uniform(0, 0.06))
        shown = builder.texture(pictures.screen(rng))
        builder.box(T_world_wall, (x, -0.33, 0.85), (0.54, 0.04, 0.33), Skin(shown, dark, dark))
        builder.box(T_world_wall, (x + 0.24, -0.31, 0.75), (0.06, 0.03, 0.12), Skin(dark, dark, dark))
    spines = builder.texture(pictures.books(rng, 192, 128))
    x = x_m + width_m - 0.42
    builder.box(T_world_wall, (x, -0.26, 0.75), (0.36, 0.2, 0.24), Skin(spines, spines, dark))
    for _ in range(4):  # mugs, boxes, gadgets
        size = rng.uniform(0.05, 0.13, 3)
        skin = builder.texture(pictures.carton(rng, 64) if rng.integers(2) else surfaces.weave(rng, 64, _lively(rng)))
        x, y = x_m + rng.uniform(0.05, width_m - 0.2), rng.uniform(-0.66, -0.42)
        builder.box(T_world_wall, (x, y, 0.75), size, Skin(skin, skin, skin))


def shelf(
    builder: SceneBuilder, rng: np.random.Generator, T_world_wall: F64, x_m: float, width_m: float, height_m: float
) -> None:
    """Place a bookcase: boards, uprights and a row of books or things on each board."""
    colour = WOODS[int(rng.integers(len(WOODS)))]
    board = builder.texture(surfaces.wood(rng, 128, 32, colour, 2))
    skin = Skin(board, board, board)
    count = max(2, round(height_m / 0.36))
    step = height_m / count
    for x in (x_m, x_m + width_m - 0.025):
        builder.box(T_world_wall, (x, -0.32, 0), (0.025, 0.3, height_m), skin)
    for k in range(count + 1):
        builder.box(T_world_wall, (x_m, -0.32, k * step - 0.012), (width_m, 0.3, 0.025), skin)
    for k in range(count):
        spines = builder.texture(pictures.books(rng, int(330 * width_m), 104))
        depth = float(rng.uniform(0.2, 0.27))
        corner, size = (x_m + 0.03, -depth - 0.02, k * step + 0.013), (width_m - 0.06, depth, step - 0.07)
        builder.box(T_world_wall, corner, size, Skin(spines, board, board))
    builder.occupy(T_world_wall, (x_m, -0.32), (x_m + width_m, -0.02))
    tower(builder, rng, T_world_wall, x_m + 0.1, height_m, 0.3, 1)


def cabinet(
    builder: SceneBuilder, rng: np.random.Generator, T_world_wall: F64, x_m: float, width_m: float, height_m: float
) -> None:
    """Place a cabinet with drawers and some cartons on it."""
    colour = PAINTS[int(rng.integers(4))]
    columns, rows = max(1, round(width_m / 0.45)), max(2, round(height_m / 0.3))
    front = builder.texture(pictures.drawers(rng, 120 * columns, 72 * rows, colour, columns, rows))
    side = _plain(builder, rng, colour)
    top = builder.texture(pictures.desk_clutter(rng, int(200 * width_m), 96, WOODS[0]))
    builder.box(T_world_wall, (x_m, -0.47, 0), (width_m, 0.45, height_m), Skin(front, side, top), stands=True)
    x = x_m + 0.05
    while x < x_m + width_m - 0.3:
        size = float(rng.uniform(0.2, 0.32))
        tower(builder, rng, T_world_wall, x, height_m, size, int(rng.integers(1, 3)))
        x += size + float(rng.uniform(0.05, 0.3))


def tower(
    builder: SceneBuilder,
    rng: np.random.Generator,
    T_world_wall: F64,
    x_m: float,
    z_m: float,
    size_m: float,
    count: int,
) -> None:
    """Pile up cartons; those on the floor (z = 0) are stood before the wall."""
    for _ in range(count):
        skin = [builder.texture(pictures.carton(rng, 128)) for _ in range(2)]
        low = (x_m + float(rng.uniform(0, 0.03)), -size_m - 0.04, z_m)
        height = size_m * float(rng.uniform(0.6, 0.9))
        skins = Skin(skin[0], skin[1], skin[1])
        builder.box(T_world_wall, low, (size_m, size_m, height), skins, stands=z_m == 0)
        z_m += height


def bench(builder: SceneBuilder, rng: np.random.Generator, T_world_wall: F64, x_m: float, width_m: float) -> None:
    """Place a work bench with a pegboard of tools above and crates below."""
    colour = WOODS[int(rng.integers(len(WOODS)))]
    top = builder.texture(pictures.desk_clutter(rng, int(220 * width_m), 144, colour))
    edge = builder.texture(surfaces.wood(rng, 256, 24, colour, 1))
    builder.box(T_world_wall, (x_m, -0.66, 0.8), (width_m, 0.64, 0.07), Skin(edge, edge, top))
    for leg_x in (x_m + 0.02, x_m + width_m - 0.1):
        builder.box(T_world_wall, (leg_x, -0.64, 0), (0.08, 0.08, 0.8), Skin(edge, edge, edge))
    builder.occupy(T_world_wall, (x_m, -0.66), (x_m + width_m, -0.02))
    x = x_m
    while x < x_m + width_m - 0.3:
        tower(builder, rng, T_world_wall, x + 0.03, 0.0, float(rng.uniform(0.34, 0.44)), 2)
        x += 0.48
    hang(builder, T_world_wall, x_m, 1.05, (width_m, 0.75), pictures.pegboard(rng, int(240 * width_m), 180))


def small_table(builder: SceneBuilder, rng: np.random.Generator, T_world_local: F64) -> None:
    """Place a small square table, its middle at the local origin."""
    top = builder.texture(surfaces.wood(rng, 128, 128, WOODS[2], 3))
    edge = builder.texture(surfaces.wood(rng, 128, 16, WOODS[1], 1))
    builder.box(T_world_local, (-0.26, -0.22, 0.7), (0.52, 0.44, 0.04), Skin(edge, edge, top))
    builder.box(T_world_local, (-0.05, -0.05, 0.02), (0.1, 0.1, 0.68), Skin(edge, edge, edge))
    builder.box(T_world_local, (-0.2, -0.17, 0), (0.4, 0.34, 0.02), Skin(edge, edge, edge))
    builder.occupy(T_world_local, (-0.26, -0.22), (0.26, 0.22))


def chair(builder: SceneBuilder, rng: np.random.Generator, T_world_local: F64, colour: surfaces.Rgb) -> None:
    """Place an office chair that faces local −y."""
    cloth = builder.texture(surfaces.weave(rng, 96, colour))
    dark = _plain(builder, rng, (46, 46, 50))
    cushion, frame = Skin(cloth, cloth, cloth), Skin(dark, dark, dark)
    builder.box(T_world_local, (-0.24, -0.24, 0.44), (0.48, 0.46, 0.08), cushion)
    builder.box(T_world_local, (-0.22, 0.19, 0.58), (0.44, 0.07, 0.5), cushion)
    builder.box(T_world_local, (-0.03, 0.2, 0.46), (0.06, 0.03, 0.14), frame)
    for x in (-0.3, 0.25):
        builder.box(T_world_local, (x, -0.16, 0.64), (0.05, 0.26, 0.03), frame)
        builder.box(T_world_local, (x, 0.02, 0.46), (0.05, 0.05, 0.18), frame)
    builder.box(T_world_local, (-0.03, -0.04, 0.1), (0.06, 0.06, 0.35), frame)
    builder.box(T_world_local, (-0.3, -0.035, 0.05), (0.6, 0.05, 0.05), frame)
    builder.box(T_world_local, (-0.025, -0.3, 0.05), (0.05, 0.58, 0.05), frame)
    for x, y in ((-0.3, -0.03), (0.26, -0.03), (-0.02, -0.3), (-0.02, 0.24)):
        builder.box(T_world_local, (x, y, 0), (0.04, 0.04, 0.06), frame)


def _lively(rng: np.random.Generator) -> surfaces.Rgb:
    return pictures.any_colour(rng, 30, 220)
