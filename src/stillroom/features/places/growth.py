"""Growing a vocabulary: k-majority clustering of descriptors, level by level, and the rarity (idf) of its words."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stillroom.compiled import njit
from stillroom.features.places.vocabulary import Vocabulary
from stillroom.geometry.arrays import F32, I32, I64, U8, U64
from stillroom.geometry.hamming import hamming, words


@dataclass(frozen=True)
class GrowthConfig:
    """The shape of the tree, and how it is trained.

    Attributes:
        branching: Children of a node.
        depth: Levels below the root, at most.
        min_descriptors: A node with fewer descriptors than this stays a leaf.
        iterations: Rounds of assigning and voting at each node, at most.
        direct_level: Depth of the branches by which images are matched.
        seed: Seed of the random choices.
    """

    branching: int = 10
    depth: int = 5
    min_descriptors: int = 20
    iterations: int = 10
    direct_level: int = 2
    seed: int = 0


@dataclass
class _Growing:
    """A tree under construction: a list for each column of the finished one."""

    centres: list[U8]
    first_child: list[int]
    n_children: list[int]
    word: list[int]

    @staticmethod
    def of(tree: Vocabulary) -> "_Growing":
        return _Growing(list(tree.centres), tree.first_child.tolist(), tree.n_children.tolist(), tree.word.tolist())

    def add_children(self, node: int, centres: U8) -> range:
        """Add leaves under a node and return them; the node's word is given to the first of them."""
        first = len(self.centres)
        word, next_word = self.word[node], max(self.word) + 1
        self.first_child[node], self.n_children[node], self.word[node] = first, len(centres), -1
        self.centres.extend(centres)
        self.first_child.extend([0] * len(centres))
        self.n_children.extend([0] * len(centres))
        self.word.extend([word, *range(next_word, next_word + len(centres) - 1)])
        return range(first, first + len(centres))

    def finish(self, idf: F32, direct_level: int) -> Vocabulary:
        return Vocabulary(
            np.array(self.centres, dtype=np.uint8).reshape(-1, 32),
            np.array(self.first_child, dtype=np.int32),
            np.array(self.n_children, dtype=np.int32),
            np.array(self.word, dtype=np.int32),
            idf,
            direct_level,
        )


def one_word(direct_level: int) -> Vocabulary:
    """Return a vocabulary of one word, from which a tree grows.

    Args:
        direct_level: Depth of the branches by which images are matched.
    """
    node = np.zeros(1, np.int32)
    return Vocabulary(np.zeros((1, 32), np.uint8), node, node, node, np.zeros(1, np.float32), direct_level)


def grow(vocabulary: Vocabulary, images: Sequence[U8], config: GrowthConfig | None = None) -> Vocabulary:
    """Split leaves that many descriptors of the given images reach; weight all words by these images.

    Words keep their ids; a word that is split keeps its id in the first of its parts. What was indexed by the old
    vocabulary must be indexed again.

    Args:
        vocabulary: The initial vocabulary.
        images: The descriptors (N, 32) of each image.
        config: The shape of the tree; `depth` bounds how deep it may get.
    """
    config = config or GrowthConfig()
    rng = np.random.default_rng(config.seed)
    descriptors = np.concatenate([np.zeros((0, 32), np.uint8), *images])
    leaf = _leaves(vocabulary, descriptors)
    tree, level = _Growing.of(vocabulary), _levels(vocabulary).tolist()
    bits = words(descriptors)
    order = np.argsort(leaf, kind="stable")
    starts = np.flatnonzero(np.diff(leaf[order], prepend=-1))
    todo = deque((int(leaf[rows[0]]), rows) for rows in np.split(order, starts[1:]) if len(rows))
    while todo:
        node, rows = todo.popleft()
        if level[node] >= config.depth or len(rows) < config.min_descriptors:
            continue
        centres, nearest = k_majority(bits[rows], config.branching, config.iterations, rng)
        if len(centres) < 2:
            continue
        for child, new in enumerate(tree.add_children(node, centres.view(np.uint8))):
            level.append(level[node] + 1)
            todo.append((new, rows[nearest == child]))
    grown = tree.finish(np.zeros(max(tree.word) + 1, np.float32), vocabulary.direct_level)
    return replace(grown, idf=rarity(grown, images))


