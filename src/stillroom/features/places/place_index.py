"""Keyframes with similar bags of words: an inverted file and a direct index, in arrays."""

import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import wraps
from pathlib import Path
from typing import Concatenate, ParamSpec, TypeVar

import numpy as np

from stillroom.bounds import bounded
from stillroom.compiled import njit
from stillroom.data.frame import Frame
from stillroom.data.map import Covisibility, Map
from stillroom.data.map.tables import Column, Table
from stillroom.features.places.growth import GrowthConfig, grow
from stillroom.features.places.vocabulary import Bag, Vocabulary, load_vocabulary
from stillroom.geometry.arrays import F32, F64, I32, I64, Bool
from stillroom.protocols import Parts

P = ParamSpec("P")
T = TypeVar("T")
ENTRIES = 7
COMMON_SHARE = 0.8
"""A candidate has at least this share of the most words that any keyframe shares with the image."""
SCORE_SHARE = 0.75
"""A group's score is at least this share of the best group's."""
_NEIGHBOURS = 10
USED, NEXT = 2 * ENTRIES, 2 * ENTRIES + 1
"""A block of the inverted file is one line of the processor's cache: seven keyframes of a word, each with its weight (a
float32 in the bits of an int32), how many of the seven there are, and the next block."""
N_BLOCKS, FREE = 0, 1
"""Counters of the kernels: blocks that were ever used, and the first of the free list."""


@dataclass(frozen=True)
class Resemblance:
    """Keyframes that share words with an image.

    Attributes:
        keyframes: Their ids (C,) int32, ascending.
        scores: Similarity (C,) float64, 1 for the same image: 1 − |v − w| / 2 of the two bags.
        n_common: Number of words that both have (C,) int32.
    """

    keyframes: I32
    scores: F64
    n_common: I32

    def __len__(self) -> int:
        """Number of keyframes."""
        return len(self.keyframes)


class _BagEntries(Table):
    """Words and weights of the keyframes, keyframe after keyframe."""

    word = Column(np.int32, fill=-1)
    weight = Column(np.float32)


class _Members(Table):
    """A row for each keyframe id: where its words and its nodes are stored."""

    first_word = Column(np.int64)
    n_words = Column(np.int64)
    first_node = Column(np.int64)
    n_nodes = Column(np.int64)
    is_in = Column(np.bool_)


class _Nodes(Table):
    """The direct index: the branch of each keypoint, keyframe after keyframe."""

    node = Column(np.int32, fill=-1)


def _alone(work: "Callable[Concatenate[PlaceIndex, P], T]") -> "Callable[Concatenate[PlaceIndex, P], T]":
    """Let a method run on one thread at a time, by the index's lock."""

    @wraps(work)
    def held(index: "PlaceIndex", /, *args: P.args, **kwargs: P.kwargs) -> T:
        with index._lock:
            return work(index, *args, **kwargs)

    return held


