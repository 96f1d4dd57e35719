"""The inverted file and the direct index, held to whole vectors of words."""

import threading

import numpy as np
import pytest

from stillroom.data.map import Covisibility
from stillroom.features.places.place_index import PlaceIndex, Resemblance, best_places, score
from stillroom.features.places.vocabulary import Bag, match_by_branch

N_WORDS = 400


def random_bag(rng: np.random.Generator, n_keypoints: int = 50) -> Bag:
    n = int(rng.integers(20, 120))
    words = np.sort(rng.permutation(N_WORDS)[:n]).astype(np.int32)
    weights = rng.random(n)
    return Bag(words, (weights / weights.sum()).astype(np.float32), rng.integers(-1, 9, n_keypoints).astype(np.int32))


def vector(bag: Bag) -> np.ndarray:
    v = np.zeros(N_WORDS)
    v[bag.words] = bag.weights
    return v


def plain(bags: dict[int, Bag], asked: Bag) -> dict[int, tuple[float, int]]:
    """1 − |v − w|₁ / 2 and the number of common words, of those that have any."""
    answer = {}
    for keyframe, bag in bags.items():
        n_common = len(set(bag.words.tolist()) & set(asked.words.tolist()))
        if n_common:
            answer[keyframe] = (1.0 - 0.5 * float(np.abs(vector(bag) - vector(asked)).sum()), n_common)
    return answer


def same(found: Resemblance, expected: dict[int, tuple[float, int]]) -> None:
    assert found.keyframes.tolist() == sorted(expected)
    np.testing.assert_allclose(found.scores, [expected[k][0] for k in found.keyframes.tolist()], atol=1e-6)
    assert found.n_common.tolist() == [expected[k][1] for k in found.keyframes.tolist()]


