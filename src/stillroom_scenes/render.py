"""Renders the scene at a moment: the driver over the kernels of `raster`."""

from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from stillroom.geometry import se3
from stillroom.geometry.arrays import F32, F64, U8
from stillroom.geometry.camera import Camera
from stillroom_scenes import raster, shading
from stillroom_scenes.scene.atlas import Atlas
from stillroom_scenes.scene.patches import Patches, concatenate
from stillroom_scenes.scene.people.figures import Figure, HandledObject

BLUR_SIGMA_PX = 0.55  # a lens is not perfect; it also softens the stairs at edges
ROWS_AT_ONCE = 2
"""Rows of a rolling shutter that are seen from one pose."""
BANDS_A_SCENE = 12
"""So many times that is what moves where it was; people take longer to place than a room to draw."""


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
    size = camera.height, camera.width
    inverse_depth, rgba, instance = np.zeros(size, np.float32), np.empty(size, np.uint32), np.empty(size, np.uint8)
    patches = scene.seen(camera, T_world_cam, time_s)
    _fill_rows(scene, patches, camera, T_world_cam, 0, inverse_depth, rgba, instance)
    return Rendering(_softened(rgba), inverse_depth, instance)


def render_rows(scene: Scene, camera: Camera, way: Way, time_s: float) -> Rendering:
    """Render the scene as a rolling shutter sees it, whose middle row is read at a moment.

    Pairs of rows are seen each from its own pose, and what moves is where it then is, so that no row is further from
    its time than a thousandth of a readout. Depth and instances are those of the rows too.
    """
    size = camera.height, camera.width
    inverse_depth, rgba, instance = np.zeros(size, np.float32), np.empty(size, np.uint32), np.empty(size, np.uint8)
    starts = np.arange(0, camera.height, ROWS_AT_ONCE)
    ends = np.minimum(starts + ROWS_AT_ONCE, camera.height)
    times_s = time_s + camera.rows_after_s(0.5 * (starts + ends - 1))
    for i, T_world_cam in enumerate(way.poses(times_s)):
        if i % BANDS_A_SCENE == 0:
            middle = min(i + BANDS_A_SCENE // 2, len(starts) - 1)
            patches = scene.seen(camera, T_world_cam, max(0.0, float(times_s[middle])))
        band = slice(int(starts[i]), int(ends[i]))
        _fill_rows(scene, patches, camera, T_world_cam, band.start, inverse_depth[band], rgba[band], instance[band])
    return Rendering(_softened(rgba), inverse_depth, instance)


def _fill_rows(
    scene: Scene,
    patches: Patches,
    camera: Camera,
    T_world_cam: F64,
    first: int,
    inverse_depth: F32,
    rgba: NDArray[np.uint32],
    instance: U8,
) -> None:
    """Render some rows of the image, from row `first` on, into arrays (R, W) of 1/z (zeros), colours and instances."""
    count, size = len(patches), inverse_depth.shape
    planes, outline, rows = np.empty((count, 12)), np.empty((count, 6)), np.empty((count, 3), dtype=np.int64)
    intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy - first])
    T_cam_world = se3.inverse(T_world_cam)
    raster.planes_of(patches.shape_m, patches.look, patches.kind, T_cam_world, intrinsics, size, planes, outline, rows)
    patch = np.full(size, raster.NOTHING, dtype=np.int32)
    raster.visible_patch(planes, outline, rows, patches.kind, inverse_depth, patch)
    shading.shade(planes, patches.kind, patch, scene.atlas.texels, scene.atlas.levels, rgba, instance)


def _softened(rgba: NDArray[np.uint32]) -> U8:
    rgb = cv2.cvtColor(rgba.view(np.uint8).reshape(*rgba.shape, 4), cv2.COLOR_RGBA2RGB)
    return np.asarray(cv2.GaussianBlur(rgb, (3, 3), BLUR_SIGMA_PX), dtype=np.uint8)
