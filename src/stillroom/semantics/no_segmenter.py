"""The segmenter of a still world: nothing may move (ORB-SLAM2)."""

from dataclasses import dataclass

from stillroom.data.image import RgbdImage
from stillroom.data.semantics import Semantics, nothing
from stillroom.protocols import Parts, Segmenter


@dataclass(frozen=True)
class NothingConfig:
    """There is nothing to choose."""

    def build(self, parts: Parts | None = None) -> Segmenter:
        """Return the segmenter."""
        return NoSegmenter()


class NoSegmenter:
    """Says of every image that nothing in it may move."""

    def __call__(self, image: RgbdImage) -> Semantics:
        """Return empty semantics of the image's size."""
        return nothing(image.height, image.width)
