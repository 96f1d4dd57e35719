"""Culling: unreliable points and redundant keyframes."""

from dataclasses import dataclass

import numpy as np

from stillroom.compiled import njit
from stillroom.data.map import Map
from stillroom.data.map.links import Links
from stillroom.geometry.arrays import F32, I32, Bool

MIN_FOUND_RATIO = 0.25
REDUNDANT_SHARE = 0.9
_MIN_OTHERS = 3


@dataclass(frozen=True)
class Trial:
    """How long a new point is tested, and what it must show.

    Attributes:
        keyframes: Keyframes after which a point must be seen often enough. ORB-SLAM2 has 2. Its keyframes lie further
            apart in time; here that would remove most of the points of a fast rotation.
        min_observations: A point must then have more than so many observations; one with depth counts as two.
    """

    keyframes: int = 8
    min_observations: int = 3


TRIAL = Trial()


def on_trial(world: Map, trial: Trial = TRIAL) -> I32:
    """Return the recent points (P,), which are still being tested: those of the last keyframes."""
    first = len(world.keyframes) - trial.keyframes
    return np.flatnonzero(world.points.is_alive & (world.points.first_keyframe >= first)).astype(np.int32)


def cull_points(recent: I32, keyframe: int, world: Map, trial: Trial = TRIAL) -> I32:
    """Remove recent points (P,) that are rarely found or, after some keyframes, hardly seen; return the others.

    An observation with depth counts as two (docs/reference.md#orb-slam2-mapping).
    """
    points = world.points
    recent = recent[points.is_alive[recent]]
    age = keyframe - points.first_keyframe[recent]
    rarely = points.n_found[recent] < MIN_FOUND_RATIO * points.n_visible[recent]
    hardly = (age >= trial.keyframes) & (points.n_observations[recent] <= trial.min_observations)
    world.remove_points(recent[rarely | hardly])
    return recent[~(rarely | hardly) & (age < trial.keyframes)]


def cull_keyframes(keyframe: int, close_depth_m: float, world: Map) -> list[int]:
    """Remove covisible keyframes of which 90 % of the close points are seen by three others as finely.

    With a single camera, which measures no depth, all points count. The first keyframe of a sub-map, which is its
    origin, and the newest stay.

    Returns:
        The removed keyframes.
    """
    removed = []
    for candidate in world.covisibility.neighbours(keyframe):
        if world.keyframes.parent[candidate] < 0:
            continue
        rows = world.rows(candidate)
        table, points = world.keypoints, world.points
        depth_m = table.depth_m if world.sensor.is_metric else np.ones_like(table.depth_m)
        n_close, n_redundant = count_redundant(
            rows.start, rows.stop, close_depth_m, world.lists, depth_m, table.octave, points.is_alive
        )
        if n_close > 0 and n_redundant > REDUNDANT_SHARE * n_close:
            world.remove_keyframe(candidate)
            removed.append(candidate)
    return removed


@njit(nogil=True, cache=True)
def count_redundant(
    start: int,
    stop: int,
    close_depth_m: float,
    links: Links,
    row_depth_m: F32,
    row_octave: I32,
    is_alive: Bool,
) -> tuple[int, int]:
    """Count the close points that rows see, and those of them that three other keyframes see as finely."""
    row_point, next_row, row_keyframe, first_row = links
    n_close, n_redundant = 0, 0
    for row in range(start, stop):
        point = row_point[row]
        if point < 0 or not is_alive[point] or row_depth_m[row] <= 0 or row_depth_m[row] > close_depth_m:
            continue
        n_close += 1
        others = 0
        other = first_row[point]
        while other >= 0 and others < _MIN_OTHERS:
            if row_keyframe[other] != row_keyframe[row] and row_octave[other] <= row_octave[row] + 1:
                others += 1
            other = next_row[other]
        n_redundant += others >= _MIN_OTHERS
    return n_close, n_redundant
