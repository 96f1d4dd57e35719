"""The people in the room and their actions: the presets of `figures=`.

The camera's home is at y ≈ −1.5, looking towards +y; figures keep to the middle of the room, where no furniture stands.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from stillroom_scenes.scene.people.script import Point, Script

TO_CAMERA = np.pi
LEFT, RIGHT = np.pi / 2, -np.pi / 2
MIDDLE_Y_M = 0.6
TABLE_TOP_M = 0.74
CHAIR_AHEAD_M = 0.62


@dataclass(frozen=True)
class Handling:
    """An object that a figure handles once: it rests, is picked up, goes along, and rests elsewhere.

    Attributes:
        label: "box" or "chair".
        figure: Number of the figure in the cast.
        taken_s, left_s: When it is touched and let go.
        lift_s: How long it takes from its rest to the hands, and back; 0 for what stays on the floor.
        rest_m: Where it lies before: x, y, z [m].
        rest_yaw_rad: How it lies before.
        hold_m: Where it is in the figure's frame while it is held; None for where it is when it is touched.
        put_m: Where it comes to lie; None for where it is when it is let go.
    """

    label: str
    figure: int
    taken_s: float
    left_s: float
    lift_s: float
    rest_m: tuple[float, float, float]
    rest_yaw_rad: float = 0.0
    hold_m: tuple[float, float, float] | None = None
    put_m: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class Cast:
    """All people and handled objects.

    Attributes:
        scripts: One for each figure.
        handlings: Objects that are moved.
        tables: Where small tables stand for them, centres on the floor [m].
    """

    scripts: tuple[Script, ...] = ()
    handlings: tuple[Handling, ...] = ()
    tables: tuple[Point, ...] = ()


@dataclass(frozen=True)
class Stage:
    """The part of the floor that figures take: all their coordinates are scaled and moved to it.

    Attributes:
        scale: 1 where the camera stays at home; less where it goes round the figures.
        middle_y_m: Where the middle of the stage lies.
    """

    scale: float = 1.0
    middle_y_m: float = MIDDLE_Y_M

    def at(self, x_m: float, y_m: float) -> Point:
        """Return where a point of the full stage comes to lie."""
        return self.scale * x_m, self.middle_y_m + self.scale * (y_m - MIDDLE_Y_M)


def _to_and_fro(
    script: Script, stage: Stage, x_m: float, y_m: float, reach_m: float, speed: float, rest_s: float
) -> Script:
    """Go to and fro about x, stopping and looking at the camera at the ends."""
    right, left = stage.at(x_m + reach_m, y_m), stage.at(x_m - reach_m, y_m)
    script.walk(right, speed).loop()
    return script.stand(rest_s, TO_CAMERA).walk(left, speed).stand(rest_s, TO_CAMERA).walk(right, speed)


def _walking(rng: np.random.Generator, stage: Stage) -> Cast:
    """Two go side by side, to and fro before the camera; a third passes behind them."""
    speed, rest_s = float(rng.uniform(0.5, 0.6)), float(rng.uniform(0.3, 0.5))
    near = Script(stage.at(-1.4, 0.28), RIGHT)
    far = Script(stage.at(-1.95, 0.44), RIGHT)
    _to_and_fro(near, stage, 0.4, 0.28, 0.65, speed, rest_s)
    _to_and_fro(far, stage, -0.4, 0.44, 0.65, speed, rest_s)
    third = Script(stage.at(-1.75, 1.2), RIGHT).stand(0.4, RIGHT).walk(stage.at(1.75, 1.2), 0.85).loop()
    third.stand(1.6, LEFT).walk(stage.at(-0.1, 1.25), 0.8).stand(1.5, TO_CAMERA).walk(stage.at(-1.75, 1.25), 0.8)
    third.stand(1.2, RIGHT).walk(stage.at(1.75, 1.2), 0.85)
    return Cast((near, far, third))


def _standing(rng: np.random.Generator, stage: Stage) -> Cast:
    """Three stand and talk for five seconds; then they go to and fro."""
    speed = float(rng.uniform(0.5, 0.6))
    near = Script(stage.at(0.44, 0.2), TO_CAMERA).stand(5.0, TO_CAMERA - 0.7)
    far = Script(stage.at(-0.44, 0.35), TO_CAMERA).stand(5.1, TO_CAMERA + 0.6)
    back = Script(stage.at(0.0, 1.1), TO_CAMERA).stand(5.6, TO_CAMERA)
    _to_and_fro(near, stage, 0.44, 0.2, 0.65, speed, 1.2)
    _to_and_fro(far, stage, -0.44, 0.35, 0.65, speed, 1.2)
    _to_and_fro(back, stage, 0.0, 1.1, 1.2, 0.7, 1.0)
    return Cast((near, far, back))


def _carried(rng: np.random.Generator, stage: Stage) -> Cast:
    """One takes a box from a table on the left, carries it to one on the right, and goes away; another watches."""
    left, right = stage.at(-1.0, 1.2), stage.at(1.0, 1.25)
    speed = float(rng.uniform(0.5, 0.65))
    carrier = Script(stage.at(0.1, 0.4), LEFT).stand(0.6, LEFT)
    carrier.walk((left[0], left[1] - 0.58), speed).stand(0.8, 0.0)
    taken_s = carrier.end_s
    carrier.stand(1.2, 0.0, "carry").walk(stage.at(0.0, 0.35), speed, "carry")
    carrier.walk((right[0], right[1] - 0.58), speed, "carry").stand(1.9, 0.0, "carry")
    left_s = carrier.end_s
    home, aside = stage.at(0.0, 0.4), stage.at(-0.65, 0.4)
    carrier.stand(0.9, 0.0).walk(home, speed).loop()
    carrier.stand(1.5, TO_CAMERA).walk(aside, speed).stand(1.0, TO_CAMERA).walk(home, speed)
    watcher = Script(stage.at(0.1, 1.5), TO_CAMERA).stand(3.0, TO_CAMERA + 0.4).walk(stage.at(-0.1, 1.5), 0.4).loop()
    watcher.stand(6.0, TO_CAMERA).walk(stage.at(-0.25, 1.5), 0.4).stand(4.0, TO_CAMERA).walk(stage.at(-0.1, 1.5), 0.4)
    hold_m, put_m = (0.0, 0.42, 1.0), (*right, TABLE_TOP_M)
    box = Handling("box", 0, taken_s, left_s, 1.0, (*left, TABLE_TOP_M), 0.2, hold_m, put_m)
    return Cast((carrier, watcher), (box,), (left, right))


def _pushed(rng: np.random.Generator, stage: Stage) -> Cast:
    """One pushes a chair across the room, leaves it and goes away; another walks by."""
    speed = float(rng.uniform(0.4, 0.5))
    start, end = stage.at(-1.15, 0.5), stage.at(0.4, 0.5)
    pusher = Script(stage.at(0.0, 0.0), LEFT).stand(0.6, TO_CAMERA).walk(stage.at(-1.15, 0.0), 0.55).walk(start, 0.4)
    pusher.stand(1.2, RIGHT).stand(0.9, RIGHT, "push")
    taken_s = pusher.end_s
    pusher.walk(end, speed, "push")
    left_s = pusher.end_s
    home, aside = stage.at(-0.2, 0.2), stage.at(-1.0, 0.2)
    pusher.stand(0.9, RIGHT).walk(home, 0.5).loop()
    pusher.stand(1.6, TO_CAMERA).walk(aside, 0.5).stand(1.2, TO_CAMERA).walk(home, 0.5)
    out, back = stage.at(-1.7, 1.25), stage.at(1.7, 1.25)
    passer = Script(back, LEFT).stand(2.5, LEFT).walk(out, 0.7).loop()
    passer.stand(2.0, RIGHT).walk(back, 0.7).stand(2.5, LEFT).walk(out, 0.7)
    chair = Handling("chair", 0, taken_s, left_s, 0.0, (start[0] + CHAIR_AHEAD_M, start[1], 0.0), np.pi / 2)
    return Cast((pusher, passer), (chair,))


def _none(rng: np.random.Generator, stage: Stage) -> Cast:
    """Nobody."""
    return Cast()


FIGURES: dict[str, Callable[[np.random.Generator, Stage], Cast]] = {
    "none": _none,
    "walking": _walking,
    "standing": _standing,
    "carried": _carried,
    "pushed": _pushed,
}


def cast_for(figures: str, seed: int, stage: Stage) -> Cast:
    """Return the cast.

    Args:
        figures: One of `FIGURES`.
        seed: Chooses speeds and pauses.
        stage: The part of the floor that they use.
    """
    return FIGURES[figures](np.random.default_rng([seed, 23]), stage)