@pytest.mark.parametrize("seed", range(3))
def test_queries_are_those_of_whole_vectors_while_keyframes_come_and_go(seed: int) -> None:
    rng = np.random.default_rng(seed)
    index, bags = PlaceIndex(N_WORDS), {}
    for step in range(120):
        if bags and rng.random() < 0.35:
            gone = int(rng.choice(list(bags)))
            index.remove(gone)
            del bags[gone]
        else:
            keyframe = step if rng.random() < 0.9 or not bags else int(rng.choice(list(bags)))
            bags[keyframe] = random_bag(rng)
            index.add(keyframe, bags[keyframe])
        if step % 10 == 0:
            asked = random_bag(rng)
            same(index.query(asked), plain(bags, asked))
            allowed = rng.random(step // 2 + 1) < 0.5
            eligible = {k: bag for k, bag in bags.items() if k < len(allowed) and allowed[k]}
            same(index.query(asked, allowed), plain(eligible, asked))
    assert len(index) == len(bags) > 20
    assert index.keyframes.tolist() == sorted(bags)
    for keyframe, bag in bags.items():
        assert np.array_equal(index.bag(keyframe).words, bag.words)
        assert np.array_equal(index.bag(keyframe).weights, bag.weights)
        assert np.array_equal(index.nodes(keyframe), bag.nodes)


def test_the_same_bag_scores_one_and_strangers_nothing() -> None:
    rng = np.random.default_rng(5)
    bag, other = random_bag(rng), random_bag(rng)
    assert score(bag, bag) == pytest.approx(1.0, abs=1e-6)
    assert score(bag, other) == pytest.approx(1.0 - 0.5 * float(np.abs(vector(bag) - vector(other)).sum()), abs=1e-6)
    stranger = Bag(np.array([N_WORDS - 1], np.int32), np.ones(1, np.float32), np.zeros(1, np.int32))
    low = Bag(np.array([0], np.int32), np.ones(1, np.float32), np.zeros(1, np.int32))
    assert score(stranger, low) == 0.0


def test_what_is_not_in_is_not_there() -> None:
    index = PlaceIndex(N_WORDS)
    index.remove(3)
    assert 3 not in index
    assert len(index.query(random_bag(np.random.default_rng(0)))) == 0
    with pytest.raises(KeyError):
        index.bag(3)


def covisible(edges: dict[tuple[int, int], int], n: int) -> Covisibility:
    graph = Covisibility()
    for keyframe in range(n):
        counts = np.zeros(n, np.int32)
        for (a, b), weight in edges.items():
            if keyframe in (a, b):
                counts[b if keyframe == a else a] = weight
        graph.connect(keyframe, counts)
    return graph


def resemblance(*rows: tuple[int, float, int]) -> Resemblance:
    keyframes, scores, n_common = zip(*rows, strict=True)
    return Resemblance(np.array(keyframes, np.int32), np.array(scores), np.array(n_common, np.int32))


def test_a_place_that_several_neighbours_know_beats_a_single_better_keyframe() -> None:
    graph = covisible({(1, 2): 50, (2, 3): 50}, 6)
    found = resemblance((1, 0.2, 90), (2, 0.3, 95), (3, 0.25, 85), (5, 0.5, 100))
    assert best_places(found, graph).tolist() == [2]
    assert best_places(resemblance((1, 0.2, 90), (5, 0.5, 100)), graph).tolist() == [5]


def test_keyframes_with_few_common_words_or_a_low_score_have_no_say() -> None:
    graph = covisible({(1, 2): 50}, 4)
    found = resemblance((1, 0.3, 100), (2, 0.9, 79), (3, 0.29, 81))
    assert best_places(found, graph).tolist() == [1, 3]
    assert best_places(found, graph, min_score=0.295).tolist() == [1]
    assert best_places(found, graph, min_score=0.95).tolist() == []


def test_branches_are_matched_as_if_there_were_nothing_else() -> None:
    rng = np.random.default_rng(1)
    second = rng.integers(0, 256, (300, 32), dtype=np.uint8)
    bits = np.unpackbits(second[rng.permutation(300)[:250]], axis=1)
    for row in bits:
        row[rng.permutation(256)[: rng.integers(0, 60)]] ^= 1
    first = np.packbits(bits, axis=1)
    nodes1, nodes2 = (rng.integers(-1, 6, n).astype(np.int32) for n in (len(first), len(second)))
    found: dict[int, tuple[int, int]] = {}
    for i, descriptor in enumerate(first):
        place = np.flatnonzero(nodes2 == nodes1[i]) if nodes1[i] >= 0 else np.zeros(0, np.int64)
        distance = np.unpackbits(second[place] ^ descriptor, axis=1).sum(axis=1, dtype=np.int64)
        order = np.argsort(distance, kind="stable")
        if len(order) == 0 or distance[order[0]] > 50:
            continue
        if len(order) > 1 and distance[order[0]] >= 0.75 * distance[order[1]]:
            continue
        j, d = int(place[order[0]]), int(distance[order[0]])
        if j not in found or d < found[j][1]:
            found[j] = (i, d)
    mine, theirs = match_by_branch(first, nodes1, second, nodes2)
    assert dict(zip(theirs.tolist(), mine.tolist(), strict=True)) == {j: i for j, (i, _) in found.items()}
    assert len(mine) > 20


def test_it_can_be_asked_while_another_thread_adds() -> None:
    rng = np.random.default_rng(3)
    bags = [random_bag(rng) for _ in range(400)]
    index = PlaceIndex(N_WORDS)
    index.add(0, bags[0])
    seen: list[Resemblance] = []

    def fill() -> None:
        for keyframe, bag in enumerate(bags):
            index.add(keyframe, bag)
            if keyframe % 3 == 1:
                index.remove(keyframe - 1)

    thread = threading.Thread(target=fill)
    thread.start()
    while thread.is_alive():
        seen.append(index.query(bags[0]))
    thread.join()
    for found in seen:
        expected = plain({k: bags[k] for k in found.keyframes.tolist()}, bags[0])
        same(found, expected)
    left = {k: bag for k, bag in enumerate(bags) if k in index}
    same(index.query(bags[5]), plain(left, bags[5]))
