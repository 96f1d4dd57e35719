"""A ring of corridors: one comes back to where one started, if one knows it."""

import math
from functools import lru_cache

import numpy as np

from stillroom.geometry.arrays import F64
from stillroom_scenes.camera_path import Wander
from stillroom_scenes.render import World
from stillroom_scenes.scene import furniture, pictures, surfaces
from stillroom_scenes.scene.builder import SceneBuilder, placed
from stillroom_scenes.scene.people.script import Script
from stillroom_scenes.worlds import decor
from stillroom_scenes.worlds.assembly import Assembly
from stillroom_scenes.worlds.building import BuildingScene
from stillroom_scenes.worlds.shell import Shell, add_shell, floor_and_ceiling, plain_finish
from stillroom_scenes.worlds.walk import Walk

HALF_WIDTH_M = 1.5
LONGEST_SEGMENT_M = 6.0
LARGEST_RING_M, SMALLEST_RING_M = 66.0, 26.0  # along the middle
WIDE_SHARE = 0.64  # of half the ring, for the long sides
PACE_M_S = 1.65
ROUNDS = 1.25  # so far the camera goes: once round, and on where it has been
WALKER_M = 4.5
CAMERA_LANE_M, FIGURE_LANE_M = -0.35, 0.5  # to the left of the middle; the ring goes round to the left
TONES: tuple[surfaces.Rgb, ...] = ((222, 218, 206), (206, 214, 216), (224, 208, 188), (208, 216, 202), (218, 206, 212))
FLOORS: tuple[surfaces.Rgb, ...] = ((112, 118, 128), (128, 112, 98), (104, 116, 108), (120, 108, 118))
GLANCES = Wander(
    x=((0.04, 0.11), (0.012, 0.9)),
    y=((0.04, 0.13), (0.012, 0.7)),
    z=((0.02, 1.1), (0.03, 0.2)),
    yaw=((0.3, 0.07), (0.06, 0.21), (0.015, 0.6)),
    pitch=((0.03, 0.3),),
    roll=((0.02, 0.35),),
)


def corridor(n_frames: int, fps: float, figures: str, seed: int) -> World:
    """Return a ring that the camera goes round once, and on, in so many frames; at most 66 m long.

    Args:
        n_frames: Few make a smaller ring: the camera keeps its pace.
        fps: Frames per second.
        figures: "walking" or "none".
        seed: Chooses textures, things, clothes and speeds.
    """
    way_m = n_frames / fps * PACE_M_S
    ring_m = min(LARGEST_RING_M, max(SMALLEST_RING_M, round(way_m / ROUNDS)))
    middle_m = _half_m(ring_m)
    lane = Walk(_rectangle(middle_m - CAMERA_LANE_M), PACE_M_S, GLANCES, seed, 0.5 * float(middle_m[0]))
    return World(_scene(ring_m, figures, seed), lane)


def _half_m(ring_m: float) -> F64:
    """Return half the size (2,) of the rectangle that the middle line makes."""
    long_m = 0.5 * ring_m * WIDE_SHARE
    return 0.5 * np.array([long_m, 0.5 * ring_m - long_m])


@lru_cache(maxsize=1)
def _scene(ring_m: float, figures: str, seed: int) -> BuildingScene:
    """Build the ring, or take it from a moment ago: it is never changed."""
    assembly, middle_m = Assembly(), _half_m(ring_m)
    _build_ring(assembly, middle_m, seed)
    return assembly.build(_walkers(middle_m, seed) if figures == "walking" else (), seed)


def _rectangle(half_m: F64) -> F64:
    """Return corners (4, 2) from the lower left one, round to the left."""
    return np.array([[-1, -1], [1, -1], [1, 1], [-1, 1.0]]) * half_m


def _legs(middle_m: F64) -> list[tuple[F64, float]]:
    """Return the frame of each leg's middle (x along it, y to the inside) and its length between the corners."""
    return [
        (placed(0.0, -middle_m[1], 0.0, 0.0), 2 * (middle_m[0] - HALF_WIDTH_M)),
        (placed(middle_m[0], 0.0, 0.0, np.pi / 2), 2 * (middle_m[1] - HALF_WIDTH_M)),
        (placed(0.0, middle_m[1], 0.0, np.pi), 2 * (middle_m[0] - HALF_WIDTH_M)),
        (placed(-middle_m[0], 0.0, 0.0, -np.pi / 2), 2 * (middle_m[1] - HALF_WIDTH_M)),
    ]


def _build_ring(assembly: Assembly, middle_m: F64, seed: int) -> None:
    rng = np.random.default_rng([seed, 59])
    builder = SceneBuilder(assembly.atlas)
    covers = [floor_and_ceiling(builder, rng, LONGEST_SEGMENT_M, floor) for floor in FLOORS]
    number = 0
    chain: list[int] = []
    for leg, (T_world_leg, length_m) in enumerate(_legs(middle_m)):
        count = max(1, round(length_m / LONGEST_SEGMENT_M))
        shell = Shell(0.5 * length_m / count, HALF_WIDTH_M, open_sides=("east", "west"))
        for k in range(count):
            T_leg_segment = placed((2 * k + 1 - count) * shell.half_x_m, 0.0)
            rng = np.random.default_rng([seed, 61, number])
            builder = SceneBuilder(assembly.atlas)
            _furnish(builder, rng, shell, covers[leg], number)
            chain.append(assembly.add(f"segment {number}", shell, builder.build(), T_world_leg @ T_leg_segment))
            number += 1
        T_leg_corner = placed(0.5 * length_m + HALF_WIDTH_M, 0.0)
        chain.append(_add_corner(assembly, T_world_leg @ T_leg_corner, leg, covers[leg], seed))
    for one, other in zip(chain, chain[1:] + chain[:1], strict=True):
        assembly.join(one, other)


