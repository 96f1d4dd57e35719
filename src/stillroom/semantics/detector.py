"""Detectors: boxes in one image, without memory; and the simplest segmenter made of one."""

from collections.abc import Collection, Sequence
from typing import Protocol, runtime_checkable

import numpy as np

from stillroom.data.image import Image
from stillroom.data.semantics import Box, Semantics, nothing
from stillroom.geometry.arrays import I64, Floats
from stillroom.protocols import KeyframeSegmenter, Segmenter

FrameRange = tuple[int, int]


class Detector(Protocol):
    """Finds boxes in one image. Keeps no state over time: `CarriedBoxes` does."""

    def detect(self, image: Image) -> tuple[Box, ...]:
        """Return the boxes of potentially dynamic objects, and of named ones, the most confident first."""


@runtime_checkable
class HasDetector(Protocol):
    """A segmenter made of a detector, which can be exchanged."""

    detector: Detector

    def with_detector(self, detector: Detector) -> Segmenter:
        """Return the same segmenter with another detector."""


class EachFrameAlone:
    """Returns the detector's boxes of each image, without propagation."""

    def __init__(self, detector: Detector, named: Collection[str] = ()) -> None:
        """Take a detector, and the classes among its own that are static unless people move them."""
        self.detector = detector
        self._named = named

    def __call__(self, image: Image) -> Semantics:
        """Return the boxes of this image."""
        return of_boxes(image, self.detector.detect(image), self._named)

    def with_detector(self, detector: Detector) -> "EachFrameAlone":
        """Return the same with another detector."""
        return EachFrameAlone(detector, self._named)


def of_boxes(image: Image, boxes: Sequence[Box], named: Collection[str]) -> Semantics:
    """Return boxes as semantics of an image; those of named classes separately."""
    movable = tuple(box for box in boxes if box.label not in named)
    still = tuple(box for box in boxes if box.label in named)
    return Semantics(image.height, image.width, movable, named=still)


# Disable a detector for ranges of frames, to test tracking without it.


def withhold(segmenter: Segmenter, ranges: Sequence[FrameRange]) -> Segmenter:
    """Return a segmenter whose detector finds nothing in the images of some ranges.

    Only the detector is disabled: boxes are still propagated. A segmenter without a detector returns nothing
    potentially dynamic in those images.

    Args:
        segmenter: A fresh segmenter; not used any more afterwards.
        ranges: Image indices, first and one past the last.
    """
    if isinstance(segmenter, HasDetector):
        return segmenter.with_detector(WithheldDetector(segmenter.detector, ranges))
    return silenced(segmenter, ranges)


def silenced(segmenter: Segmenter, ranges: Sequence[FrameRange]) -> Segmenter:
    """Return a segmenter that finds nothing in the images of some ranges; of keyframes alone, if it sees only these."""
    if isinstance(segmenter, KeyframeSegmenter):
        return WithheldKeyframeSegmenter(segmenter, ranges)
    return WithheldSegmenter(segmenter, ranges)


class WithheldDetector:
    """A detector that finds nothing in the images of some ranges."""

    def __init__(self, detector: Detector, ranges: Sequence[FrameRange]) -> None:
        self._detector = detector
        self._ranges = tuple(ranges)

    def detect(self, image: Image) -> tuple[Box, ...]:
        """Return the detector's boxes, or none."""
        return () if _within(image, self._ranges) else self._detector.detect(image)


class WithheldSegmenter:
    """A segmenter that finds nothing in the images of some ranges."""

    def __init__(self, segmenter: Segmenter, ranges: Sequence[FrameRange]) -> None:
        self._segmenter = segmenter
        self._ranges = tuple(ranges)

    def __call__(self, image: Image) -> Semantics:
        """Return the segmenter's result, or empty semantics."""
        if _within(image, self._ranges):
            return nothing(image.height, image.width)
        return self._segmenter(image)


class WithheldKeyframeSegmenter(WithheldSegmenter):
    """The same of a network that sees keyframes only; it does not see those of the ranges."""

    def __init__(self, segmenter: KeyframeSegmenter, ranges: Sequence[FrameRange]) -> None:
        super().__init__(segmenter, ranges)
        self._see = segmenter.see

    def see(self, image: Image) -> Semantics:
        """Return what the network finds in a keyframe, or empty semantics."""
        return nothing(image.height, image.width) if _within(image, self._ranges) else self._see(image)


def _within(image: Image, ranges: Sequence[FrameRange]) -> bool:
    return any(first <= image.index < end for first, end in ranges)


# Boxes as arrays: overlap, and the best of many that overlap.


def overlap(first: Floats, second: Floats) -> Floats:
    """Return intersection over union of each of A boxes with each of B, (A, B); boxes are x_min y_min x_max y_max."""
    corner_min = np.maximum(first[:, None, :2], second[None, :, :2])
    corner_max = np.minimum(first[:, None, 2:], second[None, :, 2:])
    common = np.prod(np.maximum(corner_max - corner_min, 0.0), axis=2)
    area_first = np.prod(np.maximum(first[:, 2:] - first[:, :2], 0.0), axis=1)
    area_second = np.prod(np.maximum(second[:, 2:] - second[:, :2], 0.0), axis=1)
    union = area_first[:, None] + area_second[None, :] - common
    return np.asarray(common / np.maximum(union, 1e-9))


def suppress(boxes: Floats, scores: Floats, labels: I64, max_iou: float) -> I64:
    """Keep the best of the boxes of one class that overlap each other by more than `max_iou`.

    Args:
        boxes: Edges (N, 4).
        scores: The higher the better (N,).
        labels: Class (N,); boxes of different classes do not suppress each other.
        max_iou: Highest overlap that two kept boxes of one class may have.

    Returns:
        Indices of the kept boxes, best first; equal scores keep their order.
    """
    order = np.argsort(-scores, kind="stable")
    clash = (overlap(boxes[order], boxes[order]) > max_iou) & (labels[order][:, None] == labels[order][None, :])
    kept = np.ones(len(order), dtype=np.bool_)
    for i in range(len(order)):
        if kept[i]:
            kept[i + 1 :] &= ~clash[i, i + 1 :]
    return np.asarray(order[kept], dtype=np.int64)
