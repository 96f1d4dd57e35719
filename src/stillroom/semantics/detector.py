"""Detectors: boxes in one image, without memory; and the plainest segmenter made of one."""

from collections.abc import Collection, Sequence
from typing import Protocol

from stillroom.data.image import RgbdImage
from stillroom.data.semantics import Box, Semantics


class Detector(Protocol):
    """Finds boxes in one image. Keeps no state over time: `CarriedBoxes` does."""

    def detect(self, image: RgbdImage) -> tuple[Box, ...]:
        """Return the boxes of movable things, and of named ones, the most confident first."""


class EachFrameAlone:
    """Reports what the detector finds in each image, and nothing else."""

    def __init__(self, detector: Detector, named: Collection[str] = ()) -> None:
        """Take a detector, and the classes among its own that stand still unless somebody moves them."""
        self.detector = detector
        self._named = named

    def __call__(self, image: RgbdImage) -> Semantics:
        """Return the boxes of this image."""
        return of_boxes(image, self.detector.detect(image), self._named)

    def with_detector(self, detector: Detector) -> "EachFrameAlone":
        """Return the same with another detector."""
        return EachFrameAlone(detector, self._named)


def of_boxes(image: RgbdImage, boxes: Sequence[Box], named: Collection[str]) -> Semantics:
    """Return boxes as semantics of an image; those of named classes stand apart."""
    movable = tuple(box for box in boxes if box.label not in named)
    still = tuple(box for box in boxes if box.label in named)
    return Semantics(image.height, image.width, movable, named=still)