def _add_corner(assembly: Assembly, T_world_corner: F64, leg: int, covers: tuple[int, int], seed: int) -> int:
    """Add the corner after a leg: walls ahead and on the outside, a picture on each."""
    shell = Shell(HALF_WIDTH_M, HALF_WIDTH_M, open_sides=("west", "north"))
    rng = np.random.default_rng([seed, 67, leg])
    builder = SceneBuilder(assembly.atlas)
    add_shell(builder, shell, plain_finish(builder, rng, shell, _one_of(rng, TONES), *covers))
    for side in ("east", "south"):
        wall = shell.wall_frame(side)
        furniture.hang(builder, wall, -1.1, 1.0, (0.9, 1.1), decor.poster((0.9, 1.1))(rng))
        furniture.hang(builder, wall, 0.1, 1.15, (1.1, 0.8), pictures.notes(rng))
    furniture.tower(builder, rng, shell.wall_frame("east"), 0.8, 0.0, 0.4, 2)
    return assembly.add(f"corner {leg}", shell, builder.build(), T_world_corner)


def _one_of(rng: np.random.Generator, tones: tuple[surfaces.Rgb, ...]) -> surfaces.Rgb:
    return tones[int(rng.integers(len(tones)))]


def _furnish(
    builder: SceneBuilder, rng: np.random.Generator, shell: Shell, covers: tuple[int, int], number: int
) -> None:
    """Add walls, doors, pictures and furniture; south is the outside, where things may stand."""
    add_shell(builder, shell, plain_finish(builder, rng, shell, _one_of(rng, TONES), *covers))
    for side in ("north", "south"):
        wall, end_m = shell.wall_frame(side), shell.half_x_m - 0.1
        at_m = -end_m + float(rng.uniform(0.0, 0.3))
        k = int(rng.integers(3))
        while at_m < end_m - 0.7:
            at_m += _add_thing(builder, rng, wall, at_m, end_m - at_m, (side == "south", k % 3), f"{number}{k}")
            at_m += float(rng.uniform(0.1, 0.4))
            k += 1


def _add_thing(
    builder: SceneBuilder,
    rng: np.random.Generator,
    wall: F64,
    x_m: float,
    room_m: float,
    choice: tuple[bool, int],
    text: str,
) -> float:
    """Add a door, something that stands with something above, or pictures, and return how wide that is."""
    may_stand, kind = choice
    if kind == 0 and room_m > 1.5:
        decor.closed_door(builder, rng, wall, x_m, text)
        return 1.4
    if kind == 1 and may_stand and room_m > 1.2:
        width_m = float(rng.uniform(0.9, min(1.5, room_m)))
        if rng.integers(2):
            furniture.shelf(builder, rng, wall, x_m, width_m, 0.8)
        else:
            furniture.cabinet(builder, rng, wall, x_m, width_m, 0.85)
        furniture.hang(builder, wall, x_m + 0.1, 1.45, (width_m - 0.2, 0.7), decor.poster((width_m - 0.2, 0.7))(rng))
        return width_m
    if kind == 2 and room_m > 1.4:
        board = pictures.scribbles(rng) if rng.integers(2) else pictures.notes(rng)
        furniture.hang(builder, wall, x_m, 1.1, (1.3, 0.85), board)
        return 1.3
    size_m = float(rng.uniform(0.5, min(0.75, room_m))), float(rng.uniform(0.6, 0.9))
    furniture.hang(builder, wall, x_m, float(rng.uniform(1.0, 1.4)), size_m, decor.poster(size_m)(rng))
    return size_m[0]


def _walkers(middle_m: F64, seed: int) -> tuple[Script, ...]:
    """Return figures that go to and fro in the legs, one to at most 4.5 metres, on the inner lane."""
    rng = np.random.default_rng([seed, 23, 1])
    scripts = []
    for T_world_leg, length_m in _legs(middle_m):
        count = math.ceil(length_m / WALKER_M) if length_m > 3.0 else 0
        for k in range(count):
            ends = np.array([[k, k + 1], [k + 1, k]], dtype=np.float64)[int(rng.integers(2))]
            along = -0.5 * length_m + length_m / count * ends + np.sign(ends[::-1] - ends) * 0.4
            (a_x, a_y), (b_x, b_y) = (
                (T_world_leg @ np.array([x, FIGURE_LANE_M, 0.0, 1.0]))[:2].tolist() for x in along
            )
            speed, rest_s = float(rng.uniform(0.45, 0.8)), float(rng.uniform(0.3, 1.5))
            script = Script((a_x, a_y), 0.0).stand(rest_s).loop()
            scripts.append(script.walk((b_x, b_y), speed).stand(rest_s).walk((a_x, a_y), speed).stand(rest_s))
    return tuple(scripts)
