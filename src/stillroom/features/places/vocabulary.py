"""A vocabulary tree of binary descriptors: words of keypoints, and bags of words of images."""

import hashlib
import zipfile
import zlib
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from importlib.resources import files
from pathlib import Path

import numpy as np

from stillroom.compiled import njit
from stillroom.errors import VocabularyError
from stillroom.features.matching import NEAR_BITS, one_to_one
from stillroom.geometry.arrays import F32, I32, I64, U8, U64, Bool
from stillroom.geometry.hamming import hamming, popcount64, words

FORMAT = 1
SHIPPED = "default.vocabulary"


# Matching two images branch by branch: only keypoints under one node of the tree are compared.


def match_by_branch(
    first: U8, first_nodes: I32, second: U8, second_nodes: I32, max_bits: int = NEAR_BITS, ratio: float = 0.75
) -> tuple[I32, I32]:
    """Match descriptors (N, 32) with (M, 32) by nearest neighbour and ratio test within their branches.

    Args:
        first, second: The descriptors.
        first_nodes, second_nodes: The branch of each, (N,) and (M,), as in `Bag.nodes`; −1 is ignored.
        max_bits: Largest distance.
        ratio: The best must be nearer than this share of the second best.

    Returns:
        Indices into `first` and `second` (K,), one to one.
    """
    order = np.argsort(second_nodes, kind="stable")
    sorted_nodes = second_nodes[order]
    start = np.searchsorted(sorted_nodes, first_nodes, side="left")
    stop = np.searchsorted(sorted_nodes, first_nodes, side="right")
    stop[first_nodes < 0] = start[first_nodes < 0]
    target, bits = match_within(words(first), start, stop, order, words(second), max_bits, ratio)
    return one_to_one(target, bits, len(second))


@njit(nogil=True, cache=True)
def match_within(
    first: U64, start: I64, stop: I64, order: I64, second: U64, max_bits: int, ratio: float
) -> tuple[I32, I32]:
    """Find for each descriptor (N, 4) the nearest among its stretch of `order`, which lists the second ones."""
    found = np.full(len(first), -1, np.int32)
    found_bits = np.full(len(first), 257, np.int32)
    for i in range(len(first)):
        best, runner_up, at = 257, 257, -1
        for place in range(start[i], stop[i]):
            bits = hamming(first, i, second, order[place])
            if bits < best:
                runner_up = best
                best, at = bits, order[place]
            elif bits < runner_up:
                runner_up = bits
        if best <= max_bits and best < ratio * runner_up:
            found[i] = at
            found_bits[i] = best
    return found, found_bits


@dataclass(frozen=True)
class Bag:
    """The bag of words of an image, weighted by frequency and rarity (tf–idf).

    Attributes:
        words: Ids of the words in it (W,) int32, ascending.
        weights: Their weights (W,) float32; they sum to 1, or there are none.
        nodes: Branch of the tree that each keypoint lies under (N,) int32, for matching two images branch by branch;
            −1 for keypoints that were left out.
    """

    words: I32
    weights: F32
    nodes: I32 = field(repr=False)

    def __len__(self) -> int:
        """Number of different words."""
        return len(self.words)


@dataclass(frozen=True)
class Vocabulary:
    """A vocabulary tree over binary descriptors (Gálvez-López and Tardós 2012). Node 0 is the root.

    Attributes:
        centres: Descriptor that stands for each node (M, 32) uint8.
        first_child: The children of a node are `n_children` neighbouring nodes from here on (M,) int32; 0 at leaves.
        n_children: Their number (M,) int32; 0 at leaves.
        word: Word of each leaf (M,) int32; −1 at inner nodes.
        idf: Rarity of each word (W,) float32: log of all training images over those with the word in it.
        direct_level: Depth of the branches that `Bag.nodes` names; the root lies at 0.
    """

    centres: U8
    first_child: I32
    n_children: I32
    word: I32
    idf: F32
    direct_level: int = 2

    @property
    def n_words(self) -> int:
        """Number of words."""
        return len(self.idf)

    @cached_property
    def digest(self) -> str:
        """Sixteen hexadecimal digits that identify this vocabulary, for files that refer to it."""
        found = hashlib.sha256(str(self.direct_level).encode())
        for part in (self.centres, self.first_child, self.n_children, self.word, self.idf):
            found.update(np.ascontiguousarray(part).tobytes())
        return found.hexdigest()[:16]

    def quantise(self, descriptors: U8) -> tuple[I32, I32]:
        """Return the word (N,) of each descriptor (N, 32), and the node (N,) on the direct index's level above it."""
        leaf, nodes = descend(
            words(descriptors), words(self.centres), self.first_child, self.n_children, self.direct_level
        )
        return self.word[leaf], nodes

    def bag(self, descriptors: U8, usable: Bool | None = None) -> Bag:
        """Return the bag of words of an image's descriptors (N, 32).

        Args:
            descriptors: Of all its keypoints.
            usable: Which of them (N,) are used; all by default. Potentially dynamic ones never should be.
        """
        chosen = np.arange(len(descriptors)) if usable is None else np.flatnonzero(usable)
        nodes = np.full(len(descriptors), -1, dtype=np.int32)
        said, nodes[chosen] = self.quantise(descriptors[chosen])
        said = np.sort(said)
        starts = np.flatnonzero(np.diff(said, prepend=np.int32(-1)))
        found, times = said[starts], np.diff(starts, append=len(said))
        weights = times * self.idf[found]
        found, weights = found[weights > 0], weights[weights > 0]
        return Bag(found.astype(np.int32), (weights / max(weights.sum(), 1e-12)).astype(np.float32), nodes)

    def save(self, path: Path) -> None:
        """Write it as one compressed file; the same vocabulary always gives the same bytes.

        Raises:
            VocabularyError: It cannot be written.
        """
        parts = {
            "format": np.array([FORMAT, self.direct_level]),
            "centres": self.centres,
            "n_children": self.n_children.astype(np.uint8),
            "first_child": self.first_child,
            "word": self.word,
            "idf": self.idf,
        }
        try:
            with path.open("wb") as file:
                np.savez_compressed(file, **parts)  # type: ignore[arg-type] # numpy's stub takes the names for options
        except OSError as error:
            raise VocabularyError(f"{path}: cannot be written ({error.strerror})") from error


