"""Kernels that warp keyframes into another image."""

from typing import NamedTuple

import numpy as np

from stillroom.compiled import njit
from stillroom.geometry.arrays import F32, F64, I64, U8
from stillroom.geometry.camera import Lens
from stillroom.geometry.distortion import distorted

LEAST_SHARE = 0.05
"""A pixel takes part of a point when at least this share of it falls on it."""


class Surface(NamedTuple):
    """The surfaces that a keyframe saw.

    Attributes:
        depth_m: The keyframe's usable depths (H, W); 0 elsewhere.
        rays: Rays of the pixels at unit depth (H, W, 2).
        window: First row, last row, first column, last column, each last one excluded, to look at (4,).
        T_here_there: Pose of the keyframe's camera in the present one (4, 4).
    """

    depth_m: F32
    rays: F32
    window: I64
    T_here_there: F64


class Paint(NamedTuple):
    """The colours that a keyframe saw.

    Attributes:
        rgb: They (H, W, 3).
        gain: What red, green and blue are multiplied by (3,).
        weight: Of this keyframe.
    """

    rgb: U8
    gain: F32
    weight: float


class Cubes(NamedTuple):
    """The points (N, 3) [m, world] of a dense map, their colours (N, 3), and the edge of each one's cube [m]."""

    positions_m: F32
    colours: U8
    size_m: float


class Canvas(NamedTuple):
    """What is drawn into.

    Attributes:
        is_hole: Where to draw (H, W), 0 or 1; drawn pixels become 2.
        rgb, depth_m: The picture (H, W, 3) and (H, W).
    """

    is_hole: U8
    rgb: U8
    depth_m: F32


@njit(nogil=True, cache=True, error_model="numpy")
def splat_depth(surface: Surface, lens: Lens, min_depth_m: float, wanted: U8, nearest_m: F32) -> None:
    """Keep in `nearest_m` (H, W) the nearest depth of a keyframe projected to each wanted pixel.

    Args:
        surface: What the keyframe saw.
        lens: Of the camera.
        min_depth_m: Nearer depths are ignored.
        wanted: Which pixels are to be painted (H, W), 0 or 1.
        nearest_m: Depths so far; infinite where nothing was brought.
    """
    depth_m, rays, window, T = surface
    height, width = depth_m.shape
    for row in range(window[0], window[1]):
        for column in range(window[2], window[3]):
            d = float(depth_m[row, column])
            if d <= 0.0:
                continue
            X, Y = rays[row, column, 0] * d, rays[row, column, 1] * d
            z = T[2, 0] * X + T[2, 1] * Y + T[2, 2] * d + T[2, 3]
            if z < min_depth_m:
                continue
            x = (T[0, 0] * X + T[0, 1] * Y + T[0, 2] * d + T[0, 3]) / z
            y = (T[1, 0] * X + T[1, 1] * Y + T[1, 2] * d + T[1, 3]) / z
            u, v = distorted(lens, x, y)
            if not (u >= 0.0 and v >= 0.0 and u < width - 1 and v < height - 1):
                continue
            left, top = int(u), int(v)
            for k in range(4):
                q, p = top + (k >> 1), left + (k & 1)
                share = (1.0 - abs(u - p)) * (1.0 - abs(v - q))
                if wanted[q, p] != 0 and share >= LEAST_SHARE and z < nearest_m[q, p]:
                    nearest_m[q, p] = z


@njit(nogil=True, cache=True, error_model="numpy")
def splat_colour(
    surface: Surface, paint: Paint, lens: Lens, min_depth_m: float, same_share: float, nearest_m: F32, total: F32
) -> None:
    """Add a keyframe's colours and depths to the pixels whose nearest surface they show, by bilinear shares.

    Args:
        surface, lens, min_depth_m: As in `splat_depth`.
        paint: The keyframe's colours.
        same_share: What lies behind the nearest by no more than this share of its depth is the same surface.
        nearest_m: The nearest depths (H, W) of all keyframes; infinite where nothing is wanted.
        total: Sums of red, green, blue, depth and one, weighted, and of one without weights (H, W, 6).
    """
    depth_m, rays, window, T = surface
    rgb, gain, weight = paint
    height, width = depth_m.shape
    for row in range(window[0], window[1]):
        for column in range(window[2], window[3]):
            d = float(depth_m[row, column])
            if d <= 0.0:
                continue
            X, Y = rays[row, column, 0] * d, rays[row, column, 1] * d
            z = T[2, 0] * X + T[2, 1] * Y + T[2, 2] * d + T[2, 3]
            if z < min_depth_m:
                continue
            x = (T[0, 0] * X + T[0, 1] * Y + T[0, 2] * d + T[0, 3]) / z
            y = (T[1, 0] * X + T[1, 1] * Y + T[1, 2] * d + T[1, 3]) / z
            u, v = distorted(lens, x, y)
            if not (u >= 0.0 and v >= 0.0 and u < width - 1 and v < height - 1):
                continue
            left, top = int(u), int(v)
            for k in range(4):
                q, p = top + (k >> 1), left + (k & 1)
                near = nearest_m[q, p]
                if near < np.inf and z <= near * (1.0 + same_share):
                    part = (1.0 - abs(u - p)) * (1.0 - abs(v - q))
                    share = weight * part
                    total[q, p, 5] += part
                    total[q, p, 0] += share * gain[0] * rgb[row, column, 0]
                    total[q, p, 1] += share * gain[1] * rgb[row, column, 1]
                    total[q, p, 2] += share * gain[2] * rgb[row, column, 2]
                    total[q, p, 3] += share * z
                    total[q, p, 4] += share


@njit(nogil=True, cache=True, error_model="numpy")
def splat_cloud(cubes: Cubes, T_cam_world: F64, lens: Lens, min_depth_m: float, canvas: Canvas) -> None:
    """Draw the points of a dense map as squares where there are holes, the nearest in front.

    Args:
        cubes: The points.
        T_cam_world: The present pose (4, 4).
        lens: Of the camera.
        min_depth_m: Nearer than this is not drawn.
        canvas: Drawn into.
    """
    positions_m, colours, size_m = cubes
    is_hole, rgb, depth_m = canvas
    T, (height, width) = T_cam_world, depth_m.shape
    for i in range(len(positions_m)):
        X, Y, Z = positions_m[i, 0], positions_m[i, 1], positions_m[i, 2]
        z = T[2, 0] * X + T[2, 1] * Y + T[2, 2] * Z + T[2, 3]
        if z < min_depth_m:
            continue
        x = (T[0, 0] * X + T[0, 1] * Y + T[0, 2] * Z + T[0, 3]) / z
        y = (T[1, 0] * X + T[1, 1] * Y + T[1, 2] * Z + T[1, 3]) / z
        if abs(x) > 2.0 or abs(y) > 2.0:
            continue
        u, v = distorted(lens, x, y)
        reach = 0.6 * size_m * lens.fx / z
        first_row, last_row = max(0, int(np.ceil(v - reach))), min(height - 1, int(np.floor(v + reach)))
        first_column, last_column = max(0, int(np.ceil(u - reach))), min(width - 1, int(np.floor(u + reach)))
        for row in range(first_row, last_row + 1):
            for column in range(first_column, last_column + 1):
                state = is_hole[row, column]
                if state == 1 or (state == 2 and z < depth_m[row, column]):
                    is_hole[row, column] = 2
                    depth_m[row, column] = z
                    for c in range(3):
                        rgb[row, column, c] = colours[i, c]
