"""What is potentially dynamic in an image: boxes, instances with a mask each, and one mask."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import cv2
import numpy as np

from stillroom.data.clusters import Clusters
from stillroom.geometry.arrays import F32, Bool, Floats
from stillroom.geometry.pixels import values_at

UNNAMED = "movable"
"""Label of an object without a class: a connected part of the potentially dynamic pixels."""


@dataclass(frozen=True)
class Box:
    """A detected object in the image as taken (distorted pixels).

    Attributes:
        x_min_px, y_min_px, x_max_px, y_max_px: Edges [px]; a point lies inside when min ≤ p ≤ max.
        label: Class name, such as "person".
        confidence: Between 0 and 1.
        carried: Frames since the last detection, over which the box was propagated; 0 for a detection of this frame.
        track_id: Identity over time where a tracker gave one; −1 otherwise.
    """

    x_min_px: float
    y_min_px: float
    x_max_px: float
    y_max_px: float
    label: str
    confidence: float
    carried: int = 0
    track_id: int = -1

    @property
    def xyxy_px(self) -> tuple[float, float, float, float]:
        """Edges in the order x_min y_min x_max y_max [px]."""
        return self.x_min_px, self.y_min_px, self.x_max_px, self.y_max_px

    @property
    def area_px(self) -> float:
        """Area [px²]; 0 for a box turned inside out."""
        return max(0.0, self.x_max_px - self.x_min_px) * max(0.0, self.y_max_px - self.y_min_px)


@dataclass(frozen=True, eq=False)
class Instance:
    """One movable object with the pixels that are its own, in the image as taken (distorted pixels).

    Its mask is kept cropped to its box: ten people cost about as much memory as one mask of the image.

    Attributes:
        label: Class name, such as "person".
        score: How sure the segmenter is, between 0 and 1.
        pixels: Its mask within its box (h, w) bool; each border row and column has a pixel of it.
        x_px, y_px: Column and row in the image of the first pixel of `pixels`.
        height, width: Image size [px].
        track_id: Identity over time where a tracker gave one; −1 otherwise.
    """

    label: str
    score: float
    pixels: Bool = field(repr=False)
    x_px: int
    y_px: int
    height: int
    width: int
    track_id: int = -1

    @staticmethod
    def of(mask: Bool, label: str, score: float = 1.0, track_id: int = -1) -> "Instance":
        """Return the instance of a mask (H, W) bool; it keeps a copy of its part of it.

        Raises:
            ValueError: The mask covers no pixel.
        """
        rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
        if len(rows) == 0:
            raise ValueError(f"the mask of an instance of '{label}' covers no pixel; leave the instance out")
        y, x = int(rows[0]), int(columns[0])
        pixels = mask[y : int(rows[-1]) + 1, x : int(columns[-1]) + 1].copy()
        return Instance(label, score, pixels, x, y, mask.shape[0], mask.shape[1], track_id)

    @property
    def window(self) -> tuple[slice, slice]:
        """Rows and columns of its box: `image[instance.window][instance.pixels]` is what it covers."""
        rows, columns = self.pixels.shape
        return slice(self.y_px, self.y_px + rows), slice(self.x_px, self.x_px + columns)

    @property
    def mask(self) -> Bool:
        """Its pixels in the whole image (H, W) bool; a new array each time."""
        full = np.zeros((self.height, self.width), dtype=np.bool_)
        full[self.window] = self.pixels
        return full

    @cached_property
    def area_px(self) -> int:
        """How many pixels it covers [px²]."""
        return int(np.count_nonzero(self.pixels))

    @property
    def box(self) -> Box:
        """Return the smallest box with all its pixels."""
        rows, columns = self.pixels.shape
        x1, y1 = self.x_px + columns - 1, self.y_px + rows - 1
        return Box(self.x_px, self.y_px, x1, y1, self.label, self.score, track_id=self.track_id)


@dataclass(frozen=True)
class Semantics:
    """What is potentially dynamic in one image.

    Attributes:
        height, width: Image size [px].
        boxes: Objects of movable classes.
        mask: Pixels of potentially dynamic objects (H, W); None where a segmenter gives only boxes.
        clusters: Clusters of the depth cloud, where it was segmented; potentially dynamic whatever their class is.
        named: Objects of classes that are static unless people move them, such as chairs; they do not count as
            potentially dynamic.
        instances: Objects of movable classes with a mask each, where a segmenter separates them; they may overlap.
            Where there is a mask too, it covers all of them: to dilate the mask, dilate or drop them too.
    """

    height: int
    width: int
    boxes: tuple[Box, ...] = ()
    mask: Bool | None = field(default=None, repr=False)
    clusters: Clusters | None = field(default=None, repr=False)
    named: tuple[Box, ...] = ()
    instances: tuple[Instance, ...] = field(default=(), repr=False)

    @property
    def has_any(self) -> bool:
        """Whether anything is potentially dynamic."""
        return bool(self.boxes) or bool(self.instances) or (self.mask is not None and bool(self.mask.any()))

    @cached_property
    def movable(self) -> Bool:
        """Potentially dynamic pixels (H, W): the mask where there is one, else all instances, else the boxes filled."""
        if self.mask is not None:
            return self.mask
        if self.instances:
            return union_of(self.instances, self.height, self.width)
        return filled(self.boxes, self.height, self.width)

    @cached_property
    def objects(self) -> tuple[Instance, ...]:
        """The potentially dynamic objects: the instances where they are known, else the connected parts of `movable`.

        A part may be two people who touch, or one of two halves of a person; its label is `UNNAMED`.
        """
        return self.instances or connected_parts(self.movable)

    def movable_at(self, raw_px: Floats) -> Bool:
        """Return whether points (N, 2) of the image as taken lie on something potentially dynamic, (N,)."""
        if not self.has_any or len(raw_px) == 0:
            return np.zeros(len(raw_px), dtype=np.bool_)
        return values_at(self.movable, raw_px)

    @cached_property
    def boxes_xyxy_px(self) -> F32:
        """Edges of the boxes (B, 4) [px]."""
        return boxes_xyxy_px(self.boxes)


def boxes_xyxy_px(boxes: Sequence[Box]) -> F32:
    """Return the edges of boxes (B, 4) [px]."""
    return np.array([box.xyxy_px for box in boxes], dtype=np.float32).reshape(-1, 4)


def filled(boxes: Sequence[Box], height: int, width: int) -> Bool:
    """Return the pixels (H, W) bool of an image that lie in any of some boxes."""
    pixels = np.zeros((height, width), dtype=np.bool_)
    for box in boxes:
        x0, y0 = max(0, int(np.ceil(box.x_min_px))), max(0, int(np.ceil(box.y_min_px)))
        x1, y1 = int(np.floor(box.x_max_px)), int(np.floor(box.y_max_px))
        pixels[y0 : max(y0, y1 + 1), x0 : max(x0, x1 + 1)] = True
    return pixels


def union_of(instances: Sequence[Instance], height: int, width: int) -> Bool:
    """Return the pixels (H, W) bool of all instances of an image together."""
    together = np.zeros((height, width), dtype=np.bool_)
    for instance in instances:
        together[instance.window] |= instance.pixels
    return together


def connected_parts(mask: Bool, label: str = UNNAMED) -> tuple[Instance, ...]:
    """Return the parts of a mask (H, W) bool, pixels that touch by a side or a corner, in the order of their labels."""
    pixels = np.ascontiguousarray(mask).view(np.uint8)
    _, part_at, statistics, _ = cv2.connectedComponentsWithStats(pixels, connectivity=8)
    parts = []
    for part, (x, y, columns, rows, _) in enumerate(statistics[1:].tolist(), start=1):
        own = part_at[y : y + rows, x : x + columns] == part
        parts.append(Instance(label, 1.0, own, x, y, *mask.shape))
    return tuple(parts)


def nothing(height: int, width: int) -> Semantics:
    """Return the semantics of an image without anything potentially dynamic."""
    return Semantics(height, width)
