"""The data types of this package: an image at half its size, and which of its pixels are potentially dynamic."""

from dataclasses import dataclass, field
from functools import cached_property

import cv2
import numpy as np

from stillroom.data.image import Image
from stillroom.geometry.arrays import F32, U8, Bool

SMALLEST_SIDE_PX = 32
"""Smallest side of an image whose flow can be computed; in smaller ones it is zero."""


@dataclass(frozen=True, eq=False)
class HalfImage:
    """An image at half its size: a quarter of the work, and still finer than the borders of any network's mask.

    Attributes:
        index: Place of the image in its sequence.
        gray: Brightness (h, w) uint8, mean of four pixels.
        depth_m: Depth (h, w) float32 [m] of one of the four, so that no depth is interpolated; 0 where unknown.
    """

    index: int
    gray: U8
    depth_m: F32
    _flows: dict[int, F32] = field(default_factory=dict, repr=False)

    @staticmethod
    def of(image: Image) -> "HalfImage":
        """Return an image at half its size; a last odd row or column is left out."""
        rows, columns = max(image.height // 2, 1), max(image.width // 2, 1)
        if min(image.height, image.width) > 1:
            gray = image.shrunk(2)
        else:
            gray = np.asarray(cv2.resize(image.gray, (columns, rows), interpolation=cv2.INTER_AREA), dtype=np.uint8)
        depth_m = np.ascontiguousarray(image.known_depth_m[::2, ::2][:rows, :columns])
        return HalfImage(image.index, gray, depth_m)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.gray.shape[0], self.gray.shape[1]

    def flow_to(self, earlier: "HalfImage") -> F32:
        """Return where each pixel was in an earlier image of the same size, relative to here (h, w, 2) [px].

        Cached: masks of several results pass over the same pair of images.
        """
        if earlier.index not in self._flows:
            self._flows[earlier.index] = _flow(self.gray, earlier.gray)
        return self._flows[earlier.index]


@dataclass(frozen=True)
class Numbered:
    """What a number of segments means where each object has one of its own: its class, and its score."""

    label: str
    score: float


@dataclass(frozen=True, eq=False)
class MaskSegments:
    """Which pixels of an image, at half its size, are potentially dynamic.

    Attributes:
        label: 0 for background, i for the i-th of the movable classes, counted from 1 (h, w) uint8.
        probability: Probability of its class, or of any movable class (h, w) float32.
        named: In the background: i for the i-th of the named classes, from 1 (h, w) uint8; None without named classes.
        things: Where objects are told apart, `label` and `named` are i for the i-th of these instead of classes.
    """

    label: U8
    probability: F32
    named: U8 | None = None
    things: tuple[Numbered, ...] = ()

    @cached_property
    def mask(self) -> Bool:
        """Potentially dynamic pixels (h, w)."""
        return np.asarray(self.label > 0)

    @cached_property
    def has_any(self) -> bool:
        """Whether anything is potentially dynamic."""
        return bool(self.label.any())


def _flow(now: U8, earlier: U8) -> F32:
    """Return the dense flow from one image to another (h, w, 2) [px] (Kroeger et al., ECCV 2016)."""
    if min(now.shape) < SMALLEST_SIDE_PX:
        return np.zeros((*now.shape, 2), dtype=np.float32)
    dense = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST)
    start = np.zeros((*now.shape, 2), dtype=np.float32)
    return np.asarray(dense.calc(now, earlier, start), dtype=np.float32)
