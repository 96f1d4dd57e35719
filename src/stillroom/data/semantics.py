"""What may move in an image: boxes with classes, and masks."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from stillroom.data.cloud.clusters import Clusters
from stillroom.geometry.arrays import F32, Bool, Floats


@dataclass(frozen=True)
class Box:
    """A detected object in the image as taken (distorted pixels).

    Attributes:
        x_min_px, y_min_px, x_max_px, y_max_px: Edges [px]; a point lies inside when min ≤ p ≤ max.
        label: Class name, such as "person".
        confidence: Between 0 and 1.
        carried: How many frames ago the detector last saw it; 0 for a detection of this frame.
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


@dataclass(frozen=True)
class Semantics:
    """What may move in one image.

    Attributes:
        height, width: Image size [px].
        boxes: Objects of movable classes.
        mask: Pixels of movable things (H, W), where a segmenter gave a mask; None where there are only boxes.
        clusters: What the depth cloud falls into, where somebody looked; they may move whatever their class is.
        named: Objects of classes that stand still unless somebody moves them, such as chairs; no reason to think that
            they move.
    """

    height: int
    width: int
    boxes: tuple[Box, ...] = ()
    mask: Bool | None = field(default=None, repr=False)
    clusters: Clusters | None = field(default=None, repr=False)
    named: tuple[Box, ...] = ()

    @property
    def has_any(self) -> bool:
        """Whether anything may move at all."""
        return bool(self.boxes) or (self.mask is not None and bool(self.mask.any()))

    @cached_property
    def movable(self) -> Bool:
        """Pixels that may move (H, W): the mask where there is one, else the boxes filled."""
        if self.mask is not None:
            return self.mask
        filled = np.zeros((self.height, self.width), dtype=np.bool_)
        for box in self.boxes:
            x0, y0 = max(0, int(np.ceil(box.x_min_px))), max(0, int(np.ceil(box.y_min_px)))
            x1, y1 = int(np.floor(box.x_max_px)), int(np.floor(box.y_max_px))
            filled[y0 : max(y0, y1 + 1), x0 : max(x0, x1 + 1)] = True
        return filled

    def movable_at(self, raw_px: Floats) -> Bool:
        """Tell for points (N, 2) of the image as taken whether they lie on something movable, (N,)."""
        if not self.has_any or len(raw_px) == 0:
            return np.zeros(len(raw_px), dtype=np.bool_)
        column = np.clip(np.rint(raw_px[:, 0]).astype(np.int64), 0, self.width - 1)
        row = np.clip(np.rint(raw_px[:, 1]).astype(np.int64), 0, self.height - 1)
        return np.asarray(self.movable[row, column], dtype=np.bool_)

    @cached_property
    def boxes_xyxy_px(self) -> F32:
        """Edges of the boxes (B, 4) [px]."""
        return boxes_xyxy_px(self.boxes)


def boxes_xyxy_px(boxes: Sequence[Box]) -> F32:
    """Return the edges of boxes (B, 4) [px]."""
    return np.array([box.xyxy_px for box in boxes], dtype=np.float32).reshape(-1, 4)


def nothing(height: int, width: int) -> Semantics:
    """Return the semantics of an image in which nothing may move."""
    return Semantics(height, width)
