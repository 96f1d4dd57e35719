"""The two cameras of a rendered pair, as they take their images: exact and parallel, or distorted and turned."""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from stillroom.geometry import se3
from stillroom.geometry.arrays import F32, F64, U8
from stillroom.geometry.camera import Camera
from stillroom.geometry.stereo_rig import Rectification, StereoRig
from stillroom_scenes.render import Scene, Way, render

BASELINE_M = 0.11
"""EuRoC's, about."""
TURN_RAD = np.radians(1.0)
MARGIN_PX = 3
LEFT_DISTORTION = (-0.283, 0.074, 0.0002, 0.00002, 0.0)
RIGHT_DISTORTION = (-0.284, 0.0745, -0.0001, -0.00004, 0.0)


@dataclass(frozen=True)
class Eye:
    """One camera of a pair.

    Attributes:
        camera: Its calibration, perhaps distorted.
        T_left_eye: Its pose (4, 4) in the frame of the left camera.
    """

    camera: Camera
    T_left_eye: F64

    def see(self, scene: Scene, T_world_left: F64, time_s: float) -> U8:
        """Return the colours (H, W, 3) that it takes at a moment [s], the left camera being at a pose (4, 4)."""
        T_world_eye = T_world_left @ self.T_left_eye
        if not self.camera.is_distorted:
            return render(scene, self.camera, T_world_eye, time_s).rgb
        wide, x, y = self._lens
        return np.asarray(cv2.remap(render(scene, wide, T_world_eye, time_s).rgb, x, y, cv2.INTER_LINEAR), np.uint8)

    @cached_property
    def _lens(self) -> tuple[Camera, F32, F32]:
        """A pinhole camera that sees all that this one does, and where in its image (H, W), (H, W) each pixel lies."""
        camera = self.camera
        x, y = np.meshgrid(np.arange(camera.width, dtype=np.float32), np.arange(camera.height, dtype=np.float32))
        ideal_px = camera.undistort(np.column_stack((x.ravel(), y.ravel())))
        first = np.floor(ideal_px.min(axis=0)).astype(int) - MARGIN_PX
        size = np.ceil(ideal_px.max(axis=0)).astype(int) + MARGIN_PX - first
        wide = Camera(
            int(size[0]), int(size[1]), camera.fx, camera.fy, camera.cx - float(first[0]), camera.cy - float(first[1])
        )
        place = (ideal_px - first).astype(np.float32).reshape(camera.height, camera.width, 2)
        return wide, np.ascontiguousarray(place[..., 0]), np.ascontiguousarray(place[..., 1])


@dataclass(frozen=True)
class Eyes:
    """Both cameras, and what rectifies their images; None where they are rectified as taken."""

    left: Eye
    right: Eye
    rectification: Rectification | None

    @property
    def camera(self) -> Camera:
        """The rectified left camera."""
        if self.rectification is not None:
            return self.rectification.camera
        camera = self.left.camera
        return Camera(
            camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy, bf=camera.fx * BASELINE_M
        )


def parallel_eyes(camera: Camera) -> Eyes:
    """Return two equal pinhole cameras whose images are rectified as they are."""
    return Eyes(Eye(camera, np.eye(4)), Eye(camera, _beside(np.eye(3))), None)


def turned_eyes(camera: Camera) -> Eyes:
    """Return two distorted cameras of different lenses, the right one turned by 1° about the diagonal of all axes."""
    size = camera.width, camera.height
    left = Camera(*size, camera.fx, camera.fy, camera.cx, camera.cy, LEFT_DISTORTION)
    right = Camera(*size, camera.fx - 2.0, camera.fy - 3.0, camera.cx + 3.0, camera.cy - 2.5, RIGHT_DISTORTION)
    turn, _ = cv2.Rodrigues(np.full(3, TURN_RAD / np.sqrt(3.0)))
    T_left_right = _beside(np.asarray(turn, dtype=np.float64))
    rig = StereoRig(left, right, se3.inverse(T_left_right))
    return Eyes(Eye(left, np.eye(4)), Eye(right, T_left_right), rig.rectification)


def _beside(turn: F64) -> F64:
    return se3.from_rotation_translation(turn, np.array([BASELINE_M, 0.0, 0.0]))


@dataclass(frozen=True)
class Mounted:
    """The way of a camera that is mounted on another one, such as the rectified one on the left one as taken.

    Attributes:
        way: Where the other is.
        T_other_cam: Its pose (4, 4) there.
    """

    way: Way
    T_other_cam: F64

    def poses(self, times_s: F64) -> F64:
        """Return `T_world_cam` (N, 4, 4) at times (N,) [s]."""
        return self.way.poses(times_s) @ self.T_other_cam
