"""Renders the scene at a moment: the driver over the kernels of `raster`."""

from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np

from stillroom.geometry import se3
from stillroom.geometry.arrays import F32, F64, U8
from stillroom.geometry.camera import Camera
from stillroom_scenes import raster, shading
from stillroom_scenes.scene.atlas import Atlas
from stillroom_scenes.scene.patches import Patches, concatenate
from stillroom_scenes.scene.people.figures import Figure, HandledObject

BLUR_SIGMA_PX = 0.55  # a lens is not perfect; it also softens the stairs at edges


@dataclass(frozen=True)
class Rendering:
    """A perfect image.

    Attributes:
        rgb: Colours (H, W, 3) uint8.
        inverse_depth: 1/z (H, W) float32 [1/m] at the pixel centres; 0 where nothing is.
        instance: What each pixel shows (H, W) uint8; 0 is the still room.
    """

    rgb: U8
    inverse_depth: F32
    instance: U8


@dataclass(frozen=True)
class Scene:
    """All that there is to see."""

    atlas: Atlas
    still: Patches
    figures: tuple[Figure, ...]
    objects: tuple[HandledObject, ...]

    def patches(self, time_s: float) -> Patches:
        """Return all patches at a moment."""
        parts = [figure.patches(time_s) for figure in self.figures]
        return concatenate([self.still, *parts, *(thing.patches(time_s) for thing in self.objects)])

    def seen(self, camera: Camera, T_world_cam: F64, time_s: float) -> Patches:
        """Return the patches that may be seen from a pose (4, 4) at a moment: all, in a scene of one room."""
        return self.patches(time_s)


class Way(Protocol):
    """Where the camera is at any time."""

    def poses(self, times_s: F64) -> F64:
        """Return `T_world_cam` (N, 4, 4) at times (N,) [s]."""


@dataclass(frozen=True)
class World:
    """What is rendered, and from where."""

    scene: Scene
    way: Way


def render(scene: Scene, camera: Camera, T_world_cam: F64, time_s: float) -> Rendering:
    """Render the scene at a moment from a pose (4, 4)."""
    patches = scene.seen(camera, T_world_cam, time_s)
    count, size = len(patches), (camera.height, camera.width)
    planes, outline, rows = np.empty((count, 12)), np.empty((count, 6)), np.empty((count, 3), dtype=np.int64)
    intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
    T_cam_world = se3.inverse(T_world_cam)
    raster.planes_of(patches.shape_m, patches.look, patches.kind, T_cam_world, intrinsics, size, planes, outline, rows)
    inverse_depth = np.zeros(size, dtype=np.float32)
    patch = np.full(size, raster.NOTHING, dtype=np.int32)
    raster.visible_patch(planes, outline, rows, patches.kind, inverse_depth, patch)
    rgba, instance = np.empty(size, dtype=np.uint32), np.empty(size, dtype=np.uint8)
    shading.shade(planes, patches.kind, patch, scene.atlas.texels, scene.atlas.levels, rgba, instance)
    rgb = cv2.cvtColor(rgba.view(np.uint8).reshape(*size, 4), cv2.COLOR_RGBA2RGB)
    soft = np.asarray(cv2.GaussianBlur(rgb, (3, 3), BLUR_SIGMA_PX), dtype=np.uint8)
    return Rendering(soft, inverse_depth, instance)
