"""Which pixels of a small depth image lie on a surface, and how it is turned."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stillroom.geometry.arrays import F32, U8, U16

I8 = NDArray[np.int8]
NORMAL_SCALE = 127.0
STEP_TOLERANCE_M = 0.02
STEP_TOLERANCE_PER_M = 0.0065  # times z²: about three deviations of the difference of two Kinect depths
SLOPE = 1.0  # change of depth per sideways step of a surface that is no edge
STEEP_SLOPE = 2.5  # of one that is still worth a normal
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
    pitch = np.float32((rays[height // 2, width - 1, 0] - rays[height // 2, 0, 0]) / max(1, width - 1))
    normals = np.zeros((height, width, 3), dtype=np.int8)
    for y in range(height):
        for x in range(width):
            if usable[y, x] == 0:
                continue
            usable[y, x] = 0
            z = depth_m[y, x]
            if not (near_m <= z <= far_m):
                continue
            tolerance = np.float32(max(STEP_TOLERANCE_M, STEP_TOLERANCE_PER_M * z * z) + SLOPE * pitch * z)
            if _count_alike(depth_m, y, x, tolerance) < FEWEST_ALIKE:
                continue
            reach = min(LONGEST_REACH_PX, 1 + int(z))
            loose = tolerance + np.float32(STEEP_SLOPE) * pitch * z * np.float32(reach)
            left, right = x - _step(depth_m, y, x, 0, -1, reach, loose), x + _step(depth_m, y, x, 0, 1, reach, loose)
            above, below = y - _step(depth_m, y, x, -1, 0, reach, loose), y + _step(depth_m, y, x, 1, 0, reach, loose)
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
def _count_alike(depth_m: F32, y: int, x: int, tolerance: float) -> int:
    """Return how many of the neighbours of a pixel lie at its depth."""
    alike = -1
    for v in range(max(0, y - 1), min(depth_m.shape[0], y + 2)):
        for u in range(max(0, x - 1), min(depth_m.shape[1], x + 2)):
            alike += 1 if abs(depth_m[v, u] - depth_m[y, x]) <= tolerance else 0
    return alike


@njit(nogil=True, cache=True, error_model="numpy")
def _step(depth_m: F32, y: int, x: int, down: int, right: int, reach: int, tolerance: float) -> int:
    """Return how far one may go from a pixel for a difference of depth: to the reach, to the neighbour, or not."""
    for n in (reach, 1):
        v, u = y + n * down, x + n * right
        inside = 0 <= v < depth_m.shape[0] and 0 <= u < depth_m.shape[1]
        if inside and abs(depth_m[v, u] - depth_m[y, x]) <= tolerance:
            return n
    return 0


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
