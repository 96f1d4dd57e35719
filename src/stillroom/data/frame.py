"""A frame: the keypoints of one image."""

import math
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from stillroom.data.image import Image
from stillroom.data.sensor import Sensor
from stillroom.geometry.arrays import F32, F64, I32, U8, Bool
from stillroom.geometry.camera import Camera


@dataclass(frozen=True)
class Keypoints:
    """N keypoints as parallel arrays.

    Attributes:
        px: Undistorted positions (N, 2) float32 [px], x right, y down, pixel centres at integers.
        raw_px: Positions in the image as taken (N, 2) float32 [px]; masks and boxes are looked up here.
        octave: Pyramid level (N,) int32, 0 the finest.
        angle_rad: Orientation (N,) float32 [rad], in (−π, π].
        descriptors: ORB (N, 32) uint8.
        depth_m: Depth (N,) float32 [m]; 0 where unknown.
        right_px: Horizontal position in the virtual right image (N,) float32 [px]; −1 where depth is unknown.
    """

    px: F32
    raw_px: F32
    octave: I32
    angle_rad: F32
    descriptors: U8
    depth_m: F32
    right_px: F32

    def __len__(self) -> int:
        """Number of keypoints."""
        return len(self.px)


@dataclass(frozen=True)
class ScaleLevels:
    """The levels of a scale pyramid.

    Attributes:
        factor: Ratio of neighbouring levels.
        count: Number of levels.
        finest_px: Size of a pixel of the finest level in the image [px]; see `finest_px`. Windows, tolerances and the
            noise of keypoints are in pixels of levels, so all of them grow with it.
        focal_px: Focal length in pixels of the finest level: how large what is one away is seen there; 0 where unknown.
            It is the camera's: pyramids are equal without it.
    """

    factor: float = 1.2
    count: int = 8
    finest_px: float = 1.0
    focal_px: float = field(default=0.0, compare=False)

    @classmethod
    def of(cls, camera: Camera, sensor: Sensor, factor: float, count: int) -> "ScaleLevels":
        """Return the pyramid over images of a camera."""
        side_px = finest_px(camera, sensor)
        return cls(factor, count, side_px, math.sqrt(camera.fx * camera.fy) / side_px)

    def reach(self, other: "ScaleLevels") -> float:
        """Return how many times as far as in another pyramid a thing is when it has the same size on the same level.

        1 where the focal length of either is unknown.
        """
        return self.focal_px / other.focal_px if self.focal_px > 0.0 and other.focal_px > 0.0 else 1.0

    @cached_property
    def factors(self) -> F64:
        """Size of each level's pixels in the image (L,) [px], 1 for the finest of an image 640 pixels long."""
        return np.asarray(self.finest_px * self.factor ** np.arange(self.count, dtype=np.float64))

    @cached_property
    def inverse_variances(self) -> F64:
        """Weight (L,) [1/px²] of a measurement on each level: its noise is a pixel of the level (ORB-SLAM2)."""
        return np.asarray(self.factors**-2.0)


STEREO_SIDE_PX = 1280
"""Longest side of the finest level of a stereo camera's pyramid [px]."""


def finest_px(camera: Camera, sensor: Sensor) -> float:
    """Return the size of a pixel of a pyramid's finest level in a camera's images [px].

    The finest level is 640 pixels long. Where depth comes from a pair of images, its error is that of the corners in
    them: the level is then as long as the image, from 640 to 1280 pixels.
    """
    if sensor is not Sensor.STEREO:
        return camera.pixel_scale
    longest_px = max(camera.width, camera.height)
    return min(camera.pixel_scale, max(1.0, longest_px / STEREO_SIDE_PX))


@dataclass(frozen=True)
class Frame:
    """The keypoints of one image, with the image and the camera that took it.

    Attributes:
        image: The image they were found in.
        camera: Its calibration.
        scales: The pyramid they were found on.
        keypoints: What was found.
        is_static: Which keypoints (N,) sieve 1 classifies as static; all true before it is applied.
        velocity: With which velocity of the camera (6,) [m/s, rad/s] keypoints were moved from where their rows saw
            them to mid-frame; None where they were not, as under a global shutter.
    """

    image: Image
    camera: Camera
    scales: ScaleLevels
    keypoints: Keypoints
    is_static: Bool = field(repr=False)
    velocity: F64 | None = field(default=None, repr=False)

    def __len__(self) -> int:
        """Number of keypoints."""
        return len(self.keypoints)

    @property
    def timestamp_s(self) -> float:
        """Time of the image [s]."""
        return self.image.timestamp_s

    def with_static(self, is_static: Bool) -> "Frame":
        """Return the same frame with another classification (N,) of its keypoints."""
        return replace(self, is_static=np.asarray(is_static, dtype=np.bool_))
