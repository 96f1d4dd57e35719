"""The ground truth of rendered images as a segmenter: a perfect detector, for synthetic sequences."""

from dataclasses import dataclass, field

from stillroom.data.image import Image
from stillroom.data.semantics import Box, Semantics
from stillroom.errors import ConfigError
from stillroom.protocols import Parts, Segmenter
from stillroom.semantics.carried_boxes import CarriedBoxes, CarryConfig
from stillroom.semantics.detector import EachFrameAlone


@dataclass(frozen=True)
class TrueSemanticsConfig:
    """Which part of the truth is returned.

    Attributes:
        masks: Give masks, instances and boxes; else boxes only, as a detector would.
        carry: How boxes are propagated where they are withheld; off, because the renderer misses none.
    """

    masks: bool = False
    carry: CarryConfig = field(default_factory=lambda: CarryConfig(enabled=False))

    def build(self, parts: Parts | None = None) -> Segmenter:
        """Return the segmenter."""
        if self.masks:
            return TrueMasks()
        detector = TrueBoxes()
        return CarriedBoxes(detector, 0.0, self.carry) if self.carry.enabled else EachFrameAlone(detector)


class TrueMasks:
    """Returns the whole ground truth of the renderer."""

    def __call__(self, image: Image) -> Semantics:
        """Return the truth of the image.

        Raises:
            ConfigError: The image was not rendered.
        """
        return _truth(image)


class TrueBoxes:
    """A detector that returns the renderer's boxes."""

    def detect(self, image: Image) -> tuple[Box, ...]:
        """Return the boxes of the image.

        Raises:
            ConfigError: The image was not rendered.
        """
        return _truth(image).boxes


def _truth(image: Image) -> Semantics:
    if image.truth is None:
        raise ConfigError(
            f"image {image.index} has no ground truth: the truth segmenter works on rendered sequences only; "
            "choose a detector or a folder of masks"
        )
    return image.truth