class PlaceIndex:
    """Keyframes by their words. The words of a removed one stay in memory, but cost no time.

    It may be queried on one thread while another adds to it.
    """

    def __init__(self, n_words: int) -> None:
        """Start empty, for a vocabulary of `n_words` words."""
        self.n_words = n_words
        self._entries, self._members, self._nodes = _BagEntries(65536), _Members(256), _Nodes(65536)
        self._first_block: I32 = np.full(n_words, -1, dtype=np.int32)
        self._blocks: I32 = np.empty((16384, 2 * ENTRIES + 2), dtype=np.int32)
        self._counts: I64 = np.array([0, -1])
        self._lock = threading.RLock()

    def __len__(self) -> int:
        """Number of keyframes in it."""
        return int(self._members.is_in.sum())

    def __contains__(self, keyframe: int) -> bool:
        """Whether a keyframe is in it."""
        return keyframe < len(self._members) and bool(self._members.is_in[keyframe])

    @property
    def keyframes(self) -> I64:
        """Ids of the keyframes in it, ascending."""
        return np.flatnonzero(self._members.is_in)

    @property
    def n_bytes(self) -> int:
        """Memory in use for keyframes."""
        tables = (self._entries, self._members, self._nodes)
        in_tables = sum(view.nbytes for table in tables for view in table.views.values())
        return in_tables + int(self._blocks[: self._counts[N_BLOCKS]].nbytes)

    @_alone
    def add(self, keyframe: int, bag: Bag) -> None:
        """Add a keyframe; one that is in already is replaced."""
        self.remove(keyframe)
        members = self._members
        if keyframe >= len(members):
            members.append(keyframe + 1 - len(members))
        entries = self._entries.append(len(bag), word=bag.words, weight=bag.weights)
        nodes = self._nodes.append(len(bag.nodes), node=bag.nodes)
        members.first_word[keyframe], members.n_words[keyframe] = entries.start, len(bag)
        members.first_node[keyframe], members.n_nodes[keyframe] = nodes.start, len(bag.nodes)
        members.is_in[keyframe] = True
        self._reserve(len(bag))
        enter(keyframe, bag.words, bag.weights.view(np.int32), self._blocks, self._first_block, self._counts)

    @_alone
    def remove(self, keyframe: int) -> None:
        """Take a keyframe out, if it is in."""
        if keyframe not in self:
            return
        leave(keyframe, self._entries.word[self._rows(keyframe)], self._blocks, self._first_block, self._counts)
        self._members.is_in[keyframe] = False

    @_alone
    def bag(self, keyframe: int) -> Bag:
        """Return the bag of words of a keyframe in the index.

        Raises:
            KeyError: It is not in.
        """
        if keyframe not in self:
            raise KeyError(keyframe)
        rows = self._rows(keyframe)
        return Bag(self._entries.word[rows].copy(), self._entries.weight[rows].copy(), self.nodes(keyframe))

    @_alone
    def nodes(self, keyframe: int) -> I32:
        """Return the branch of each keypoint (N,) of a keyframe in the index; −1 for those that were left out.

        Raises:
            KeyError: It is not in.
        """
        if keyframe not in self:
            raise KeyError(keyframe)
        start = int(self._members.first_node[keyframe])
        return self._nodes.node[start : start + int(self._members.n_nodes[keyframe])].copy()

    @_alone
    def query(self, bag: Bag, allowed: Bool | None = None) -> Resemblance:
        """Find the keyframes that share words with an image.

        Args:
            bag: Its bag of words.
            allowed: Which keyframe ids (K,) may be returned; ids beyond its end may not. All by default.
        """
        n_members = len(self._members)
        may_answer = np.zeros(n_members, dtype=np.bool_)
        if allowed is None:
            may_answer[:] = True
        else:
            n_told = min(n_members, len(allowed))
            may_answer[:n_told] = allowed[:n_told]
        scores, n_common = resemble(
            bag.words,
            bag.weights,
            self._first_block,
            self._blocks,
            self._blocks.view(np.float32),
            may_answer,
        )
        found = np.flatnonzero(n_common)
        return Resemblance(found.astype(np.int32), scores[found], n_common[found])

    def _rows(self, keyframe: int) -> slice:
        start = int(self._members.first_word[keyframe])
        return slice(start, start + int(self._members.n_words[keyframe]))

    def _reserve(self, n_words: int) -> None:
        """Reserve the blocks that a keyframe with `n_words` words may need."""
        while self._counts[N_BLOCKS] + n_words > len(self._blocks):
            self._blocks = np.concatenate((self._blocks, np.empty_like(self._blocks)))


def score(first: Bag, second: Bag) -> float:
    """Return the similarity of two bags of words: 1 − |v − w| / 2, which is 1 for the same bag."""
    _, mine, theirs = np.intersect1d(first.words, second.words, assume_unique=True, return_indices=True)
    return float(np.minimum(first.weights[mine], second.weights[theirs]).sum(dtype=np.float64))


@njit(nogil=True, cache=True)
def enter(keyframe: int, words: I32, weight_bits: I32, blocks: I32, first_block: I32, counts: I64) -> None:
    """Add a keyframe to each of its words (W,)."""
    for i in range(len(words)):
        block = first_block[words[i]]
        if block < 0 or blocks[block, USED] == ENTRIES:
            if counts[FREE] >= 0:
                new = counts[FREE]
                counts[FREE] = blocks[new, NEXT]
            else:
                new = counts[N_BLOCKS]
                counts[N_BLOCKS] += 1
            blocks[new, USED], blocks[new, NEXT] = 0, block
            first_block[words[i]] = new
            block = new
        used = blocks[block, USED]
        blocks[block, 2 * used], blocks[block, 2 * used + 1] = keyframe, weight_bits[i]
        blocks[block, USED] = used + 1


@njit(nogil=True, cache=True)
def leave(keyframe: int, words: I32, blocks: I32, first_block: I32, counts: I64) -> None:
    """Remove a keyframe from each of its words (W,); the newest entry of a word fills the gap."""
    for i in range(len(words)):
        head = first_block[words[i]]
        block, place = head, 0
        while blocks[block, 2 * place] != keyframe:
            place += 1
            if place == blocks[block, USED]:
                block, place = blocks[block, NEXT], 0
        last = blocks[head, USED] - 1
        blocks[block, 2 * place] = blocks[head, 2 * last]
        blocks[block, 2 * place + 1] = blocks[head, 2 * last + 1]
        blocks[head, USED] = last
        if last == 0:
            first_block[words[i]] = blocks[head, NEXT]
            blocks[head, NEXT] = counts[FREE]
            counts[FREE] = head


@njit(nogil=True, cache=True)
def resemble(
    words: I32, weights: F32, first_block: I32, blocks: I32, blocks_as_float: F32, may_answer: Bool
) -> tuple[F64, I32]:
    """Sum for each keyframe (K,) over the words (W,) that it shares: the lesser weights, and their number.

    With weights that sum to 1, the sum of the lesser ones is 1 − |v − w| / 2.
    """
    scores = np.zeros(len(may_answer), np.float64)
    n_common = np.zeros(len(may_answer), np.int32)
    for w in range(len(words)):
        block = first_block[words[w]]
        while block >= 0:
            for place in range(blocks[block, USED]):
                keyframe = blocks[block, 2 * place]
                if may_answer[keyframe]:
                    scores[keyframe] += min(weights[w], blocks_as_float[block, 2 * place + 1])
                    n_common[keyframe] += 1
            block = blocks[block, NEXT]
    return scores, n_common


