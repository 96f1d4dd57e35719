"""Where a figure is at any time: a list of legs, some walked once, the rest for ever."""

import math
from dataclasses import dataclass

import numpy as np

from stillroom.geometry.arrays import F64

TURN_S = 0.8
RAMP_S = 0.6

Point = tuple[float, float]


@dataclass(frozen=True)
class Leg:
    """A stretch of a figure's way: a walk along a line, or a stop.

    Attributes:
        duration_s: How long it takes.
        start_m, end_m: Where, on the floor; equal for a stop.
        heading_rad: Where the figure looks: 0 is +y, π/2 is −x.
        speed_m_s: Between the ramps.
        gesture: "", "carry", "push" or "reach".
    """

    duration_s: float
    start_m: Point
    end_m: Point
    heading_rad: float
    speed_m_s: float = 0.0
    gesture: str = ""

    @property
    def length_m(self) -> float:
        """How far it goes."""
        return math.dist(self.start_m, self.end_m)


@dataclass(frozen=True)
class Place:
    """A figure's place at a moment.

    Attributes:
        x_m, y_m, heading_rad: On the floor, world.
        speed_share: Its speed over the leg's.
        speed_m_s: The leg's speed, or that of the last walk.
        walked_m: Way since time 0.
        gestures: Share 0 … 1 of "carry" and "push".
    """

    x_m: float
    y_m: float
    heading_rad: float
    speed_share: float
    speed_m_s: float
    walked_m: float
    gestures: dict[str, float]


def heading_to(start_m: Point, end_m: Point) -> float:
    """Return the heading [rad] of someone who walks from a point to another."""
    return math.atan2(start_m[0] - end_m[0], end_m[1] - start_m[1])


class Script:
    """The path of one figure. Legs are added in order; after the last it continues with the loop's first."""

    def __init__(self, start_m: Point, heading_rad: float) -> None:
        self.legs: list[Leg] = []
        self.loop_from = 0
        self._at_m, self._heading_rad = start_m, heading_rad

    @property
    def end_s(self) -> float:
        """When the legs so far end."""
        return sum(leg.duration_s for leg in self.legs)

    def stand(self, duration_s: float, heading_rad: float | None = None, gesture: str = "") -> "Script":
        """Stop for a while, looking somewhere."""
        if heading_rad is not None:
            self._heading_rad = heading_rad
        self.legs.append(Leg(duration_s, self._at_m, self._at_m, self._heading_rad, 0.0, gesture))
        return self

    def walk(self, end_m: Point, speed_m_s: float, gesture: str = "", heading_rad: float | None = None) -> "Script":
        """Walk to a point; by default looking where one goes."""
        length = math.dist(self._at_m, end_m)
        speed = min(speed_m_s, length / RAMP_S)
        self._heading_rad = heading_to(self._at_m, end_m) if heading_rad is None else heading_rad
        self.legs.append(Leg(length / speed + RAMP_S, self._at_m, end_m, self._heading_rad, speed, gesture))
        self._at_m = end_m
        return self

    def loop(self) -> "Script":
        """Let the following legs repeat for ever; the last must end where this is called."""
        self.loop_from = len(self.legs)
        return self

    def at(self, time_s: float) -> Place:
        """Return the figure's place at a time ≥ 0."""
        once, again = self.legs[: self.loop_from], self.legs[self.loop_from :]
        once_s, round_s = sum(leg.duration_s for leg in once), sum(leg.duration_s for leg in again)
        index, rounds, walked_m, elapsed_s = 0, 0.0, 0.0, time_s
        if time_s >= once_s:
            rounds, elapsed_s = divmod(time_s - once_s, round_s)
            index = self.loop_from
            walked_m = sum(leg.length_m for leg in once) + rounds * sum(leg.length_m for leg in again)
        while index < len(self.legs) - 1 and elapsed_s >= self.legs[index].duration_s:
            elapsed_s -= self.legs[index].duration_s
            walked_m += self.legs[index].length_m
            index += 1
        before = len(self.legs) - 1 if rounds and index == self.loop_from else index - 1
        leg = self.legs[index]
        previous = self.legs[before] if before >= 0 else leg
        return _place(leg, previous, min(elapsed_s, leg.duration_s), walked_m)


def _place(leg: Leg, previous: Leg, elapsed_s: float, walked_m: float) -> Place:
    gone_m, share = _way(leg, elapsed_s)
    part = gone_m / leg.length_m if leg.length_m > 0 else 0.0
    turned = _smooth(elapsed_s / min(TURN_S, leg.duration_s))
    turn = (leg.heading_rad - previous.heading_rad + math.pi) % (2 * math.pi) - math.pi
    gestures = {}
    for gesture in ("carry", "push"):
        now, then = float(leg.gesture == gesture), float(previous.gesture == gesture)
        gestures[gesture] = then + (now - then) * turned
    return Place(
        leg.start_m[0] + part * (leg.end_m[0] - leg.start_m[0]),
        leg.start_m[1] + part * (leg.end_m[1] - leg.start_m[1]),
        previous.heading_rad + turn * turned,
        share,
        leg.speed_m_s or previous.speed_m_s or 0.5,
        walked_m + gone_m,
        gestures,
    )


def _smooth(share: float) -> float:
    s = min(max(share, 0.0), 1.0)
    return s * s * (3.0 - 2.0 * s)


def _way(leg: Leg, elapsed_s: float) -> tuple[float, float]:
    """Return the way gone [m] and the share of the full speed, with soft ramps at both ends."""
    if leg.speed_m_s == 0.0:
        return 0.0, 0.0
    left_s = leg.duration_s - elapsed_s
    if elapsed_s < RAMP_S:
        u = elapsed_s / RAMP_S
        return leg.speed_m_s * RAMP_S * (u**3 - 0.5 * u**4), _smooth(u)
    if left_s < RAMP_S:
        u = left_s / RAMP_S
        length = leg.speed_m_s * (leg.duration_s - RAMP_S)
        return length - leg.speed_m_s * RAMP_S * (u**3 - 0.5 * u**4), _smooth(u)
    return leg.speed_m_s * (elapsed_s - 0.5 * RAMP_S), 1.0


def placed_matrix(place: Place) -> F64:
    """Return `T_world_figure` (4, 4)."""
    c, s = math.cos(place.heading_rad), math.sin(place.heading_rad)
    return np.array([[c, -s, 0, place.x_m], [s, c, 0, place.y_m], [0, 0, 1, 0], [0, 0, 0, 1.0]])
