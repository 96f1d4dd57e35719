"""A frame: the keypoints of one image."""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from stillroom.data.image import Image
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
        finest_px: Size of a pixel of the finest level in the image [px]: `Camera.pixel_scale`. Windows, tolerances and
            the noise of keypoints are in pixels of levels, so all of them grow with the image.
    """

    factor: float = 1.2
    count: int = 8
    finest_px: float = 1.0

    @cached_property
    def factors(self) -> F64:
        """Size of each level's pixels in the image (L,) [px], 1 for the finest of an image 640 pixels long."""
        return np.asarray(self.finest_px * self.factor ** np.arange(self.count, dtype=np.float64))

    @cached_property
    def inverse_variances(self) -> F64:
        """Weight (L,) [1/px²] of a measurement on each level: its noise is a pixel of the level (ORB-SLAM2)."""
        return np.asarray(self.factors**-2.0)


@dataclass(frozen=True)
class Frame:
    """The keypoints of one image, with the image and the camera that took it.

    Attributes:
        image: The image they were found in.
        camera: Its calibration.
        scales: The pyramid they were found on.
        keypoints: What was found.
        is_static: Which keypoints (N,) sieve 1 classifies as static; all true before it is applied.
    """

    image: Image
    camera: Camera
    scales: ScaleLevels
    keypoints: Keypoints
    is_static: Bool = field(repr=False)

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
