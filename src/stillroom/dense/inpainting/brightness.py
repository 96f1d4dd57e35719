"""How much brighter a frame is than a keyframe: cameras set their exposure and white balance as people come and go."""

import numpy as np

from stillroom.data.image import RgbdImage
from stillroom.geometry import se3
from stillroom.geometry.arrays import F32, F64, U8, Bool
from stillroom.geometry.camera import Camera

EVERY_PX = 8
FEWEST = 100
DARKEST, BRIGHTEST = 20, 235
SAME_SHARE = 0.05
MOST = 2.0


def gains(rgb: U8, depth_m: F32, rays: F32, T_here_there: F64, camera: Camera, here: RgbdImage, still: Bool) -> F32:
    """Return what a keyframe's red, green and blue are multiplied by to look as in a frame (3,); ones where unknown.

    The median over a grid of the keyframe's pixels that the frame shows at the same depth, neither black nor white.

    Args:
        rgb, depth_m: The keyframe's colours (H, W, 3) and usable depths (H, W).
        rays: Rays of the pixels at unit depth (H, W, 2).
        T_here_there: Pose of the keyframe's camera in the frame's (4, 4).
        camera: The calibration of both.
        here: The frame.
        still: Its pixels that do not move (H, W).
    """
    grid = slice(EVERY_PX // 2, None, EVERY_PX)
    z_m = depth_m[grid, grid].ravel().astype(np.float64)
    colours = rgb[grid, grid].reshape(-1, 3).astype(np.float64)
    points = np.column_stack((rays[grid, grid].reshape(-1, 2) * z_m[:, None], z_m))
    points = se3.transform(T_here_there, points)
    ahead = (z_m > 0) & (points[:, 2] > 0.1)
    points, colours = points[ahead], colours[ahead]
    column, row = np.rint(camera.distort(camera.project(points))).T
    inside = (column >= 0) & (row >= 0) & (column < camera.width) & (row < camera.height)
    column, row = column[inside].astype(np.int64), row[inside].astype(np.int64)
    points, colours = points[inside], colours[inside]
    seen_m, seen = here.depth_m[row, column], here.rgb[row, column].astype(np.float64)
    same = still[row, column] & (np.abs(seen_m - points[:, 2]) < SAME_SHARE * points[:, 2])
    for each in (colours, seen):
        same &= (each.min(axis=1) > DARKEST) & (each.max(axis=1) < BRIGHTEST)
    if np.count_nonzero(same) < FEWEST:
        return np.ones(3, dtype=np.float32)
    ratio = np.median(seen[same] / colours[same], axis=0)
    return np.asarray(np.clip(ratio, 1.0 / MOST, MOST), dtype=np.float32)
