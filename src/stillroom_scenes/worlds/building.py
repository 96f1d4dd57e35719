"""A scene of many cells: of a building, only what can be seen from where the camera is gets rendered."""

from dataclasses import dataclass

import numpy as np

from stillroom.geometry.arrays import F64
from stillroom.geometry.camera import Camera
from stillroom_scenes.render import Scene
from stillroom_scenes.scene.patches import Patches, concatenate
from stillroom_scenes.worlds.plan import Plan

FIGURE_REACH_M = 0.8


@dataclass(frozen=True)
class BuildingScene(Scene):
    """A building.

    Attributes:
        plan: Its cells.
        still_of: The still patches of each cell; `still` has them all.
    """

    plan: Plan
    still_of: tuple[Patches, ...]

    def seen(self, camera: Camera, T_world_cam: F64, time_s: float) -> Patches:
        """Return the patches of the cells in view, and of the figures in them."""
        seen = self.plan.seen(camera, T_world_cam)
        parts = [self.still_of[cell] for cell in seen]
        for figure in self.figures:
            place = figure.script.at(time_s)
            away_m = min(self.plan.cells[cell].distance_m(place.x_m, place.y_m) for cell in seen)
            if away_m < FIGURE_REACH_M and _is_ahead(T_world_cam, place.x_m, place.y_m):
                parts.append(figure.patches(time_s))
        parts += [thing.patches(time_s) for thing in self.objects]
        return concatenate(parts)


def _is_ahead(T_world_cam: F64, x_m: float, y_m: float) -> bool:
    """Return whether some of a figure at a place may be before the camera, however that is tilted."""
    towards = np.array([x_m - T_world_cam[0, 3], y_m - T_world_cam[1, 3]])
    forward = T_world_cam[:2, 2]
    tilt = abs(float(T_world_cam[2, 2]))
    return bool(towards @ forward > -FIGURE_REACH_M - 2.0 * tilt)