@lru_cache(maxsize=4)
def load_vocabulary(path: Path | None = None) -> Vocabulary:
    """Read a vocabulary; the one that is shipped where no path is given. It is read once.

    Raises:
        VocabularyError: There is none, or not one that can be read.
    """
    place = Path(str(files("stillroom.features.places") / SHIPPED)) if path is None else path
    try:
        with np.load(place, allow_pickle=False) as parts:
            version, direct_level = (int(number) for number in parts["format"])
            if version > FORMAT:
                raise VocabularyError(f"{place}: written by a newer version; update stillroom, or train another")
            found = Vocabulary(
                parts["centres"],
                parts["first_child"],
                parts["n_children"].astype(np.int32),
                parts["word"],
                parts["idf"],
                direct_level,
            )
    except FileNotFoundError:
        raise VocabularyError(
            f"{place}: no such file; make one with `stillroom train-vocabulary SEQUENCE --out FILE`"
        ) from None
    except (
        OSError,
        ValueError,
        TypeError,
        KeyError,
        IndexError,
        AttributeError,
        EOFError,
        zipfile.BadZipFile,
        zlib.error,
        RuntimeError,  # zipfile, of what is encrypted, or of a version or compression that it does not know
    ) as error:
        raise VocabularyError(
            f"{place}: not a vocabulary of stillroom ({error}); make one with `stillroom train-vocabulary`"
        ) from error
    _check(found, place)
    return found


def _check(found: Vocabulary, place: Path) -> None:
    """Refuse a tree on which the kernels would read out of bounds."""
    n_nodes, inner = len(found.centres), found.n_children > 0
    last = found.first_child[inner] + found.n_children[inner]
    fits = n_nodes > 0 and found.centres.shape == (n_nodes, 32) and found.centres.dtype == np.uint8
    fits &= all(len(part) == n_nodes for part in (found.first_child, found.n_children, found.word))
    fits = fits and bool(np.all(last <= n_nodes) and np.all(found.first_child[inner] > np.flatnonzero(inner)))
    leaf = found.word[~inner]
    if not (fits and bool(np.all((leaf >= 0) & (leaf < found.n_words)))):
        raise VocabularyError(f"{place}: damaged: its tree is inconsistent; fetch or train it again")


@njit(nogil=True, cache=True)
def descend(descriptors: U64, centres: U64, first_child: I32, n_children: I32, direct_level: int) -> tuple[I32, I32]:
    """Descend with each descriptor (N, 4) from the root to the nearest child, to the first of equals, down to a leaf.

    Returns:
        The leaf (N,), and the node (N,) passed on `direct_level`, or the leaf where the tree ends above.
    """
    n = len(descriptors)
    leaf = np.zeros(n, np.int32)
    passed = np.zeros(n, np.int32)
    for i in range(n):
        d0, d1, d2, d3 = descriptors[i]
        node, level = 0, 0
        while n_children[node] > 0:
            best, nearest = 257, 0
            for child in range(first_child[node], first_child[node] + n_children[node]):
                bits = popcount64(d0 ^ centres[child, 0]) + popcount64(d1 ^ centres[child, 1])
                bits += popcount64(d2 ^ centres[child, 2]) + popcount64(d3 ^ centres[child, 3])
                if bits < best:
                    best, nearest = bits, child
            node = nearest
            level += 1
            if level == direct_level:
                passed[i] = node
        leaf[i] = node
        if level < direct_level:
            passed[i] = node
    return leaf, passed
