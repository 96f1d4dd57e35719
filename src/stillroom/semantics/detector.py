"""Detectors: boxes in one image, without memory; and the plainest segmenter made of one."""

from typing import Protocol

from stillroom.data.image import RgbdImage
from stillroom.data.semantics import Box, Semantics


class Detector(Protocol):
    """Finds boxes in one image. Keeps no state over time: `CarriedBoxes` does."""

    def detect(self, image: RgbdImage) -> tuple[Box, ...]:
        """Return the boxes of movable things, the most confident first."""


class EachFrameAlone:
    """Reports what the detector finds in each image, and nothing else."""

    def __init__(self, detector: Detector) -> None:
        self.detector = detector

    def __call__(self, image: RgbdImage) -> Semantics:
        """Return the boxes of this image."""
        return Semantics(image.height, image.width, self.detector.detect(image))

    def with_detector(self, detector: Detector) -> "EachFrameAlone":
        """Return the same with another detector."""
        return EachFrameAlone(detector)
