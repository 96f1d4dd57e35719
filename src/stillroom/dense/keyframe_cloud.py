"""What the dense map keeps of a keyframe: enough to take it out of the map and put it back elsewhere."""

from dataclasses import dataclass, field

import cv2
import numpy as np

from stillroom.bounds import bounded
from stillroom.data.image import RgbdImage
from stillroom.dense.surface_kernels import I8, find_surfaces, take_every, to_units
from stillroom.geometry.arrays import F32, U8, U16, Bool
from stillroom.geometry.camera import Camera
from stillroom.geometry.growing import Shape, element

UNIT_M = np.float32(2e-4)
"""Depths are kept in units of 0.2 mm, up to 13.1 m."""

LARGEST = float(np.iinfo(np.uint16).max)

SMOOTHING_PX = 5
SAME_SURFACE_PER_M = 0.006
"""Inverse depths of one surface differ by no more: three deviations."""


@dataclass(frozen=True)
class SurfaceConfig:
    """Which pixels are worth fusing.

    Attributes:
        stride: Every how many-th pixel, both ways.
        near_m, far_m: Range of depth; noise grows with its square.
        least_cosine: Of the angle between surface and ray: less is seen too flat.
        margin_px: How far around moving pixels others at their depth go too.
        margin_m, margin_share: At their depth: within the larger of the first and this share of the depth.
    """

    stride: int = bounded(2, least=1)
    near_m: float = bounded(0.3, least=0)
    far_m: float = bounded(5.0, above=0)
    least_cosine: float = 0.17
    margin_px: int = bounded(8, least=0)
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
        usable: Pixels that are in the map (h, w), 0 or 1. Ones that are removed as moving later go here, for good.
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

    def make(self, image: RgbdImage, excluded: Bool | None) -> tuple[KeyframeCloud, I8]:
        """Return the cloud of an image and the normals of its usable pixels (h, w, 3).

        Args:
            image: Colours and depths as taken.
            excluded: Pixels that move (H, W); None for none.
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
        """Return the normals (h, w, 3) of the usable pixels; those on no surface cease to be usable."""
        config = self.config
        normals: I8 = find_surfaces(
            cloud.depth_m, self.rays, config.near_m, config.far_m, config.least_cosine, cloud.usable
        )
        return normals

    def widened(self, excluded: Bool, depth_m: F32) -> Bool:
        """Return moving pixels (h, w) with those around them that lie at their depth.

        What lies further behind, as the wall beside a person, stays. Around moving pixels without depth nothing
        is known, and nothing more goes.
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
    """Return every so many-th depth [m] in units of `UNIT_M`; 0 where it is unknown, impossible or too large."""
    height, width = depth_m.shape
    units: U16 = np.empty((-(-height // stride), -(-width // stride)), dtype=np.uint16)
    to_units(depth_m, stride, float(UNIT_M), units)
    return units
