"""One RGB-D image as a sequence delivers it."""

from dataclasses import dataclass, field
from functools import cached_property

import cv2
import numpy as np

from stillroom.data.semantics import Semantics
from stillroom.geometry.arrays import F32, U8

NO_INDEX = -1
"""Index of an image that belongs to no sequence."""


@dataclass(frozen=True)
class RgbdImage:
    """A colour image with registered depth.

    Attributes:
        timestamp_s: Time of the colour image [s].
        rgb: Colours (H, W, 3) uint8, RGB order, as taken (distorted).
        depth_m: Depth (H, W) float32 [m] on the colour pixels; 0 where unknown.
        index: Place of the image in its sequence, from 0; `Slam.process` counts images that have none.
        name: Name of its colour file without folder and suffix; "" for an image that never was a file.
        truth: The renderer's exact boxes and masks; None on real data.
        depth_after_s: How long after the colour image depth was taken, as far as is known [s]; negative where before.
            It counts only where the camera has a `depth_offset_s`, which it contains.
    """

    timestamp_s: float
    rgb: U8 = field(repr=False)
    depth_m: F32 = field(repr=False)
    index: int = NO_INDEX
    name: str = ""
    truth: Semantics | None = field(default=None, repr=False)
    depth_after_s: float = 0.0

    @cached_property
    def gray(self) -> U8:
        """Brightness (H, W) uint8."""
        return np.asarray(cv2.cvtColor(self.rgb, cv2.COLOR_RGB2GRAY), dtype=np.uint8)

    def shrunk(self, times: int) -> U8:
        """Return the brightness so many times smaller, made once: blocks of pixels, averaged.

        Pixel x of the small image has its centre at times·x + (times − 1)/2 of the large one.
        """
        known = self._shrunk.get(times)
        if known is None:
            size = self.width // times, self.height // times
            cut = self.gray[: size[1] * times, : size[0] * times]
            known = np.asarray(cv2.resize(cut, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
            self._shrunk[times] = known
        return known

    @cached_property
    def _shrunk(self) -> dict[int, U8]:
        return {}

    @property
    def height(self) -> int:
        """Rows."""
        return int(self.rgb.shape[0])

    @property
    def width(self) -> int:
        """Columns."""
        return int(self.rgb.shape[1])
