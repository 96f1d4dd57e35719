"""What a map remembers of its places: the keyframes of the map in an index, kept up to date."""

from dataclasses import dataclass, field
from pathlib import Path

from stillroom.bounds import bounded
from stillroom.data.frame import Frame
from stillroom.data.map import Map
from stillroom.features.places.growth import GrowthConfig, grow
from stillroom.features.places.place_index import PlaceIndex, best_places
from stillroom.features.places.vocabulary import Bag, Vocabulary, load_vocabulary
from stillroom.geometry.arrays import I32, Bool
from stillroom.protocols import Parts


@dataclass(frozen=True)
class PlacesConfig:
    """Place recognition.

    Attributes:
        vocabulary: The file of the vocabulary, from `stillroom train-vocabulary`; None for the one that is shipped.
        grow_every: The tree grows on the run's own keyframes each time that so many have come; 0: never.
        growth: How it grows.
    """

    vocabulary: Path | None = None
    grow_every: int = bounded(0, least=0)
    growth: GrowthConfig = field(default_factory=lambda: GrowthConfig(depth=6, min_descriptors=50))

    def build(self, parts: Parts) -> "PlaceMemory":
        """Return the memory of a map's places, empty.

        Raises:
            VocabularyError: The vocabulary cannot be read.
        """
        return PlaceMemory(load_vocabulary(self.vocabulary), parts.world, self)


class PlaceMemory:
    """Knows the keyframes of a map by what they look like. Only static keypoints have a say.

    Attributes:
        vocabulary: The words.
        index: The keyframes by their words; loop closing asks it too.
    """

    def __init__(self, vocabulary: Vocabulary, world: Map, config: PlacesConfig | None = None) -> None:
        """Start empty."""
        self.vocabulary, self.world, self.config = vocabulary, world, config or PlacesConfig()
        self.index = PlaceIndex(vocabulary.n_words)
        self._since_grown = 0

    def remember(self, keyframe: int) -> None:
        """Add a keyframe of the map, and drop those that the map has culled since."""
        self.forget_culled()
        if self.world.keyframes.is_alive[keyframe]:
            self.index.add(keyframe, self.bag_of_keyframe(keyframe))
        self._since_grown += 1
        if 0 < self.config.grow_every <= self._since_grown:
            self.grow()

    def grow(self) -> None:
        """Split words that say too much in this map, by its own keyframes, and index these again."""
        self._since_grown = 0
        table = self.world.keypoints
        rows = [self.world.rows(int(keyframe)) for keyframe in self.world.alive_keyframes()]
        static = [table.descriptors[some][table.is_static[some]] for some in rows]
        self.vocabulary = grow(self.vocabulary, static, self.config.growth)
        self.index = PlaceIndex(self.vocabulary.n_words)
        self.remember_all()

    def remember_all(self) -> None:
        """Add all keyframes of the map that are not in yet, as for a map that was read from a file."""
        self.forget_culled()
        for keyframe in self.world.alive_keyframes():
            if int(keyframe) not in self.index:
                self.index.add(int(keyframe), self.bag_of_keyframe(int(keyframe)))

    def forget_culled(self) -> None:
        """Drop keyframes that are no longer in the map."""
        known = self.index.keyframes
        for keyframe in known[~self.world.keyframes.is_alive[known]]:
            self.index.remove(int(keyframe))

    def bag_of_keyframe(self, keyframe: int) -> Bag:
        """Return what the static keypoints of a keyframe say; its nodes run over all keypoints."""
        rows = self.world.rows(keyframe)
        table = self.world.keypoints
        return self.vocabulary.bag(table.descriptors[rows], table.is_static[rows])

    def bag_of_frame(self, frame: Frame) -> Bag:
        """Return what the keypoints say that sieve 1 left in a frame."""
        return self.vocabulary.bag(frame.keypoints.descriptors, frame.is_static)

    def candidates(self, bag: Bag, allowed: Bool | None = None, at_most: int | None = None) -> I32:
        """Return the keyframes (C,) that stand for the places most like an image, the best first.

        Args:
            bag: What the image says.
            allowed: Which keyframe ids (K,) may answer; all where not given.
            at_most: How many to return.
        """
        self.forget_culled()
        return best_places(self.index.query(bag, allowed), self.world.covisibility)[:at_most]
