"""The cloud of a keyframe in the dense map: kept so that it can be subtracted and added again at a corrected pose."""

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from stillroom.bounds import bounded
from stillroom.compiled import njit
from stillroom.data.image import Image
from stillroom.geometry.arrays import F32, I32, U8, U16, Bool
from stillroom.geometry.camera import Camera
from stillroom.geometry.pixels import Shape, element

I8 = NDArray[np.int8]
NORMAL_SCALE = 127.0
STEP_TOLERANCE_M = 0.02
STEP_TOLERANCE_PER_M = 0.0065  # times z²: about three deviations of the difference of two Kinect depths
SLOPE = 1.0  # change of depth per sideways step of a surface that is no edge
STEEP_SLOPE = 2.5  # of one that is still worth a normal
FEWEST_ALIKE = 5  # of eight neighbours: a straight edge leaves five, a pixel in the air between two surfaces fewer
LONGEST_REACH_PX = 5
UNIT_M = np.float32(2e-4)
"""Depths are kept in units of 0.2 mm, up to 13.1 m."""
LARGEST = float(np.iinfo(np.uint16).max)
SMOOTHING_PX = 5
SAME_SURFACE_PER_M = 0.006
"""Inverse depths of one surface differ by no more: three deviations."""


# Which pixels of a small depth image lie on a surface, and how it is turned.


