"""Where keypoints get their depth from: a registered depth image, a pair of images, or nowhere."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from stillroom.compiled import njit
from stillroom.data.frame import Keypoints
from stillroom.data.image import Image
from stillroom.geometry.arrays import F32, U8
from stillroom.geometry.camera import Camera


class KeypointDepth(Protocol):
    """Measures the depth of an image's keypoints. Called once for each image, in order."""

    def measured(self, image: Image, levels: Sequence[U8], keypoints: Keypoints) -> Keypoints:
        """Return the keypoints with `depth_m` and `right_px` set, where they can be measured.

        Args:
            image: The image.
            levels: The pyramid of its brightness in which the keypoints were found; valid during the call only.
            keypoints: The N keypoints, of unknown depth.
        """


class NoDepth:
    """The null object: the depth of every keypoint is unknown, as with a single camera."""

    def measured(self, image: Image, levels: Sequence[U8], keypoints: Keypoints) -> Keypoints:
        """Return the keypoints as they are."""
        return keypoints


@dataclass(frozen=True)
class RegisteredDepth:
    """Reads a depth image that is registered to the colours; the right coordinate is that of a virtual stereo pair.

    Attributes:
        camera: The calibration of the images.
        min_depth_m, max_depth_m: Depth outside this range counts as unknown.
    """

    camera: Camera
    min_depth_m: float
    max_depth_m: float

    def measured(self, image: Image, levels: Sequence[U8], keypoints: Keypoints) -> Keypoints:
        """Return the keypoints with the depth at their pixels."""
        range_m = np.float32(self.min_depth_m), np.float32(self.max_depth_m)
        depth_m = depth_at(image.depth_m, keypoints.raw_px, *range_m)
        return replace(keypoints, depth_m=depth_m, right_px=self.camera.right_coordinate(keypoints.px[:, 0], depth_m))


@njit(nogil=True, cache=True)
def depth_at(depth_m: F32, raw_px: F32, min_m: np.float32, max_m: np.float32) -> F32:
    """Return the depth (N,) at the nearest pixel, outside of the image at its edge; 0 where it is not in range."""
    height, width = depth_m.shape
    found_m = np.zeros(len(raw_px), np.float32)
    for i in range(len(raw_px)):
        column = min(max(int(np.rint(raw_px[i, 0])), 0), width - 1)
        row = min(max(int(np.rint(raw_px[i, 1])), 0), height - 1)
        if min_m <= depth_m[row, column] <= max_m:
            found_m[i] = depth_m[row, column]
    return found_m
