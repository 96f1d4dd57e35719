"""Ghosts in real maps: points where earlier images, of the same room without people, looked through at something.

The map is made of later images than those, and by poses of the same run, so both are in one frame. The earlier ones
must never have been used for carving the map, or for anything but their poses.

Rays alone do not make a ghost. A Kinect's depth is wrong by several per cent towards its image's corners, so of a wall
that is seen by the corner in one image and by the middle in another, some rays always seem to pass behind the surface
that others have measured. A point on which earlier images agree is no ghost, whatever passes it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stillroom.evaluation.ghosts.figures import GhostFigure
from stillroom.evaluation.ghosts.gathering import Gatherer, thinned
from stillroom.evaluation.ghosts.views import DepthView, settled, sightings
from stillroom.geometry.arrays import F64, Floats
from stillroom.geometry.camera import Camera

SETTLING = 2
"""Steps after which the surface of the empty room no longer moves."""


@dataclass(frozen=True)
class FreeSpaceConfig:
    """When a point is a ghost, and what the room is made of.

    Attributes:
        tolerance_m, tolerance_share: A ray passes a point by more than the first and more than this share of its
            depth.
        min_rays: So many images must have a ray that passes …
        may_agree: … and no more than so many find a surface at the point.
        doubt: A surface is at the point when they differ by no more than the tolerance times this: the point is a
            measurement too, and may be as wrong as the surface, the other way.
        reach_px: All within so many pixels of the ray that the image knows must lie behind the point too.
        voxel_m: The empty room is sampled so finely [m].
        seen_by: A surface of the room was seen by so many images of the room …
        again_by: … and again by so many of those that the map is made of.
        reach_m: Surfaces further from the camera are left out [m]: their depth is too uncertain to ask for.
    """

    tolerance_m: float = 0.05
    tolerance_share: float = 0.03
    min_rays: int = 3
    may_agree: int = 2
    doubt: float = 2.0
    reach_px: int = 1
    voxel_m: float = 0.04
    seen_by: int = 6
    again_by: int = 3
    reach_m: float = 5.0


def ghosts_in_free_space(
    points_m: Floats, reference: Sequence[DepthView], camera: Camera, config: FreeSpaceConfig | None = None
) -> GhostFigure:
    """Find the points of a map that lie where images of the empty room saw nothing.

    Args:
        points_m: The map (N, 3) [m, world].
        reference: Images of the empty room, some time apart, with poses in the map's world.
        camera: Their calibration.
        config: When a point is a ghost.
    """
    config = config or FreeSpaceConfig()
    tolerance = config.tolerance_m, config.tolerance_share
    is_passed = sightings(points_m, reference, camera, *tolerance, config.reach_px).passed >= config.min_rays
    suspects = np.asarray(points_m)[is_passed]
    wide = config.doubt * config.tolerance_m, config.doubt * config.tolerance_share
    is_ghost = is_passed.copy()
    is_ghost[is_passed] = sightings(suspects, reference, camera, *wide, config.reach_px).agree <= config.may_agree
    return GhostFigure.of(is_ghost, int(is_passed.sum()))


def empty_room(reference: Sequence[DepthView], camera: Camera, config: FreeSpaceConfig | None = None) -> F64:
    """Return the surface of the empty room (N, 3) [m, world] as its images saw it, a point in each cell of a grid.

    Where they differ, it lies in their middle.
    """
    config = config or FreeSpaceConfig()
    gatherer = Gatherer(camera, config.voxel_m)
    for view in reference:
        gatherer.add(view.depth_m, view.T_world_cam, reach_m=config.reach_m)
    surface_m = gatherer.points(config.seen_by)
    wide = config.doubt * config.tolerance_m, config.doubt * config.tolerance_share
    for _ in range(SETTLING):
        surface_m = settled(surface_m, reference, camera, *wide)
    return thinned(surface_m, config.voxel_m)


def seen_again(
    surface_m: Floats, views: Sequence[DepthView], camera: Camera, config: FreeSpaceConfig | None = None
) -> F64:
    """Return the part of a surface (N, 3) that later images see too: no map can hold what nobody looks at.

    What stands before it, or was moved away since, is not seen again.

    Args:
        surface_m: The surface (M, 3) [m, world].
        views: Images that the map was made of, or could have been.
        camera: Their calibration.
        config: By how many images it must be seen.
    """
    config = config or FreeSpaceConfig()
    near = [DepthView(np.where(view.depth_m <= config.reach_m, view.depth_m, 0), view.T_world_cam) for view in views]
    seen = sightings(surface_m, near, camera, config.tolerance_m, config.tolerance_share, reach_px=0)
    return np.asarray(surface_m, dtype=np.float64)[seen.agree >= config.again_by]