def rarity(vocabulary: Vocabulary, images: Sequence[U8]) -> F32:
    """Return log(images / images with the word in it) of each word (W,); a word in none counts as in half an image."""
    n_with = np.zeros(int(vocabulary.word.max()) + 1)
    for image in images:
        n_with[np.unique(vocabulary.quantise(image)[0])] += 1
    return np.log(max(len(images), 1) / np.maximum(n_with, 0.5)).astype(np.float32)


def k_majority(descriptors: U64, k: int, iterations: int, rng: np.random.Generator) -> tuple[U64, I64]:
    """Cluster descriptors (N, 4) uint64: each goes to the nearest centre, each centre's bits to the majority's vote.

    It starts from descriptors far from each other (k-means++). Fewer than k clusters come out where descriptors are
    alike.

    Returns:
        Centres (k', 4), and the cluster (N,) of each descriptor.
    """
    centres = descriptors[_spread_out(descriptors, k, rng)]
    nearest, _ = assign(descriptors, centres)
    for _ in range(iterations):
        centres = vote(descriptors, nearest, centres)
        before = nearest
        nearest, _ = assign(descriptors, centres)
        if np.array_equal(nearest, before):
            break
    used, nearest = np.unique(nearest, return_inverse=True)
    return centres[used], nearest.astype(np.int64)


def _spread_out(descriptors: U64, k: int, rng: np.random.Generator) -> I64:
    """Choose up to k different descriptors, each with a chance as the square of its distance to those before."""
    chosen = [int(rng.integers(len(descriptors)))]
    far = np.full(len(descriptors), 1 << 20, dtype=np.int64)
    while len(chosen) < k:
        far = np.minimum(far, assign(descriptors, descriptors[chosen[-1:]])[1])
        chances = np.cumsum(far.astype(np.float64) ** 2)
        if chances[-1] == 0:
            break
        chosen.append(int(np.searchsorted(chances, rng.random() * chances[-1], side="right")))
    return np.array(chosen, dtype=np.int64)


def _leaves(vocabulary: Vocabulary, descriptors: U8) -> I32:
    leaf_of_word = np.zeros(int(vocabulary.word.max()) + 1, dtype=np.int32)
    leaves = np.flatnonzero(vocabulary.word >= 0)
    leaf_of_word[vocabulary.word[leaves]] = leaves
    found: I32 = leaf_of_word[vocabulary.quantise(descriptors)[0]]
    return found


def _levels(vocabulary: Vocabulary) -> I32:
    """Return the depth of each node (M,); children come after their parents."""
    level = np.zeros(len(vocabulary.centres), dtype=np.int32)
    for node in np.flatnonzero(vocabulary.n_children):
        first = vocabulary.first_child[node]
        level[first : first + vocabulary.n_children[node]] = level[node] + 1
    return level


@njit(nogil=True, cache=True)
def assign(descriptors: U64, centres: U64) -> tuple[I32, I32]:
    """Return the nearest centre (N,) of each descriptor and the bits (N,) between; of equals the first."""
    nearest = np.zeros(len(descriptors), np.int32)
    distance = np.zeros(len(descriptors), np.int32)
    for i in range(len(descriptors)):
        best = 257
        for c in range(len(centres)):
            bits = hamming(descriptors, i, centres, c)
            if bits < best:
                best = bits
                nearest[i] = c
        distance[i] = best
    return nearest, distance


@njit(nogil=True, cache=True)
def vote(descriptors: U64, cluster: I32, centres: U64) -> U64:
    """Return centres (k, 4) whose every bit is what most descriptors of the cluster have; a tie keeps the old bit."""
    k = len(centres)
    ones = np.zeros((k, 256), np.int32)
    size = np.zeros(k, np.int32)
    for i in range(len(descriptors)):
        c = cluster[i]
        size[c] += 1
        for w in range(4):
            word = descriptors[i, w]
            for b in range(64):
                ones[c, 64 * w + b] += np.int32((word >> np.uint64(b)) & np.uint64(1))
    voted = centres.copy()
    for c in range(k):
        for w in range(4):
            for b in range(64):
                bit = np.uint64(1) << np.uint64(b)
                twice = 2 * ones[c, 64 * w + b]
                if twice > size[c]:
                    voted[c, w] |= bit
                elif twice < size[c]:
                    voted[c, w] &= ~bit
    return voted
