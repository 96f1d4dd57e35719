"""Which keyframes say similar things: an inverted file and a direct index, in arrays."""

from dataclasses import dataclass

import numpy as np
from numba import njit

from stillroom.data.map.tables import Column, Table
from stillroom.features.places.vocabulary import Bag
from stillroom.geometry.arrays import F32, F64, I32, I64, Bool


@dataclass(frozen=True)
class Resemblance:
    """Keyframes that share words with an image.

    Attributes:
        keyframes: Their ids (C,) int32, ascending.
        scores: How alike they are (C,) float64, 1 for the same image: 1 − |v − w| / 2 of the two bags.
        n_common: Number of words that both have (C,) int32.
    """

    keyframes: I32
    scores: F64
    n_common: I32

    def __len__(self) -> int:
        """Number of keyframes."""
        return len(self.keyframes)


class _Entries(Table):
    """Words of keyframes, keyframe after keyframe; the entries of one word are a list, the newest first."""

    keyframe = Column(np.int32, fill=-1)
    word = Column(np.int32, fill=-1)
    weight = Column(np.float32)
    next_entry = Column(np.int32, fill=-1)


class _Members(Table):
    """A row for each keyframe id: where its entries and its nodes lie."""

    first_entry = Column(np.int64)
    n_entries = Column(np.int64)
    first_node = Column(np.int64)
    n_nodes = Column(np.int64)
    is_in = Column(np.bool_)


class _Nodes(Table):
    """The direct index: the branch of each keypoint, keyframe after keyframe."""

    node = Column(np.int32, fill=-1)


class PlaceIndex:
    """Keyframes by their words. Removed ones cost nothing but their place in memory."""

    def __init__(self, n_words: int) -> None:
        """Start empty, for a vocabulary of so many words."""
        self.n_words = n_words
        self._first_entry: I32 = np.full(n_words, -1, dtype=np.int32)
        self._entries, self._members, self._nodes = _Entries(65536), _Members(256), _Nodes(65536)

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
        return sum(view.nbytes for table in tables for view in table.views.values())

    def add(self, keyframe: int, bag: Bag) -> None:
        """Add a keyframe; one that is in already is replaced."""
        self.remove(keyframe)
        if keyframe >= len(self._members):
            self._members.append(keyframe + 1 - len(self._members))
        rows = self._entries.append(len(bag), keyframe=keyframe, word=bag.words, weight=bag.weights)
        nodes = self._nodes.append(len(bag.nodes), node=bag.nodes)
        members = self._members
        members.first_entry[keyframe], members.n_entries[keyframe] = rows.start, len(bag)
        members.first_node[keyframe], members.n_nodes[keyframe] = nodes.start, len(bag.nodes)
        members.is_in[keyframe] = True
        enter(rows.start, rows.stop, self._entries.word, self._entries.next_entry, self._first_entry)

    def remove(self, keyframe: int) -> None:
        """Take a keyframe out, if it is in."""
        if keyframe not in self:
            return
        rows = self._rows(keyframe)
        leave(rows.start, rows.stop, self._entries.word, self._entries.next_entry, self._first_entry)
        self._members.is_in[keyframe] = False

    def bag(self, keyframe: int) -> Bag:
        """Return what a keyframe that is in says.

        Raises:
            KeyError: It is not in.
        """
        if keyframe not in self:
            raise KeyError(keyframe)
        rows = self._rows(keyframe)
        return Bag(self._entries.word[rows].copy(), self._entries.weight[rows].copy(), self.nodes(keyframe))

    def nodes(self, keyframe: int) -> I32:
        """Return the branch of each keypoint (N,) of a keyframe that is in; −1 for those that were left out.

        Raises:
            KeyError: It is not in.
        """
        if keyframe not in self:
            raise KeyError(keyframe)
        start = int(self._members.first_node[keyframe])
        return self._nodes.node[start : start + int(self._members.n_nodes[keyframe])].copy()

    def query(self, bag: Bag, allowed: Bool | None = None) -> Resemblance:
        """Find the keyframes that share words with an image.

        Args:
            bag: What it says.
            allowed: Which keyframe ids (K,) may answer; ids beyond its end may not. All where not given.
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
            self._first_entry,
            self._entries.next_entry,
            self._entries.keyframe,
            self._entries.weight,
            may_answer,
        )
        found = np.flatnonzero(n_common)
        return Resemblance(found.astype(np.int32), scores[found], n_common[found])

    def _rows(self, keyframe: int) -> slice:
        start = int(self._members.first_entry[keyframe])
        return slice(start, start + int(self._members.n_entries[keyframe]))


def score(first: Bag, second: Bag) -> float:
    """Return how alike two images are by their words: 1 − |v − w| / 2, which is 1 for the same bag."""
    _, mine, theirs = np.intersect1d(first.words, second.words, assume_unique=True, return_indices=True)
    return float(np.minimum(first.weights[mine], second.weights[theirs]).sum(dtype=np.float64))


@njit(nogil=True, cache=True)
def enter(start: int, stop: int, entry_word: I32, next_entry: I32, first_entry: I32) -> None:
    """Put entries at the head of their words' lists."""
    for entry in range(start, stop):
        word = entry_word[entry]
        next_entry[entry] = first_entry[word]
        first_entry[word] = entry


@njit(nogil=True, cache=True)
def leave(start: int, stop: int, entry_word: I32, next_entry: I32, first_entry: I32) -> None:
    """Take entries out of their words' lists."""
    for entry in range(start, stop):
        word = entry_word[entry]
        if first_entry[word] == entry:
            first_entry[word] = next_entry[entry]
            continue
        other = first_entry[word]
        while next_entry[other] != entry:
            other = next_entry[other]
        next_entry[other] = next_entry[entry]


@njit(nogil=True, cache=True)
def resemble(
    words: I32,
    weights: F32,
    first_entry: I32,
    next_entry: I32,
    entry_keyframe: I32,
    entry_weight: F32,
    may_answer: Bool,
) -> tuple[F64, I32]:
    """Add up for each keyframe (K,) what it shares with the words (W,): the lesser weights, and their number.

    With weights that sum to 1, the sum of the lesser ones is 1 − |v − w| / 2.
    """
    scores = np.zeros(len(may_answer), np.float64)
    n_common = np.zeros(len(may_answer), np.int32)
    for i in range(len(words)):
        entry = first_entry[words[i]]
        while entry >= 0:
            keyframe = entry_keyframe[entry]
            if may_answer[keyframe]:
                scores[keyframe] += min(weights[i], entry_weight[entry])
                n_common[keyframe] += 1
            entry = next_entry[entry]
    return scores, n_common
