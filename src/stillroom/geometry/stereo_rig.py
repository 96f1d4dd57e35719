"""Two cameras beside each other, and what makes a rectified pair of their images."""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from stillroom.errors import CalibrationError
from stillroom.geometry import se3
from stillroom.geometry.arrays import F32, F64, U8
from stillroom.geometry.camera import Camera

PARALLEL_RAD = 1e-9
"""What two cameras that are called parallel may be turned by, as a calibration file rounds."""
LARGEST_TURN_RAD = 0.5
"""Rectified images of cameras that are turned by more have little left of what both see."""


@dataclass(frozen=True)
class StereoRig:
    """A left and a right camera on one body, as they take their images: distorted, and turned a little to each other.

    Attributes:
        left, right: Their calibrations; both take images of one size.
        T_right_left: Pose (4, 4) of the left camera in the right one's frame.
    """

    left: Camera
    right: Camera
    T_right_left: F64

    def __post_init__(self) -> None:
        """Refuse cameras of which no rectified pair can be made.

        Raises:
            CalibrationError: Their images differ in size, the pose is none, the right camera is not on the right, or
                the two look in different directions.
        """
        if (self.left.width, self.left.height) != (self.right.width, self.right.height):
            raise CalibrationError(
                f"stereo: the left images have {self.left.width}x{self.left.height} pixels and the right ones "
                f"{self.right.width}x{self.right.height}; both must be of one size"
            )
        T = np.asarray(self.T_right_left, dtype=np.float64)
        if (
            T.shape != (4, 4)
            or not np.all(np.isfinite(T))
            or not np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-3)
        ):
            raise CalibrationError("stereo: the pose of the left camera in the right one's frame is no rigid motion")
        centre_m = se3.inverse(T)[:3, 3]
        if not centre_m[0] > np.abs(centre_m[1:]).max():
            raise CalibrationError(
                f"stereo: the right camera is at {np.round(centre_m, 4).tolist()} m in the left one's frame; it must "
                "be to its right, at positive x (are left and right exchanged?)"
            )
        turn_rad = float(se3.angle_rad(T))
        if turn_rad > LARGEST_TURN_RAD:
            raise CalibrationError(
                f"stereo: the cameras are turned by {np.degrees(turn_rad):.0f}° to each other; a rectified pair needs "
                f"less than {np.degrees(LARGEST_TURN_RAD):.0f}°"
            )

    @property
    def baseline_m(self) -> float:
        """Distance of the two cameras [m]."""
        return float(np.linalg.norm(self.T_right_left[:3, 3]))

    @property
    def is_rectified(self) -> bool:
        """Whether the images need no change: no distortion, the same intrinsics, parallel axes, a baseline along x."""
        T, left, right = self.T_right_left, self.left, self.right
        parallel = np.abs(T[:3, :3] - np.eye(3)).max() <= PARALLEL_RAD and np.abs(T[1:3, 3]).max() <= PARALLEL_RAD
        return bool(parallel) and not left.is_distorted and left.lens == right.lens

    @cached_property
    def rectification(self) -> "Rectification":
        """What makes rectified pairs of the images, worked out once."""
        return Rectification.of(self)


@dataclass(frozen=True)
class Rectification:
    """Turns the images of a rig such that what both see lies in the same row of both.

    Attributes:
        camera: The rectified left camera: no distortion; `bf` is its focal length times the baseline.
        R_left, R_right: What turns directions (3, 3) of each camera as taken into those of the rectified one.
        left_maps, right_maps: Where in the image as taken each rectified pixel comes from: x and y (H, W) float32 [px].
    """

    camera: Camera
    R_left: F64
    R_right: F64
    left_maps: tuple[F32, F32]
    right_maps: tuple[F32, F32]

    @staticmethod
    def of(
        rig: StereoRig, focal_px: float | None = None, center_px: tuple[float, float] | None = None
    ) -> "Rectification":
        """Work out the rectification of a rig (`cv2.stereoRectify`: the turn is shared by both cameras).

        The rectified camera shows pixels only that both as taken have (alpha = 0), with zero disparity at infinity.

        Args:
            rig: The cameras.
            focal_px: Focal length of the rectified camera [px]; OpenCV's choice by default, which differs between its
                versions.
            center_px: Its principal point (x, y) [px]; likewise.
        """
        left, right, T = rig.left, rig.right, rig.T_right_left
        size = left.width, left.height
        turned_left, turned_right, P, *_ = cv2.stereoRectify(
            left.K, np.asarray(left.distortion), right.K, np.asarray(right.distortion), size,
            np.ascontiguousarray(T[:3, :3]), T[:3, 3:].copy(), flags=cv2.CALIB_ZERO_DISPARITY, alpha=0.0,
        )  # fmt: skip
        R_left, R_right = np.asarray(turned_left, dtype=np.float64), np.asarray(turned_right, dtype=np.float64)
        focal_px = float(P[0, 0]) if focal_px is None else focal_px
        cx, cy = (float(P[0, 2]), float(P[1, 2])) if center_px is None else center_px
        camera = Camera(*size, focal_px, focal_px, cx, cy, bf=focal_px * rig.baseline_m)
        return Rectification(camera, R_left, R_right, _maps(left, R_left, camera), _maps(right, R_right, camera))

    @property
    def T_left_rectified(self) -> F64:
        """Pose (4, 4) of the rectified left camera in the frame of the left one as taken: turned, at the same place."""
        T = np.eye(4)
        T[:3, :3] = self.R_left.T
        return T

    def left(self, image: U8) -> U8:
        """Return a left image (H, W) or (H, W, 3) as taken as the rectified camera sees it; black outside of it."""
        return _remapped(image, self.left_maps)

    def right(self, image: U8) -> U8:
        """Return the same of a right image."""
        return _remapped(image, self.right_maps)


def _maps(taken: Camera, R: F64, rectified: Camera) -> tuple[F32, F32]:
    size = rectified.width, rectified.height
    x, y = cv2.initUndistortRectifyMap(taken.K, np.asarray(taken.distortion), R, rectified.K, size, cv2.CV_32FC1)
    return np.asarray(x, dtype=np.float32), np.asarray(y, dtype=np.float32)


def _remapped(image: U8, maps: tuple[F32, F32]) -> U8:
    return np.asarray(cv2.remap(image, *maps, interpolation=cv2.INTER_LINEAR), dtype=np.uint8)
