"""The tree of words, its training and its file, held to plain numpy."""

from pathlib import Path

import numpy as np
import pytest

from stillroom.errors import VocabularyError
from stillroom.features.places.growth import GrowthConfig, grow, k_majority, rarity
from stillroom.features.places.vocabulary import Bag, Vocabulary, load_vocabulary
from stillroom.geometry.hamming import words
from stillroom_train.vocabulary import train

SHAPE = GrowthConfig(branching=4, depth=3, min_descriptors=8)


def distances(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Bits between all pairs, (N, M)."""
    return np.unpackbits(first[:, None] ^ second[None], axis=2).sum(axis=2, dtype=np.int64)


def blurred_copies(seed: int, n_kinds: int = 40, n: int = 3000, flips: int = 12) -> tuple[np.ndarray, np.ndarray]:
    """Descriptors that are copies of a few with some bits turned over, and which one each is of."""
    rng = np.random.default_rng(seed)
    kinds = rng.integers(0, 256, (n_kinds, 32), dtype=np.uint8)
    of = rng.integers(0, n_kinds, n)
    bits = np.unpackbits(kinds[of], axis=1)
    for row in bits:
        row[rng.permutation(256)[:flips]] ^= 1
    return np.packbits(bits, axis=1), of


def images_of(descriptors: np.ndarray, size: int = 100) -> list[np.ndarray]:
    return [descriptors[i : i + size] for i in range(0, len(descriptors), size)]


@pytest.fixture(scope="module")
def trained() -> tuple[Vocabulary, np.ndarray]:
    descriptors, _ = blurred_copies(0)
    return train(images_of(descriptors), SHAPE), descriptors


def plain_descent(vocabulary: Vocabulary, descriptor: np.ndarray) -> tuple[int, int]:
    node, path = 0, [0]
    while vocabulary.n_children[node]:
        first = int(vocabulary.first_child[node])
        children = vocabulary.centres[first : first + int(vocabulary.n_children[node])]
        node = first + int(np.argmin(distances(descriptor[None], children)[0]))
        path.append(node)
    return int(vocabulary.word[node]), path[min(vocabulary.direct_level, len(path) - 1)]


def test_quantising_is_the_plain_descent(trained: tuple[Vocabulary, np.ndarray]) -> None:
    vocabulary, descriptors = trained
    word, node = vocabulary.quantise(descriptors[:300])
    expected = [plain_descent(vocabulary, descriptor) for descriptor in descriptors[:300]]
    assert list(zip(word.tolist(), node.tolist(), strict=True)) == expected
    assert len(set(word.tolist())) > 20
    assert len(set(node.tolist())) > 8


def test_every_word_has_one_leaf_and_children_lie_beneath(trained: tuple[Vocabulary, np.ndarray]) -> None:
    vocabulary, _ = trained
    leaves = np.flatnonzero(vocabulary.n_children == 0)
    assert sorted(vocabulary.word[leaves].tolist()) == list(range(vocabulary.n_words))
    assert np.all(vocabulary.word[vocabulary.n_children > 0] == -1)
    children = [
        child
        for node in np.flatnonzero(vocabulary.n_children)
        for child in range(vocabulary.first_child[node], vocabulary.first_child[node] + vocabulary.n_children[node])
    ]
    assert sorted(children) == list(range(1, len(vocabulary.centres)))


def test_centres_are_the_majority_of_their_descriptors_and_nearest_to_them() -> None:
    descriptors, _ = blurred_copies(1, n_kinds=5, n=400)
    centres, nearest = k_majority(words(descriptors), 5, 20, np.random.default_rng(0))
    centre_bytes = centres.view(np.uint8)
    assert np.array_equal(nearest, np.argmin(distances(descriptors, centre_bytes), axis=1))
    for cluster in range(len(centres)):
        share = np.unpackbits(descriptors[nearest == cluster], axis=1).mean(axis=0)
        bits = np.unpackbits(centre_bytes[cluster])
        assert np.array_equal(bits[share != 0.5], (share > 0.5)[share != 0.5])


def test_clusters_of_clear_kinds_are_the_kinds() -> None:
    descriptors, kind = blurred_copies(2, n_kinds=4, n=400, flips=8)
    _, nearest = k_majority(words(descriptors), 4, 20, np.random.default_rng(3))
    pairs = set(zip(kind.tolist(), nearest.tolist(), strict=True))
    assert len(pairs) == 4


def test_descriptors_that_are_all_alike_make_one_cluster() -> None:
    centres, nearest = k_majority(words(np.full((50, 32), 7, np.uint8)), 4, 5, np.random.default_rng(0))
    assert len(centres) == 1
    assert not nearest.any()


def test_training_repeats_and_a_seed_matters() -> None:
    images = images_of(blurred_copies(3)[0])
    first, again = train(images, SHAPE), train(images, SHAPE)
    other = train(images, GrowthConfig(branching=4, depth=3, min_descriptors=8, seed=1))
    assert first.digest == again.digest != other.digest


def test_rarity_is_the_log_of_images_over_images_with_the_word(trained: tuple[Vocabulary, np.ndarray]) -> None:
    vocabulary, descriptors = trained
    images = images_of(descriptors)
    said = [set(vocabulary.quantise(image)[0].tolist()) for image in images]
    for word in range(0, vocabulary.n_words, 7):
        n_with = sum(word in image for image in said)
        assert rarity(vocabulary, images)[word] == pytest.approx(np.log(len(images) / n_with), rel=1e-6)


def test_a_bag_weighs_words_by_number_and_rarity_and_leaves_movable_keypoints_out(
    trained: tuple[Vocabulary, np.ndarray],
) -> None:
    vocabulary, descriptors = trained
    image = np.concatenate((descriptors[:60], descriptors[:20]))
    usable = np.arange(80) % 3 != 0
    bag = vocabulary.bag(image, usable)
    word, node = vocabulary.quantise(image)
    weights = np.zeros(vocabulary.n_words)
    for one in word[usable]:
        weights[one] += vocabulary.idf[one]
    weights /= weights.sum()
    assert bag.words.tolist() == np.flatnonzero(weights).tolist()
    np.testing.assert_allclose(bag.weights, weights[bag.words], rtol=1e-5)
    assert np.array_equal(bag.nodes, np.where(usable, node, -1))


def test_an_image_without_keypoints_says_nothing(trained: tuple[Vocabulary, np.ndarray]) -> None:
    bag: Bag = trained[0].bag(np.zeros((0, 32), np.uint8))
    assert len(bag) == len(bag.nodes) == 0


def test_growing_splits_full_words_only_and_keeps_the_others(trained: tuple[Vocabulary, np.ndarray]) -> None:
    vocabulary, _ = trained
    own, _ = blurred_copies(9, n_kinds=60)
    grown = grow(vocabulary, images_of(own), GrowthConfig(branching=4, depth=5, min_descriptors=30))
    assert grown.n_words > vocabulary.n_words
    n_old = len(vocabulary.centres)
    assert np.array_equal(grown.centres[:n_old], vocabulary.centres)
    counts = np.bincount(vocabulary.quantise(own)[0], minlength=vocabulary.n_words)
    was_leaf = vocabulary.n_children == 0
    split = was_leaf & (grown.n_children[:n_old] > 0)
    assert split.any()
    assert np.all(counts[vocabulary.word[split]] >= 30)
    kept = was_leaf & ~split
    assert np.array_equal(grown.word[:n_old][kept], vocabulary.word[kept])
    word, _ = grown.quantise(own[:100])
    assert word.tolist() == [plain_descent(grown, descriptor)[0] for descriptor in own[:100]]


def test_too_little_to_train_from_is_said() -> None:
    with pytest.raises(VocabularyError, match="30 descriptors are too few"):
        train([np.zeros((30, 32), np.uint8)], SHAPE)


def test_the_file_gives_the_same_vocabulary_and_the_same_bytes(
    trained: tuple[Vocabulary, np.ndarray], tmp_path: Path
) -> None:
    vocabulary, descriptors = trained
    for name in ("a", "b"):
        vocabulary.save(tmp_path / name)
    read = load_vocabulary(tmp_path / "a")
    assert read.digest == vocabulary.digest
    assert np.array_equal(read.quantise(descriptors)[0], vocabulary.quantise(descriptors)[0])
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_what_is_no_vocabulary_is_said_in_a_line(trained: tuple[Vocabulary, np.ndarray], tmp_path: Path) -> None:
    with pytest.raises(VocabularyError, match="no such file"):
        load_vocabulary(tmp_path / "nowhere")
    trained[0].save(tmp_path / "whole")
    whole = (tmp_path / "whole").read_bytes()
    cases = {"empty": b"", "text": b"hello\n", "half": whole[: len(whole) // 2], "bent": _bent(whole)}
    for name, content in cases.items():
        (tmp_path / name).write_bytes(content)
        with pytest.raises(VocabularyError) as caught:
            load_vocabulary(tmp_path / name)
        assert str(tmp_path / name) in str(caught.value)
        assert "\n" not in str(caught.value)


def _bent(whole: bytes) -> bytes:
    """The file with some of its bytes turned over in the middle."""
    middle = len(whole) // 2
    return whole[:middle] + bytes(255 - byte for byte in whole[middle : middle + 64]) + whole[middle + 64 :]


def test_a_tree_that_leads_nowhere_is_refused(trained: tuple[Vocabulary, np.ndarray], tmp_path: Path) -> None:
    good = trained[0]
    wild = good.first_child.copy()
    wild[0] = len(good.centres)
    circular = good.first_child.copy()
    inner = np.flatnonzero(good.n_children)[1]
    circular[inner] = 0
    for name, first_child in (("wild", wild), ("circular", circular)):
        bad = Vocabulary(good.centres, first_child, good.n_children, good.word, good.idf)
        bad.save(tmp_path / name)
        with pytest.raises(VocabularyError, match="inconsistent"):
            load_vocabulary(tmp_path / name)