# From keyframes that share words to a few candidate places (ORB-SLAM2's two queries).


def best_places(found: Resemblance, covisibility: Covisibility, min_score: float = 0.0) -> I32:
    """Return the best keyframe (C,) of each of the most similar places, the best place first.

    The score of a place is the sum over covisible keyframes.

    Args:
        found: Result of a query.
        covisibility: The covisibility graph.
        min_score: Least similarity of a keyframe; loop closing takes the least of the covisible neighbours.
    """
    if len(found) == 0:
        return np.zeros(0, dtype=np.int32)
    enough = (found.n_common >= COMMON_SHARE * found.n_common.max()) & (found.scores >= min_score)
    scores = {int(found.keyframes[i]): float(found.scores[i]) for i in np.flatnonzero(enough)}
    totals: dict[int, float] = {}
    for keyframe in scores:
        group = [keyframe, *(other for other in covisibility.neighbours(keyframe, _NEIGHBOURS) if other in scores)]
        total = sum(scores[member] for member in group)
        best = max(group, key=lambda member: (scores[member], -member))
        totals[best] = max(total, totals.get(best, 0.0))
    bar = SCORE_SHARE * max(totals.values(), default=0.0)
    kept = [keyframe for keyframe, total in totals.items() if total >= bar]
    return np.array(sorted(kept, key=lambda keyframe: (-totals[keyframe], keyframe)), dtype=np.int32)


# The place index of a map, kept up to date with its keyframes.


@dataclass(frozen=True)
class PlacesConfig:
    """Place recognition.

    Attributes:
        vocabulary: The file of the vocabulary, from `stillroom train-vocabulary`; None for the one that is shipped.
        grow_every: Keyframes after which the tree is grown again on the run's own keyframes; 0: never.
        growth: How it grows.
    """

    vocabulary: Path | None = None
    grow_every: int = bounded(0, least=0)
    growth: GrowthConfig = field(default_factory=lambda: GrowthConfig(depth=6, min_descriptors=50))

    def build(self, parts: Parts) -> "PlaceMemory":
        """Return the place memory of a map, empty.

        Raises:
            VocabularyError: The vocabulary cannot be read.
        """
        return PlaceMemory(load_vocabulary(self.vocabulary), parts.world, self)


class PlaceMemory:
    """The keyframes of a map by their words. Only static keypoints are used.

    Attributes:
        vocabulary: The words.
        index: The keyframes by their words; loop closing queries it too.
    """

    def __init__(self, vocabulary: Vocabulary, world: Map, config: PlacesConfig | None = None) -> None:
        """Start empty."""
        self.vocabulary, self.world, self.config = vocabulary, world, config or PlacesConfig()
        self.index = PlaceIndex(vocabulary.n_words)
        self._since_grown = 0

    def remember(self, keyframe: int) -> None:
        """Add a keyframe of the map, and drop those that the map has culled since."""
        with self.world.lock:
            self.forget_culled()
            # The map of a single camera begins with two keyframes: the first is the parent of the one that is told of.
            parent = int(self.world.keyframes.parent[keyframe])
            for one in (keyframe,) if parent < 0 or parent in self.index else (parent, keyframe):
                if self.world.keyframes.is_alive[one]:
                    self.index.add(one, self.bag_of_keyframe(one))
            self._since_grown += 1
            if 0 < self.config.grow_every <= self._since_grown:
                self.grow()

    def grow(self) -> None:
        """Split words that are too frequent in this map, by its own keyframes, and index these again."""
        self._since_grown = 0
        table = self.world.keypoints
        rows = [self.world.rows(int(keyframe)) for keyframe in self.world.alive_keyframes()]
        static = [table.descriptors[some][table.is_static[some]] for some in rows]
        self.vocabulary = grow(self.vocabulary, static, self.config.growth)
        self.index = PlaceIndex(self.vocabulary.n_words)
        self.remember_all()

    def remember_all(self) -> None:
        """Add all keyframes of the map that are not in the index yet, as for a map that was read from a file."""
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
        """Return the bag of words of a keyframe's static keypoints; its nodes cover all keypoints."""
        rows = self.world.rows(keyframe)
        table = self.world.keypoints
        return self.vocabulary.bag(table.descriptors[rows], table.is_static[rows])

    def bag_of_frame(self, frame: Frame) -> Bag:
        """Return the bag of words of the keypoints that sieve 1 left in a frame."""
        return self.vocabulary.bag(frame.keypoints.descriptors, frame.is_static)

    def candidates(self, bag: Bag, allowed: Bool | None = None, at_most: int | None = None) -> I32:
        """Return the best keyframe (C,) of each of the places most similar to an image, the best first.

        Args:
            bag: Bag of words of the image.
            allowed: Which keyframe ids (K,) may be returned; all by default.
            at_most: How many to return.
        """
        self.forget_culled()
        return best_places(self.index.query(bag, allowed), self.world.covisibility)[:at_most]
