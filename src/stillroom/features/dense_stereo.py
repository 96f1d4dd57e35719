"""A depth image from a rectified pair: OpenCV's semi-global matching (Hirschmüller, PAMI 2008)."""

from dataclasses import dataclass

import cv2
import numpy as np

from stillroom.bounds import bounded
from stillroom.data.image import Image, StereoImage
from stillroom.geometry.arrays import F32, U8
from stillroom.geometry.camera import Camera

_STEP_PX = 16
"""OpenCV looks for a multiple of this many disparities, and gives each in as many parts of a pixel."""
_BLOCK_PX = 5
"""Side of the blocks that are compared."""
_PENALTIES = 2, 8
"""For neighbours whose disparity differs by a pixel, and by more, for each pixel of the block. A quarter of what
OpenCV's example has: with that, surfaces that turn away from the camera come in steps."""
_LEFT_RIGHT_PX = 1
"""By how much disparities found from the left and from the right image may differ."""
_SPECKLE_PX, _SPECKLE_STEP_PX = 200, 1
"""Patches of fewer pixels, bounded by steps of more than so many pixels of disparity, have no depth."""


@dataclass(frozen=True)
class SemiGlobalConfig:
    """How a depth image is made of a pair.

    Attributes:
        shrink: Images are made so many times smaller first. At 2 it takes a sixth of the time that it takes at 1, and
            disparities are off by half as much again.
        nearest: Depth of the nearest point that is looked for, in baselines.
        uniqueness: By how many percent the best disparity must be better than the next.
    """

    shrink: int = bounded(2, least=1)
    nearest: float = bounded(5.0, above=0)
    uniqueness: int = bounded(15, least=0)

    def build(self, camera: Camera) -> "SemiGlobal":
        """Return what makes depth images of a camera's pairs."""
        return SemiGlobal(self, camera)


class SemiGlobal:
    """Makes the depth image of a pair."""

    def __init__(self, config: SemiGlobalConfig, camera: Camera) -> None:
        """Prepare the search."""
        self.config, self.camera = config, camera
        n_px = camera.fx / config.nearest / config.shrink
        self._n_disparities = _STEP_PX * max(1, int(np.ceil(n_px / _STEP_PX)))
        near, far = (penalty * _BLOCK_PX**2 for penalty in _PENALTIES)
        self._matcher = cv2.StereoSGBM.create(
            minDisparity=0, numDisparities=self._n_disparities, blockSize=_BLOCK_PX, P1=near, P2=far,
            disp12MaxDiff=_LEFT_RIGHT_PX, preFilterCap=31, uniquenessRatio=config.uniqueness,
            speckleWindowSize=_SPECKLE_PX, speckleRange=_SPECKLE_STEP_PX, mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
        )  # fmt: skip

    def __call__(self, image: Image) -> F32:
        """Return the depth image (H, W) float32 [m] of a pair; 0 where it is not certain.

        Raises:
            TypeError: The image is no pair.
        """
        if not isinstance(image, StereoImage):
            raise TypeError(f"{image.sensor.words} images have no right image; semi-global matching takes stereo pairs")
        return self.depth_m(image.gray, image.right)

    def depth_m(self, left: U8, right: U8) -> F32:
        """Return the depth (H, W) float32 [m] on the pixels of the left image of a rectified pair (H, W); see above."""
        height, width = left.shape
        size = max(1, width // self.config.shrink), max(1, height // self.config.shrink)
        # OpenCV finds nothing in the first columns, from which the largest disparity leads out of the right image; with
        # as many columns before them it finds what is further away there.
        n = self._n_disparities
        small = [cv2.resize(image, size, interpolation=cv2.INTER_AREA) for image in (left, right)]
        widened = [cv2.copyMakeBorder(image, 0, 0, n, 0, cv2.BORDER_REPLICATE) for image in small]
        found = np.asarray(self._matcher.compute(*widened))[:, n:]
        # What was found in the columns before the image is nothing.
        known = (found > 0) & (found <= _STEP_PX * np.arange(size[0]))
        unit_px_m = np.float32(self.camera.bf * _STEP_PX * size[0] / width)
        depth_m = np.zeros(found.shape, dtype=np.float32)
        np.divide(unit_px_m, found, out=depth_m, where=known)
        return np.asarray(cv2.resize(depth_m, (width, height), interpolation=cv2.INTER_NEAREST), dtype=np.float32)
