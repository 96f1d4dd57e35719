"""A segmenter of another package: what is red may move."""

from dataclasses import dataclass

from stillroom.data.image import Image
from stillroom.data.semantics import Semantics
from stillroom.protocols import Segmenter


@dataclass(frozen=True)
class RedThingsConfig:
    """How red a pixel must be."""

    least_red: int = 150
    most_other: int = 60

    def build(self) -> Segmenter:
        return RedThings(self)


class RedThings:
    def __init__(self, config: RedThingsConfig) -> None:
        self.config = config

    def __call__(self, image: Image) -> Semantics:
        red, others = image.rgb[:, :, 0], image.rgb[:, :, 1:].max(axis=2)
        return Semantics(
            image.height, image.width, mask=(red >= self.config.least_red) & (others <= self.config.most_other)
        )
