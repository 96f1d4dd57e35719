"""Depth images of simple shapes, without rendering."""

from functools import lru_cache

import numpy as np

from stillroom.data.image import RgbdImage
from stillroom.geometry import se3
from stillroom.geometry.camera import Camera

CAMERA = Camera(160, 120, 130.0, 131.0, 79.0, 60.0)
DISTORTED = Camera(160, 120, 130.0, 131.0, 79.0, 60.0, distortion=(0.05, -0.1, 0.001, -0.002, 0.01))


@lru_cache(maxsize=4)
def rays(camera: Camera) -> np.ndarray:
    """x/z, y/z, 1 of each pixel (H, W, 3)."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    px = camera.undistort(np.stack((u, v), axis=-1).reshape(-1, 2).astype(np.float32)).astype(np.float64)
    xy = (px - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    return np.concatenate((xy, np.ones((len(xy), 1))), axis=1).reshape(camera.height, camera.width, 3)


def depth_of_box(T_world_cam: np.ndarray, lower_m: tuple, upper_m: tuple, camera: Camera = CAMERA) -> np.ndarray:
    """Depth (H, W) float32 [m] of the inside of an axis-parallel box that the camera is in."""
    direction = rays(camera) @ T_world_cam[:3, :3].T
    start = T_world_cam[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        far = np.where(direction > 0, np.asarray(upper_m) - start, np.asarray(lower_m) - start) / direction
    return np.nanmin(far, axis=-1).astype(np.float32)


def image(depth_m: np.ndarray, index: int = 0, seed: int = 0) -> RgbdImage:
    """An image of this depth, coloured at random."""
    rgb = np.random.default_rng(seed).integers(0, 256, (*depth_m.shape, 3), dtype=np.uint8)
    return RgbdImage(index / 30.0, rgb, depth_m.astype(np.float32), index)


def flat(depth_m: float, camera: Camera = CAMERA) -> np.ndarray:
    """A wall across the view."""
    return np.full((camera.height, camera.width), depth_m, dtype=np.float32)


def pose(x: float = 0.0, y: float = 0.0, z: float = 0.0, turn: tuple[float, float, float] = (0, 0, 0)) -> np.ndarray:
    """T_world_cam of a camera at (x, y, z) [m], turned by a rotation vector [rad]."""
    T_world_cam = se3.exp(np.array([0.0, 0.0, 0.0, *turn]))
    T_world_cam[:3, 3] = x, y, z
    return T_world_cam
