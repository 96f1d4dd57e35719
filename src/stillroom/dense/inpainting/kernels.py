"""Loops over the pixels of keyframes that are brought into another image."""

import numpy as np
from numba import njit

from stillroom.geometry.arrays import F32, F64, I64, U8

LEAST_SHARE = 0.05
"""A pixel takes part of a point when at least this share of it falls on it."""


@njit(nogil=True, cache=True, error_model="numpy")
def distorted(x: float, y: float, lens: F64) -> tuple[float, float]:
    """Return the pixel, as taken, of a ray at unit depth; the lens is fx fy cx cy k1 k2 p1 p2 k3 (9,)."""
    k1, k2, p1, p2, k3 = lens[4], lens[5], lens[6], lens[7], lens[8]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    u = lens[0] * (x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)) + lens[2]
    v = lens[1] * (y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y) + lens[3]
    return u, v


@njit(nogil=True, cache=True, error_model="numpy")
def splat_depth(
    depth_m: F32, rays: F32, window: I64, T_here_there: F64, lens: F64, min_depth_m: float, wanted: U8, nearest_m: F32
) -> None:
    """Keep in `nearest_m` (H, W) the nearest depth that a keyframe brings to each wanted pixel.

    Args:
        depth_m: The keyframe's usable depths (H, W); 0 elsewhere.
        rays: Rays of the pixels at unit depth (H, W, 2).
        window: First row, last row, first column, last column, each last one excluded, to look at (4,).
        T_here_there: Pose of the keyframe's camera in the present one (4, 4).
        lens: See `distorted`.
        min_depth_m: Nearer than this is not believed.
        wanted: Which pixels are to be painted (H, W), 0 or 1.
        nearest_m: Depths so far; infinite where nothing was brought.
    """
    T, (height, width) = T_here_there, depth_m.shape
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
            u, v = distorted(x, y, lens)
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
    rgb: U8,
    depth_m: F32,
    rays: F32,
    window: I64,
    T_here_there: F64,
    lens: F64,
    min_depth_m: float,
    same_share: float,
    weight: float,
    gain: F32,
    nearest_m: F32,
    total: F32,
) -> None:
    """Add a keyframe's colours and depths to the pixels whose nearest surface they show, by bilinear shares.

    Args:
        rgb: The keyframe's colours (H, W, 3).
        depth_m, rays, window, T_here_there, lens, min_depth_m: As in `splat_depth`.
        same_share: What lies behind the nearest by no more than this share of its depth is the same surface.
        weight: Of this keyframe.
        gain: What its red, green and blue are multiplied by (3,).
        nearest_m: The nearest depths (H, W) of all keyframes; infinite where nothing is wanted.
        total: Sums of red, green, blue, depth and one, weighted, and of one without weights (H, W, 6).
    """
    T, (height, width) = T_here_there, depth_m.shape
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
            u, v = distorted(x, y, lens)
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
def splat_cloud(
    positions_m: F32,
    colours: U8,
    T_cam_world: F64,
    lens: F64,
    size_m: float,
    min_depth_m: float,
    is_hole: U8,
    rgb: U8,
    depth_m: F32,
) -> None:
    """Draw the points (N, 3) of a dense map as squares where there are holes, the nearest in front.

    Args:
        positions_m, colours: The points and their colours (N, 3).
        T_cam_world: The present pose (4, 4).
        lens: See `distorted`.
        size_m: Edge of a point's cube.
        min_depth_m: Nearer than this is not drawn.
        is_hole: Where to draw (H, W), 0 or 1; drawn pixels become 2.
        rgb, depth_m: Drawn into, (H, W, 3) and (H, W).
    """
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
        u, v = distorted(x, y, lens)
        reach = 0.6 * size_m * lens[0] / z
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
