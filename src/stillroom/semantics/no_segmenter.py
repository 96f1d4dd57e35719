"""The segmenter of a static world: nothing is potentially dynamic (ORB-SLAM2)."""

from dataclasses import dataclass

from stillroom.data.image import Image
from stillroom.data.semantics import Semantics, nothing
from stillroom.protocols import Parts, Segmenter


@dataclass(frozen=True)
class NothingConfig:
    """No settings."""

    def build(self, parts: Parts | None = None) -> Segmenter:
        """Return the segmenter."""
        return NoSegmenter()


class NoSegmenter:
    """The null object: nothing in any image is potentially dynamic."""

    def __call__(self, image: Image) -> Semantics:
        """Return empty semantics of the image's size."""
        return nothing(image.height, image.width)
