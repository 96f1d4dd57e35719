"""Ghosts in maps of rendered sequences, whose surfaces are known exactly."""

from dataclasses import dataclass, field

import numpy as np

from stillroom.evaluation.ghosts.completeness import distances_m
from stillroom.evaluation.ghosts.figures import GhostFigure, SurfaceFigure
from stillroom.evaluation.ghosts.patches import distances_to_patches_m
from stillroom.evaluation.trajectory_errors import Statistics
from stillroom.geometry.arrays import F64, Bool, Floats


@dataclass(frozen=True)
class TrueScene:
    """What a renderer knows of a sequence, in its world.

    Attributes:
        patches_m: The static surface, exactly: corner and two edges of parallelograms and triangles (Q, 9) [m].
        is_triangle: Which of them are triangles (Q,).
        seen_m: The part of it that the camera saw, sampled evenly (M, 3) [m].
        movers_m: Where the camera saw figures, and things before and while they were moved, sampled (L, 3) [m].
    """

    patches_m: F64 = field(repr=False)
    is_triangle: Bool = field(repr=False)
    seen_m: F64 = field(repr=False)
    movers_m: F64 = field(repr=False)


@dataclass(frozen=True)
class TruthConfig:
    """When a point is a ghost.

    Attributes:
        off_m: It lies further than this from the static surface [m] …
        near_mover_m: … and no further than this from where a mover was seen [m]: noise of the depth, and the steps
            of a mover from image to image.
    """

    off_m: float = 0.05
    near_mover_m: float = 0.10


def ghosts_by_truth(
    points_m: Floats, scene: TrueScene, config: TruthConfig | None = None
) -> tuple[GhostFigure, SurfaceFigure]:
    """Find the points of a map that are off the static surface where a mover was, and how exact the others are.

    Args:
        points_m: The map (N, 3) [m], in the renderer's world.
        scene: What the renderer knows.
        config: When a point is a ghost.
    """
    config = config or TruthConfig()
    error_m = distances_to_patches_m(points_m, scene.patches_m, scene.is_triangle)
    is_off = error_m > config.off_m
    is_ghost = np.zeros(len(points_m), dtype=np.bool_)
    near_m = distances_m(np.asarray(points_m)[is_off], scene.movers_m, config.near_mover_m)
    is_ghost[is_off] = near_m <= config.near_mover_m
    rest_m = error_m[~is_ghost]
    surface = SurfaceFigure(Statistics.of(rest_m) if len(rest_m) else None, int((is_off & ~is_ghost).sum()))
    return GhostFigure.of(is_ghost, int(is_off.sum())), surface