@njit(nogil=True, cache=True, error_model="numpy")
def find_surfaces(depth_m: F32, rays: F32, near_m: float, far_m: float, least_cosine: float, usable: U8) -> I8:
    """Clear `usable` where there is no surface, and return normals (h, w, 3), camera frame, unit length 127.

    A pixel is dropped when it is out of range, when too few of its neighbours lie at its depth (edges, and points in
    the air between two surfaces), or when it is seen at a grazing angle. The normal is the cross product of differences
    that reach further where depth is noisier.

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
    tolerances, alike = np.empty(width, dtype=np.float32), np.empty(width, dtype=np.int32)
    for y in range(height):
        for x in range(width):
            z = depth_m[y, x]
            tolerances[x] = max(STEP_TOLERANCE_M, STEP_TOLERANCE_PER_M * z * z) + SLOPE * pitch * z
        _count_alike(depth_m, y, tolerances, alike)
        for x in range(width):
            if usable[y, x] == 0:
                continue
            usable[y, x] = 0
            z, tolerance = depth_m[y, x], tolerances[x]
            if alike[x] < FEWEST_ALIKE or not (near_m <= z <= far_m):
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
def _count_alike(depth_m: F32, y: int, tolerances: F32, alike: I32) -> None:
    """Count for each pixel of a line (w,) how many of its eight neighbours lie at its depth.

    A neighbour at a time, along the whole line: several pixels are then compared at once.
    """
    height, width = depth_m.shape
    alike[:] = 0
    for v in range(max(0, y - 1), min(height, y + 2)):
        for aside in range(-1, 2):
            if v == y and aside == 0:
                continue
            first, last = max(0, -aside), width - max(0, aside)
            there, here = depth_m[v, first + aside : last + aside], depth_m[y, first:last]
            tolerance, found = tolerances[first:last], alike[first:last]
            for i in range(last - first):
                found[i] += 1 if abs(there[i] - here[i]) <= tolerance[i] else 0


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
    """Write depths (H, W) [m], at the stride, in units (h, w); 0 where unknown, impossible or too large."""
    for y in range(units.shape[0]):
        for x in range(units.shape[1]):
            value = depth_m[y * stride, x * stride] / unit_m + 0.5
            units[y, x] = np.uint16(value) if 1.0 <= value < 65536.0 else 0


@njit(nogil=True, cache=True, error_model="numpy")
def take_every(rgb: U8, stride: int, small: U8) -> None:
    """Subsample an image (H, W, 3) by the stride into a small one (h, w, 3)."""
    for y in range(small.shape[0]):
        for x in range(small.shape[1]):
            for k in range(3):
                small[y, x, k] = rgb[y * stride, x * stride, k]


@dataclass(frozen=True)
class SurfaceConfig:
    """Which pixels are worth fusing.

    Attributes:
        stride: Stride in rows and columns [px].
        near_m, far_m: Range of depth; noise grows with its square.
        least_cosine: Of the angle between surface and ray: less is seen too flat.
        margin_px: Dilation of dynamic pixels over others at their depth.
        margin_m, margin_share: At their depth: within the larger of the first and this share of the depth.
    """

    stride: int = bounded(2, least=1, pixels=1)
    near_m: float = bounded(0.3, least=0)
    far_m: float = bounded(5.0, above=0)
    least_cosine: float = 0.17
    margin_px: int = bounded(8, least=0, pixels=1)
    margin_m: float = 0.1
    margin_share: float = 0.04

    def contradiction(self) -> tuple[str, str] | None:
        """Return that the nearest depth is not below the farthest."""
        return None if self.near_m < self.far_m else ("far_m", "near_m")


@dataclass(frozen=True)
class KeyframeCloud:
    """A keyframe's pixels at the stride (h, w).

    Attributes:
        depth: Depths in units of `UNIT_M`, uint16; 0 where unknown.
        rgb: Colours (h, w, 3) uint8.
        usable: Pixels that are in the map (h, w), 0 or 1. Those found dynamic later are cleared here, permanently.
    """

    depth: U16 = field(repr=False)
    rgb: U8 = field(repr=False)
    usable: U8 = field(repr=False)

    @property
    def depth_m(self) -> F32:
        """Depths (h, w) float32 [m]."""
        return np.multiply(self.depth, UNIT_M, dtype=np.float32)


class CloudMaker:
    """Makes keyframe clouds of images, and finds their surfaces again."""

    def __init__(self, config: SurfaceConfig, camera: Camera) -> None:
        """Compute the rays of the pixels at the stride."""
        self.config, self.camera = config, camera
        u, v = np.arange(0, camera.width, config.stride), np.arange(0, camera.height, config.stride)
        grid = np.stack(np.meshgrid(u, v), axis=-1).astype(np.float32)
        points = camera.undistort(grid.reshape(-1, 2)).astype(np.float64)
        rays = (points - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
        self.rays: F32 = rays.astype(np.float32).reshape(*grid.shape)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the clouds."""
        return self.rays.shape[0], self.rays.shape[1]

    def make(self, image: Image, excluded: Bool | None) -> tuple[KeyframeCloud, I8]:
        """Return the cloud of an image and the normals of its usable pixels (h, w, 3).

        Args:
            image: Colours and depths as taken.
            excluded: Dynamic pixels (H, W); None for none.
        """
        stride, size = self.config.stride, (self.camera.height, self.camera.width)
        assert image.depth_m.shape == size, f"a depth image of {image.depth_m.shape}; the camera's have {size}"
        assert excluded is None or excluded.shape == size, "moving pixels of another size than the image"
        depth = smoothed(in_units(image.depth_m, stride))
        rgb = np.empty((*depth.shape, 3), dtype=np.uint8)
        take_every(image.rgb, stride, rgb)
        usable = (depth > 0).astype(np.uint8)
        cloud = KeyframeCloud(depth, rgb, usable)
        if excluded is not None:
            usable[self.widened(excluded[::stride, ::stride], cloud.depth_m)] = 0
        return cloud, self.find_surfaces(cloud)

    def find_surfaces(self, cloud: KeyframeCloud) -> I8:
        """Return the normals (h, w, 3) of the usable pixels; those on no surface are cleared in `usable`."""
        config = self.config
        normals: I8 = find_surfaces(
            cloud.depth_m, self.rays, config.near_m, config.far_m, config.least_cosine, cloud.usable
        )
        return normals

    def widened(self, excluded: Bool, depth_m: F32) -> Bool:
        """Return dynamic pixels (h, w), dilated over those around them at their depth.

        What lies further behind, such as the wall beside a person, stays. Dynamic pixels without depth are not dilated.
        """
        config = self.config
        reach = -(-config.margin_px // config.stride)
        if reach <= 0 or not excluded.any():
            return excluded
        kernel = element(reach, Shape.SQUARE)
        known = excluded & (depth_m > 0)
        farthest = cv2.dilate(np.where(known, depth_m, np.float32(-1e3)), kernel)
        nearest = cv2.erode(np.where(known, depth_m, np.float32(1e3)), kernel)
        room = np.maximum(config.margin_m, config.margin_share * depth_m)
        widened: Bool = excluded | ((depth_m >= nearest - room) & (depth_m <= farthest + room))
        return widened


def smoothed(depth: U16) -> U16:
    """Return depths in units with the noise averaged out over neighbours on the same surface.

    In inverse depth the noise of a Kinect is the same everywhere, and a plane is a plane; unknown is far off.
    """
    inverse = np.divide(1.0 / UNIT_M, np.maximum(depth, 1), dtype=np.float32)
    inverse[depth == 0] = 0
    mean = cv2.bilateralFilter(inverse, SMOOTHING_PX, SAME_SURFACE_PER_M, SMOOTHING_PX / 2.0)
    units = np.minimum(1.0 / UNIT_M / np.maximum(mean, np.float32(1e-6)), np.float32(LARGEST))
    units[depth == 0] = 0
    return np.asarray(np.rint(units), dtype=np.uint16)


def in_units(depth_m: F32, stride: int) -> U16:
    """Return depths [m], at the stride, in units of `UNIT_M`; 0 where unknown, impossible or too large."""
    height, width = depth_m.shape
    units: U16 = np.empty((-(-height // stride), -(-width // stride)), dtype=np.uint16)
    to_units(depth_m, stride, float(UNIT_M), units)
    return units
