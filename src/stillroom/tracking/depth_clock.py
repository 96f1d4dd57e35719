"""Depth of keypoints at the time of the colour image, where a depth image was taken earlier or later.

A point x of the camera was at exp(τ ν) x when depth was taken, τ later: ν is the camera's velocity. There its depth is
looked up, and what it moved towards the camera since is added. A room that stands still is assumed, as tracking does;
the depth image itself stays as it was taken.
"""

from dataclasses import replace

import numpy as np

from stillroom.compiled import njit
from stillroom.data.frame import Frame
from stillroom.geometry.arrays import F32, F64
from stillroom.geometry.camera import Lens
from stillroom.geometry.distortion import distorted
from stillroom.optimize.observations import MIN_DEPTH_M

ROUNDS = 3
"""Looking up depth again, from where the last one puts the point."""


@njit(nogil=True, cache=True)
def depth_then(px: F32, depth_m: F32, image_m: F32, after_s: float, velocity: F64, lens: Lens) -> F32:
    """Return depths (N,) [m] of keypoints at the time of colour; 0 where none was measured.

    Args:
        px: Undistorted positions (N, 2) [px].
        depth_m: Depths (N,) [m] at the same pixels of the depth image; where they are 0 they stay so.
        image_m: The depth image (H, W) [m].
        after_s: How long after colour it was taken [s].
        velocity: Of the camera (6,) [m/s, rad/s], in its own frame: T_cam_world(t + τ) = exp(τ ν) T_cam_world(t).
        lens: Of the camera.
    """
    height, width = image_m.shape
    found_m = np.zeros(len(px), np.float32)
    a, b, c = after_s * velocity[3], after_s * velocity[4], after_s * velocity[5]
    for i in range(len(px)):
        z = float(depth_m[i])
        if not z > 0.0:
            continue
        ray_x, ray_y = (px[i, 0] - lens.cx) / lens.fx, (px[i, 1] - lens.cy) / lens.fy
        for _ in range(ROUNDS):
            x, y = ray_x * z, ray_y * z
            dx, dy, dz = b * z - c * y, c * x - a * z, a * y - b * x
            x2 = x + dx + 0.5 * (b * dz - c * dy) + after_s * velocity[0]
            y2 = y + dy + 0.5 * (c * dx - a * dz) + after_s * velocity[1]
            z2 = z + dz + 0.5 * (a * dy - b * dx) + after_s * velocity[2]
            if not z2 > MIN_DEPTH_M:
                z = 0.0
                break
            u, v = distorted(lens, x2 / z2, y2 / z2)
            column, row = int(np.rint(u)), int(np.rint(v))
            inside = 0 <= column < width and 0 <= row < height
            seen = float(image_m[row, column]) if inside else 0.0
            if not seen > 0.0:
                z = 0.0
                break
            z += seen - z2
            if not z > MIN_DEPTH_M:
                z = 0.0
                break
        found_m[i] = z
    return found_m


def with_depth_in_time(frame: Frame, after_s: float, velocity: F64) -> Frame:
    """Return a frame whose keypoints have the depth of its own time; as it is where nothing is to be corrected.

    Args:
        frame: The frame, its keypoints at mid-frame.
        after_s: How long after it depth was taken [s].
        velocity: Of the camera (6,) [m/s, rad/s]; 0 where it is not known.
    """
    if after_s == 0.0 or not velocity.any():
        return frame
    kp, camera = frame.keypoints, frame.camera
    depth_m = depth_then(kp.px, kp.depth_m, frame.image.depth_m, after_s, velocity, camera.lens)
    right_px = camera.right_coordinate(kp.px[:, 0], depth_m)
    return replace(frame, keypoints=replace(kp, depth_m=depth_m, right_px=right_px))
