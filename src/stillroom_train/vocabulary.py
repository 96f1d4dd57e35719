"""From sequences to a vocabulary, with a card that says what it was made from."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from stillroom.data.map import Map
from stillroom.errors import FrameError, VocabularyError
from stillroom.features.orb import OrbConfig
from stillroom.features.places.growth import GrowthConfig, grow, one_word
from stillroom.features.places.vocabulary import Vocabulary
from stillroom.geometry.arrays import U8
from stillroom.protocols import Dataset, Parts
from stillroom.version import __version__

CARD = ".txt"
"""What is added to a vocabulary's file name for its card."""


@dataclass(frozen=True)
class Source:
    """What one sequence gave.

    Attributes:
        name: Its name.
        images: The descriptors (N, 32) of each image that was used.
        n_unreadable: Images that could not be read.
    """

    name: str
    images: tuple[U8, ...]
    n_unreadable: int

    @property
    def n_descriptors(self) -> int:
        """Number of descriptors."""
        return sum(len(image) for image in self.images)


@dataclass(frozen=True)
class Made:
    """A vocabulary and what it was made from.

    Attributes:
        vocabulary: The vocabulary.
        sources: Its sequences.
        config: The shape of its tree.
        grown_from: Digest of the vocabulary that it started from; empty where it did from nothing.
    """

    vocabulary: Vocabulary
    sources: tuple[Source, ...]
    config: GrowthConfig
    grown_from: str = ""

    def card(self) -> str:
        """Return what a reader should know of it."""
        config, n_images = self.config, sum(len(source.images) for source in self.sources)
        lines = [
            f"Vocabulary of places {self.vocabulary.digest}: {self.vocabulary.n_words} words",
            "",
            f"Binary tree (k-majority over ORB descriptors), branching {config.branching}, depth {config.depth},",
            f"leaves of fewer than {config.min_descriptors} descriptors not split, seed {config.seed}, by stillroom",
            f"{__version__}. Words are weighed by log(images / images with the word), {n_images} images in all.",
            "Where a sequence tells what may move in it, keypoints there were left out.",
            "",
        ]
        if self.grown_from:
            lines += [f"Grown from vocabulary {self.grown_from}.", ""]
        lines.append("Made from:")
        lines += [
            f"- {source.name}: {len(source.images)} images, {source.n_descriptors} descriptors"
            for source in self.sources
        ]
        return "\n".join(lines) + "\n"

    def save(self, path: Path) -> None:
        """Write the vocabulary, and its card beside it.

        Raises:
            VocabularyError: They cannot be written.
        """
        self.vocabulary.save(path)
        card = path.with_name(path.name + CARD)
        try:
            card.write_text(self.card(), encoding="utf-8")
        except OSError as error:
            raise VocabularyError(f"{card}: cannot be written ({error.strerror})") from error


def read_source(
    dataset: Dataset, every: int, features: OrbConfig | None = None, told: Callable[[], None] | None = None
) -> Source:
    """Extract the static keypoints of every few images of a sequence.

    Args:
        dataset: The sequence.
        every: Use every so manieth image.
        features: How keypoints are found.
        told: Called after each image.
    """
    features = features or OrbConfig()
    extractor = features.build(Parts(dataset.camera, Map(features.scales(dataset.camera))))
    images, n_unreadable = [], 0
    for place in range(0, len(dataset), every):
        try:
            image = dataset.load(place)
        except FrameError:
            n_unreadable += 1
            continue
        keypoints = extractor.extract(image).keypoints
        descriptors = keypoints.descriptors
        if image.truth is not None:
            descriptors = descriptors[~image.truth.movable_at(keypoints.raw_px)]
        images.append(descriptors)
        if told is not None:
            told()
    return Source(dataset.name, tuple(images), n_unreadable)


def train(images: Sequence[U8], config: GrowthConfig | None = None) -> Vocabulary:
    """Make a vocabulary.

    Args:
        images: The descriptors (N, 32) of each training image.
        config: The shape of the tree.

    Raises:
        VocabularyError: There are too few descriptors for a tree.
    """
    config = config or GrowthConfig()
    n_found = sum(len(image) for image in images)
    if n_found < config.branching * config.min_descriptors:
        raise VocabularyError(f"{n_found} descriptors are too few for a vocabulary; give more or longer sequences")
    return grow(one_word(config.direct_level), images, config)


def make(sources: Sequence[Source], config: GrowthConfig, start: Vocabulary | None = None) -> Made:
    """Train a vocabulary from sequences, or grow an existing one on them.

    Raises:
        VocabularyError: There are too few descriptors.
    """
    images = [image for source in sources for image in source.images]
    if start is None:
        return Made(train(images, config), tuple(sources), config)
    return Made(grow(start, images, config), tuple(sources), config, start.digest)
