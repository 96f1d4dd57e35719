"""Compare points of the world with depth images: is there a surface, or does the ray pass through?"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from stillroom.compiled import njit
from stillroom.geometry import se3
from stillroom.geometry.arrays import F32, F64, I32, Floats
from stillroom.geometry.camera import Camera, Lens
from stillroom.geometry.distortion import distorted

NEAREST_M = 0.1
"""Points nearer to the camera, or behind it, are not seen."""


@dataclass(frozen=True)
class DepthView:
    """A depth image and where it was taken.

    Attributes:
        depth_m: Depth (H, W) float32 [m] on the pixels as taken; 0 where unknown.
        T_world_cam: Pose (4, 4).
    """

    depth_m: F32 = field(repr=False)
    T_world_cam: F64


@dataclass(frozen=True)
class DepthSightings:
    """What several depth images show at N points.

    Attributes:
        agree: How many of them have a surface where the point is (N,).
        passed: How many look through the place of the point at something behind it (N,).
    """

    agree: I32
    passed: I32


def sightings(
    points_world_m: Floats,
    views: Sequence[DepthView],
    camera: Camera,
    tolerance_m: float,
    tolerance_share: float,
    reach_px: int = 1,
) -> DepthSightings:
    """Compare every point with every view.

    Depth images are wrong by a pixel or two where one thing ends before another, and poses by as much. So a ray passes
    only if all known depths within `reach_px` of the point's pixel, the pixel included, lie behind the point; and a
    view agrees if any of these agrees.

    Args:
        points_world_m: The points (N, 3) [m, world].
        views: The images.
        camera: Their calibration.
        tolerance_m, tolerance_share: A surface is behind the point, or before it, when its depth differs from the
            point's by more than the first and by more than this share of the depth measured.
        reach_px: How many pixels around the point's own are compared.
    """
    points = np.ascontiguousarray(points_world_m, dtype=np.float64)
    agree, passed = np.zeros(len(points), dtype=np.int32), np.zeros(len(points), dtype=np.int32)
    for view in views:
        _ask(_taken(view, camera), points, tolerance_m, tolerance_share, reach_px, agree, passed)
    return DepthSightings(agree, passed)


def settled(
    points_world_m: Floats, views: Sequence[DepthView], camera: Camera, tolerance_m: float, tolerance_share: float
) -> F64:
    """Move points (N, 3) onto the mean of the surfaces that the views see near them, along the views' rays.

    A surface that noise has spread over several centimetres becomes one layer.

    Args:
        points_world_m: The points (N, 3) [m, world].
        views: The images.
        camera: Their calibration.
        tolerance_m, tolerance_share: A surface counts when its depth differs from the point's by no more than the
            first, or no more than this share of it.
    """
    points = np.ascontiguousarray(points_world_m, dtype=np.float64)
    total_m, count = np.zeros_like(points), np.zeros(len(points), dtype=np.int32)
    for view in views:
        pose = np.ascontiguousarray(view.T_world_cam)
        _add_offsets(_taken(view, camera), pose, points, tolerance_m, tolerance_share, total_m, count)
    return np.asarray(points + total_m / np.maximum(count, 1)[:, None])


class _Taken(NamedTuple):
    """`DepthView` as the kernels take it.

    Attributes:
        depth_m: Depth (H, W) float32 [m].
        T_cam_world: Pose (4, 4).
        lens: Of the camera.
        bounds_px: Extent of the undistorted image, x_min y_min x_max y_max [px]; beyond it the distortion model is not
            valid.
    """

    depth_m: F32
    T_cam_world: F64
    lens: Lens
    bounds_px: tuple[float, float, float, float]


def _taken(view: DepthView, camera: Camera) -> _Taken:
    T_cam_world = np.ascontiguousarray(se3.inverse(view.T_world_cam))
    return _Taken(np.ascontiguousarray(view.depth_m), T_cam_world, camera.lens, camera.undistorted_bounds_px)


@njit(nogil=True, cache=True)
def _seen_at(view: _Taken, X: float, Y: float, Z: float) -> tuple[float, int, int]:
    """Return a point's depth [m], and column and row [px] of the pixel that it falls on; −1 where on none."""
    T, lens = view.T_cam_world, view.lens
    z = T[2, 0] * X + T[2, 1] * Y + T[2, 2] * Z + T[2, 3]
    if not z > NEAREST_M:
        return z, -1, -1
    x = (T[0, 0] * X + T[0, 1] * Y + T[0, 2] * Z + T[0, 3]) / z
    y = (T[1, 0] * X + T[1, 1] * Y + T[1, 2] * Z + T[1, 3]) / z
    left, top, right, bottom = view.bounds_px
    if not (left <= lens.fx * x + lens.cx <= right and top <= lens.fy * y + lens.cy <= bottom):
        return z, -1, -1
    u, v = distorted(lens, x, y)
    return z, int(np.floor(u + 0.5)), int(np.floor(v + 0.5))


@njit(nogil=True, cache=True)
def _ask(
    view: _Taken,
    points_world_m: F64,
    tolerance_m: float,
    tolerance_share: float,
    reach_px: int,
    agree: I32,
    passed: I32,
) -> None:
    """Compare points (N, 3) with one depth image (H, W) and update `agree` and `passed` (N,); see `sightings`."""
    depth_m = view.depth_m
    height, width = depth_m.shape
    for i in range(len(points_world_m)):
        z, column, row = _seen_at(view, points_world_m[i, 0], points_world_m[i, 1], points_world_m[i, 2])
        if min(column, row) < reach_px or column >= width - reach_px or row >= height - reach_px:
            continue
        all_behind, any_there = depth_m[row, column] > 0.0, False
        for down in range(row - reach_px, row + reach_px + 1):
            for across in range(column - reach_px, column + reach_px + 1):
                seen = depth_m[down, across]
                if seen > 0.0:
                    tolerance = max(tolerance_m, tolerance_share * seen)
                    all_behind = all_behind and seen - z > tolerance
                    any_there = any_there or abs(seen - z) <= tolerance
        agree[i] += any_there
        passed[i] += all_behind


@njit(nogil=True, cache=True)
def _add_offsets(
    view: _Taken,
    T_world_cam: F64,
    points_world_m: F64,
    tolerance_m: float,
    tolerance_share: float,
    total_m: F64,
    count: I32,
) -> None:
    """Add the offset of each point (N, 3) to the surface that one image (H, W) sees near it; see `settled`."""
    depth_m = view.depth_m
    height, width = depth_m.shape
    for i in range(len(points_world_m)):
        z, column, row = _seen_at(view, points_world_m[i, 0], points_world_m[i, 1], points_world_m[i, 2])
        if min(column, row) < 0 or column >= width or row >= height:
            continue
        seen = depth_m[row, column]
        if seen > 0.0 and abs(seen - z) <= max(tolerance_m, tolerance_share * seen):
            for k in range(3):
                total_m[i, k] += (seen / z - 1.0) * (points_world_m[i, k] - T_world_cam[k, 3])
            count[i] += 1
