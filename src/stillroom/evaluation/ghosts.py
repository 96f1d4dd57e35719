"""How clean and how complete a dense map is: the ghosts of people in it, and the share of the room that it covers.

A map is a set of points, of any method. It is compared with one of two references:

- `ghost_truth`: rendered sequences, whose surfaces are known exactly;
- free space, here: real sequences in which the room is first seen empty. What those first images saw through is free
  space; points there of a map made of later images are ghosts.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from stillroom.evaluation.ghost_views import DepthView, settled, sightings
from stillroom.evaluation.trajectory_errors import Statistics
from stillroom.geometry import se3
from stillroom.geometry.arrays import F32, F64, I64, Bool, Floats
from stillroom.geometry.camera import Camera

WITHIN_M = 0.05
BITS = 21
"""Of each coordinate of a cell in its key."""
MERGE_ABOVE = 4_000_000
SETTLING = 2
"""Steps after which the surface of the empty room no longer moves."""


@dataclass(frozen=True)
class GhostFigure:
    """The ghosts in a map: points left by people and objects that moved.

    Attributes:
        n_points: Points of the map.
        n_ghosts: Those that are ghosts.
        n_suspects: Those that rays alone would call ghosts; agreeing surfaces cleared some of them.
        is_ghost: Which (N,).
    """

    n_points: int
    n_ghosts: int
    n_suspects: int
    is_ghost: Bool = field(repr=False)

    @classmethod
    def of(cls, is_ghost: Bool, n_suspects: int) -> "GhostFigure":
        """Count the ghosts (N,)."""
        return cls(len(is_ghost), int(is_ghost.sum()), n_suspects, is_ghost)

    @property
    def share(self) -> float:
        """Ghosts per point, 0 to 1; 0 for a map without points, whose completeness is 0."""
        return self.n_ghosts / self.n_points if self.n_points else 0.0

    def to_dict(self) -> dict[str, Any]:
        """Return the figure for a JSON file."""
        counts = {"n_points": self.n_points, "n_ghosts": self.n_ghosts, "n_suspects": self.n_suspects}
        return counts | {"share": self.share}


@dataclass(frozen=True)
class CompletenessFigure:
    """How much of a surface a map covers.

    Attributes:
        n_points: Points of the surface.
        n_found: Those near which the map has a point.
        within_m: How near [m].
        is_found: Which (N,).
    """

    n_points: int
    n_found: int
    within_m: float
    is_found: Bool = field(repr=False)

    @property
    def share(self) -> float:
        """Found per point of the surface, 0 to 1; 0 where there is no surface to find."""
        return self.n_found / self.n_points if self.n_points else 0.0

    def to_dict(self) -> dict[str, Any]:
        """Return the figure for a JSON file."""
        return {"n_points": self.n_points, "n_found": self.n_found, "within_m": self.within_m, "share": self.share}


@dataclass(frozen=True)
class SurfaceFigure:
    """How far a map's points lie from the true surface.

    Attributes:
        error_m: Distances [m] of the points that are no ghosts; None where there are none.
        n_astray: Points off the surface where nothing moved: noise, and wrong poses.
    """

    error_m: Statistics | None
    n_astray: int

    def to_dict(self) -> dict[str, Any]:
        """Return the figure for a JSON file."""
        return asdict(self)


# How much of a surface a map covers.


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
    from scipy.spatial import cKDTree

    # The tree leaves out what lies exactly at its bound.
    nearest_m, _ = cKDTree(to_m).query(from_m, distance_upper_bound=np.nextafter(at_most_m, np.inf))
    return np.asarray(nearest_m, dtype=np.float64)


# Surfaces gathered from depth images: at most one point in each cell of a grid.


class Gatherer:
    """Collects what depth images see, as the mean position in each cell of a grid.

    Knows also in how many images each cell was seen, which tells a surface from a stray pixel.
    """

    def __init__(self, camera: Camera, voxel_m: float = 0.02, stride: int = 2) -> None:
        """Start empty.

        Args:
            camera: The images' calibration.
            voxel_m: Edge of the cells [m].
            stride: 2 takes every second pixel of every second row.
        """
        self._voxel_m, self._stride = voxel_m, stride
        rows, columns = np.mgrid[0 : camera.height : stride, 0 : camera.width : stride]
        px = camera.undistort(np.stack((columns.ravel(), rows.ravel()), axis=1).astype(np.float32))
        self._rays = camera.back_project(px, np.ones(len(px)))
        self._pending = [_summed(np.zeros((0, 3), dtype=np.int64), np.zeros((0, 3)))]

    def add(self, depth_m: F32, T_world_cam: F64, keep: Bool | None = None, reach_m: float = np.inf) -> None:
        """Take an image's surface.

        Args:
            depth_m: Depth (H, W) [m]; 0 where unknown.
            T_world_cam: Its pose (4, 4).
            keep: Which pixels (H, W) to take; all by default.
            reach_m: Depths beyond are left out [m].
        """
        small_m = depth_m[:: self._stride, :: self._stride]
        taken = (small_m > 0) & (small_m <= reach_m)
        if keep is not None:
            taken &= keep[:: self._stride, :: self._stride]
        points_cam = self._rays[taken.ravel()] * small_m[taken].astype(np.float64)[:, None]
        points = se3.transform(T_world_cam, points_cam)
        self._pending.append(_summed(np.floor(points / self._voxel_m).astype(np.int64), points))
        if sum(len(cells.key) for cells in self._pending[1:]) > MERGE_ABOVE:
            self._pending = [_merged(self._pending)]

    def points(self, seen_by: int = 1) -> F64:
        """Return the mean positions (N, 3) [m, world] in the cells that at least `seen_by` images saw."""
        self._pending = [cells := _merged(self._pending)]
        chosen = cells.n_images >= seen_by
        return np.asarray(cells.total_m[chosen] / cells.n_points[chosen, None])


def thinned(points_m: Floats, voxel_m: float) -> F64:
    """Return the means (M, 3) of the points (N, 3) in each cell of a grid."""
    cells = _summed(np.floor(points_m / voxel_m).astype(np.int64), points_m)
    return np.asarray(cells.total_m / cells.n_points[:, None])


@dataclass(frozen=True)
class _Cells:
    """Cells by rising key (N,): sums of the points in them (N, 3), and numbers of those and of their images (N,)."""

    key: I64
    total_m: F64
    n_points: I64
    n_images: I64


def _summed(cell: I64, points: Floats) -> _Cells:
    """Sum up the points (N, 3) of one image by their cells (N, 3)."""
    half = 1 << (BITS - 1)
    x, y, z = (np.clip(cell, -half, half - 1) + half).T
    ones = np.ones(len(cell), dtype=np.int64)
    cells = _grouped(x << 2 * BITS | y << BITS | z, points, ones, ones)
    return _Cells(cells.key, cells.total_m, cells.n_points, np.ones_like(cells.n_points))


def _merged(parts: list[_Cells]) -> _Cells:
    return _grouped(
        np.concatenate([part.key for part in parts]),
        np.concatenate([part.total_m for part in parts]),
        np.concatenate([part.n_points for part in parts]),
        np.concatenate([part.n_images for part in parts]),
    )


def _grouped(key: I64, total_m: Floats, n_points: I64, n_images: I64) -> _Cells:
    order = np.argsort(key, kind="stable")
    ordered = key[order]
    first = np.flatnonzero(np.diff(ordered, prepend=-1))  # keys are not negative
    if len(first) == 0:
        return _Cells(key, np.asarray(total_m, dtype=np.float64), n_points, n_images)
    return _Cells(
        ordered[first],
        np.add.reduceat(np.asarray(total_m, dtype=np.float64)[order], first, axis=0),
        np.add.reduceat(n_points[order], first),
        np.add.reduceat(n_images[order], first),
    )


# Ghosts in real maps: points where earlier images, of the same room without people, looked through at something.
#
# The map is made of later images than those, and by poses of the same run, so both are in one frame. The earlier ones
# must never have been used for carving the map, or for anything but their poses.
#
# Rays alone do not make a ghost. A Kinect's depth is wrong by several per cent towards its image's corners, so of a
# wall
# that is seen by the corner in one image and by the middle in another, some rays always seem to pass behind the surface
# that others have measured. A point on which earlier images agree is no ghost, whatever passes it.


@dataclass(frozen=True)
class FreeSpaceConfig:
    """When a point is a ghost, and what the room is made of.

    Attributes:
        tolerance_m, tolerance_share: A ray passes a point by more than the first and more than this share of its
            depth.
        min_rays: At least this many images must have a ray that passes …
        may_agree: … and at most this many find a surface at the point.
        doubt: A surface is at the point when they differ by no more than the tolerance times this: the point is a
            measurement too, and may be as wrong as the surface, the other way.
        reach_px: All known depths within this many pixels of the ray must lie behind the point too.
        voxel_m: Sampling distance of the empty room [m].
        seen_by: A surface of the room was seen by at least this many images of the room …
        again_by: … and again by at least this many of those that the map is made of.
        reach_m: Surfaces further from the camera are left out [m]: their depth is too uncertain.
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
    """Return the part of a surface (N, 3) that later images see too: a map cannot cover what was not in view.

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
