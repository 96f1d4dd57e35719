"""Which pixels of a small depth image lie on a surface, and how it is turned."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stillroom.geometry.arrays import F32, U8, U16

I8 = NDArray[np.int8]
NORMAL_SCALE = 127.0
STEP_TOLERANCE_M = 0.02
STEP_TOLERANCE_PER_M = 0.0065  # times z²: about three deviations of the difference of two Kinect depths
SLOPE_PER_PX = 0.01  # relative change of depth from pixel to pixel of a surface that is still worth a normal
FEWEST_ALIKE = 5  # of eight neighbours: a straight edge leaves five, a pixel in the air between two surfaces fewer
LONGEST_REACH_PX = 5


@njit(nogil=True, cache=True, error_model="numpy")
def find_surfaces(depth_m: F32, rays: F32, near_m: float, far_m: float, least_cosine: float, usable: U8) -> I8:
    """Clear `usable` where no surface can be told, and return normals (h, w, 3), camera frame, unit length 127.

    A pixel goes when it is out of range, when too few of its neighbours lie at its depth (edges, and points in the air
    between two surfaces), or when it is seen at a grazing angle. The normal is the cross product of differences that
    reach further where depth is noisier.

    Args:
        depth_m: Depths (h, w), 0 where unknown.
        rays: x/z and y/z of each pixel (h, w, 2).
        near_m, far_m: Range of depth.
        least_cosine: Of the angle between normal and ray.
        usable: Pixels to look at (h, w), 0 or 1; changed in place.
    """
    height, width = depth_m.shape
    normals = np.zeros((height, width, 3), dtype=np.int8)
    for y in range(height):
        for x in range(width):
            if usable[y, x] == 0:
                continue
            usable[y, x] = 0
            z = depth_m[y, x]
            if not (near_m <= z <= far_m):
                continue
            tolerance = np.float32(max(STEP_TOLERANCE_M, STEP_TOLERANCE_PER_M * z * z))
            alike = 0
            for v in range(max(0, y - 1), min(height, y + 2)):
                for u in range(max(0, x - 1), min(width, x + 2)):
                    alike += 1 if abs(depth_m[v, u] - z) <= tolerance else 0
            if alike - 1 < FEWEST_ALIKE:
                continue
            reach = min(LONGEST_REACH_PX, 1 + int(z))
            loose = tolerance + np.float32(SLOPE_PER_PX) * z * np.float32(reach)
            left, right = x, x
            if x >= reach and abs(depth_m[y, x - reach] - z) <= loose:
                left = x - reach
            elif x >= 1 and abs(depth_m[y, x - 1] - z) <= loose:
                left = x - 1
            if x + reach < width and abs(depth_m[y, x + reach] - z) <= loose:
                right = x + reach
            elif x + 1 < width and abs(depth_m[y, x + 1] - z) <= loose:
                right = x + 1
            above, below = y, y
            if y >= reach and abs(depth_m[y - reach, x] - z) <= loose:
                above = y - reach
            elif y >= 1 and abs(depth_m[y - 1, x] - z) <= loose:
                above = y - 1
            if y + reach < height and abs(depth_m[y + reach, x] - z) <= loose:
                below = y + reach
            elif y + 1 < height and abs(depth_m[y + 1, x] - z) <= loose:
                below = y + 1
            if left == right or above == below:
                continue
            zl, zr, za, zb = depth_m[y, left], depth_m[y, right], depth_m[above, x], depth_m[below, x]
            ax = rays[y, right, 0] * zr - rays[y, left, 0] * zl
            ay = rays[y, right, 1] * zr - rays[y, left, 1] * zl
            az = zr - zl
            bx = rays[below, x, 0] * zb - rays[above, x, 0] * za
            by = rays[below, x, 1] * zb - rays[above, x, 1] * za
            bz = zb - za
            # y × x points towards the camera, for x is right and y is down.
            nx, ny, nz = by * az - bz * ay, bz * ax - bx * az, bx * ay - by * ax
            length = np.sqrt(nx * nx + ny * ny + nz * nz)
            rx, ry = rays[y, x, 0], rays[y, x, 1]
            cosine = -(nx * rx + ny * ry + nz) / (length * np.sqrt(rx * rx + ry * ry + np.float32(1.0)))
            if not cosine >= least_cosine:
                continue
            scale = np.float32(NORMAL_SCALE) / length
            normals[y, x, 0] = np.int8(np.rint(nx * scale))
            normals[y, x, 1] = np.int8(np.rint(ny * scale))
            normals[y, x, 2] = np.int8(np.rint(nz * scale))
            usable[y, x] = 1
    return normals


@njit(nogil=True, cache=True, error_model="numpy")
def to_units(depth_m: F32, stride: int, unit_m: float, units: U16) -> None:
    """Write every so many-th depth (H, W) [m] in units (h, w); 0 where it is unknown, impossible or too large."""
    for y in range(units.shape[0]):
        for x in range(units.shape[1]):
            value = depth_m[y * stride, x * stride] / unit_m + 0.5
            units[y, x] = np.uint16(value) if 1.0 <= value < 65536.0 else 0


@njit(nogil=True, cache=True, error_model="numpy")
def take_every(rgb: U8, stride: int, small: U8) -> None:
    """Write every so many-th pixel of a picture (H, W, 3) into a small one (h, w, 3)."""
    for y in range(small.shape[0]):
        for x in range(small.shape[1]):
            for k in range(3):
                small[y, x, k] = rgb[y * stride, x * stride, k]
