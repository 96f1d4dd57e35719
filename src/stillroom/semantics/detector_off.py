"""Withhold a detector's answer for stretches of frames, to see what becomes of tracking without it."""

from collections.abc import Sequence

from stillroom.data.image import RgbdImage
from stillroom.data.semantics import Box, Semantics, nothing
from stillroom.protocols import Segmenter
from stillroom.semantics.carried_boxes import CarriedBoxes
from stillroom.semantics.detector import Detector, EachFrameAlone

FrameRange = tuple[int, int]


def withhold(segmenter: Segmenter, ranges: Sequence[FrameRange]) -> Segmenter:
    """Return a segmenter whose detector finds nothing in the images of some ranges.

    The detector is silenced, not what stands behind it: boxes are still carried on. A segmenter without a detector
    says in those images that nothing may move.

    Args:
        segmenter: A fresh segmenter; not used any more afterwards.
        ranges: Image indices, first and one past the last.
    """
    if isinstance(segmenter, CarriedBoxes | EachFrameAlone):
        return segmenter.with_detector(WithheldDetector(segmenter.detector, ranges))
    return WithheldSegmenter(segmenter, ranges)


class WithheldDetector:
    """A detector that finds nothing in the images of some ranges."""

    def __init__(self, detector: Detector, ranges: Sequence[FrameRange]) -> None:
        self._detector = detector
        self._ranges = tuple(ranges)

    def detect(self, image: RgbdImage) -> tuple[Box, ...]:
        """Return the detector's boxes, or none."""
        return () if _within(image, self._ranges) else self._detector.detect(image)


class WithheldSegmenter:
    """A segmenter that says nothing in the images of some ranges."""

    def __init__(self, segmenter: Segmenter, ranges: Sequence[FrameRange]) -> None:
        self._segmenter = segmenter
        self._ranges = tuple(ranges)

    def __call__(self, image: RgbdImage) -> Semantics:
        """Return the segmenter's answer, or that nothing may move."""
        if _within(image, self._ranges):
            return nothing(image.height, image.width)
        return self._segmenter(image)


def _within(image: RgbdImage, ranges: Sequence[FrameRange]) -> bool:
    return any(first <= image.index < end for first, end in ranges)
