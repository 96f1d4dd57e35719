"""How much of a surface a map holds."""

import numpy as np
from scipy.spatial import cKDTree

from stillroom.evaluation.ghosts.figures import CompletenessFigure
from stillroom.geometry.arrays import F64, Floats

WITHIN_M = 0.05


def completeness(points_m: Floats, surface_m: Floats, within_m: float = WITHIN_M) -> CompletenessFigure:
    """Count the points of a surface that have a point of the map near them.

    Args:
        points_m: The map (N, 3) [m].
        surface_m: The surface, evenly sampled (M, 3) [m], in the same frame.
        within_m: How near the map's point must be [m].
    """
    is_found = distances_m(surface_m, points_m, within_m) <= within_m
    return CompletenessFigure(len(surface_m), int(is_found.sum()), within_m, is_found)


def distances_m(from_m: Floats, to_m: Floats, at_most_m: float) -> F64:
    """Return the distance [m] of each point (N, 3) to the nearest of others (M, 3); infinite beyond a bound."""
    if len(from_m) == 0 or len(to_m) == 0:
        return np.full(len(from_m), np.inf)
    # The tree leaves out what lies exactly at its bound.
    nearest_m, _ = cKDTree(to_m).query(from_m, distance_upper_bound=np.nextafter(at_most_m, np.inf))
    return np.asarray(nearest_m, dtype=np.float64)
