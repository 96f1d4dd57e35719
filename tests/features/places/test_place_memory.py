"""What a map remembers of its places, from the first keyframe to the culled ones."""

from pathlib import Path

import numpy as np
import pytest
from ring_map import vocabulary_of
from small_world import SmallMap, SmallWorld, pose

from stillroom.features.places.growth import GrowthConfig
from stillroom.features.places.place_index import PlaceMemory, PlacesConfig
from stillroom.features.places.vocabulary import load_vocabulary

SHIPPED_MB = 3.0


@pytest.fixture
def small() -> SmallMap:
    """Three keyframes here, three four metres further on."""
    world = SmallWorld.of(0, 900)
    poses = [pose(0.1 * k) for k in range(3)] + [pose(0.1 * k, turn=(0, 0.9, 0)) for k in range(3)]
    return SmallMap.of(world, poses)


@pytest.fixture
def memory(small: SmallMap) -> PlaceMemory:
    found = PlaceMemory(vocabulary_of(small.world), small.map)
    for keyframe in range(6):
        found.remember(keyframe)
    return found


def test_the_most_similar_place_comes_first(small: SmallMap, memory: PlaceMemory) -> None:
    for x, turn, group in ((0.15, 0.0, {0, 1, 2}), (0.05, 0.9, {3, 4, 5})):
        frame, _ = small.world.look(pose(x, turn=(0, turn, 0)), seed=9, flips=8)
        found = memory.candidates(memory.bag_of_frame(frame))
        assert int(found[0]) in group
        elsewhere = np.array([keyframe not in group for keyframe in range(6)])
        others = memory.candidates(memory.bag_of_frame(frame), elsewhere, at_most=1)
        assert len(others) <= 1
        assert not set(others.tolist()) & group


def test_movable_keypoints_have_no_say(small: SmallMap, memory: PlaceMemory) -> None:
    table, rows = small.map.keypoints, small.map.rows(2)
    static = np.arange(rows.stop - rows.start) % 3 != 0
    table.is_static[rows] = static
    memory.remember(2)
    alone = memory.vocabulary.bag(table.descriptors[rows][static])
    said = memory.index.bag(2)
    np.testing.assert_array_equal(said.words, alone.words)
    np.testing.assert_array_equal(said.weights, alone.weights)
    assert np.array_equal(memory.index.nodes(2) >= 0, static)
    frame = small.frames[2].with_static(static)
    np.testing.assert_array_equal(memory.bag_of_frame(frame).words, alone.words)


def test_culled_keyframes_leave_and_a_map_from_a_file_is_taken_in(small: SmallMap, memory: PlaceMemory) -> None:
    small.map.remove_keyframe(4)
    memory.remember(5)
    assert memory.index.keyframes.tolist() == [0, 1, 2, 3, 5]
    small.map.remove_keyframe(3)
    frame, _ = small.world.look(pose(turn=(0, 0.9, 0)), seed=9)
    assert memory.candidates(memory.bag_of_frame(frame))[0] == 5
    fresh = PlaceMemory(memory.vocabulary, small.map)
    fresh.remember_all()
    assert fresh.index.keyframes.tolist() == [0, 1, 2, 5]
    for keyframe in (0, 1, 2, 5):
        np.testing.assert_array_equal(fresh.index.bag(keyframe).words, memory.index.bag(keyframe).words)


def test_the_tree_grows_on_the_runs_own_keyframes(small: SmallMap) -> None:
    config = PlacesConfig(grow_every=6, growth=GrowthConfig(branching=4, depth=12, min_descriptors=8))
    memory = PlaceMemory(vocabulary_of(small.world), small.map, config)
    before = memory.vocabulary
    for keyframe in range(5):
        memory.remember(keyframe)
    assert memory.vocabulary is before
    memory.remember(5)
    assert memory.vocabulary.n_words > before.n_words
    assert memory.index.keyframes.tolist() == [0, 1, 2, 3, 4, 5]
    frame, _ = small.world.look(pose(0.1, turn=(0, 0.9, 0)), seed=9, flips=8)
    assert int(memory.candidates(memory.bag_of_frame(frame))[0]) in {3, 4, 5}


def test_the_shipped_vocabulary_is_small_and_says_where_it_is_from() -> None:
    folder = Path(__file__).parents[3] / "src/stillroom/features/places"
    assert (folder / "default.vocabulary").stat().st_size < SHIPPED_MB * 1e6
    vocabulary = load_vocabulary()
    assert vocabulary.n_words > 10_000
    card = (folder / "default.vocabulary.txt").read_text(encoding="utf-8")
    assert vocabulary.digest in card
    assert f"{vocabulary.n_words} words" in card
    assert load_vocabulary() is vocabulary
