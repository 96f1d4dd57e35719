"""Matching by descriptors alone, and the histogram of rotations."""

import cv2
import numpy as np
import pytest
from plain_search import one_to_one

from stillroom.features.matching import consistent_rotation, match_anywhere


def similar_sets(seed: int, n: int = 300, m: int = 350) -> tuple[np.ndarray, np.ndarray]:
    """Descriptors of which many are turned-over copies of each other, by 0 to 80 bits."""
    rng = np.random.default_rng(seed)
    second = rng.integers(0, 256, (m, 32), dtype=np.uint8)
    bits = np.unpackbits(second[rng.integers(0, m, n)], axis=1)
    for row in bits:
        row[rng.permutation(256)[: rng.integers(0, 80)]] ^= 1
    return np.packbits(bits, axis=1), second


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("max_bits", "ratio"), [(50, 0.7), (50, 0.75), (70, 0.5), (100, 0.9)])
def test_matches_are_opencvs_nearest_neighbours_with_the_ratio_test(seed: int, max_bits: int, ratio: float) -> None:
    first, second = similar_sets(seed)
    wanted = {}
    for near, next_near in cv2.BFMatcher(cv2.NORM_HAMMING).knnMatch(first, second, k=2):
        if near.distance <= max_bits and near.distance < ratio * next_near.distance:
            wanted[near.queryIdx] = (near.trainIdx, int(near.distance))
    expected = one_to_one(wanted)
    query, target = match_anywhere(first, second, max_bits, ratio)
    assert len(expected) > 100
    assert dict(zip(query.tolist(), target.tolist(), strict=True)) == expected


def test_of_two_who_want_the_same_the_nearer_gets_it() -> None:
    second = np.zeros((1, 32), np.uint8)
    first = np.zeros((3, 32), np.uint8)
    first[0, 0], first[1, 0], first[2, 0] = 7, 1, 3
    query, target = match_anywhere(first, second)
    assert query.tolist() == [1]
    assert target.tolist() == [0]


@pytest.mark.parametrize(("n", "m"), [(0, 0), (0, 4), (4, 0)])
def test_empty_sets_have_no_matches(n: int, m: int) -> None:
    query, target = match_anywhere(np.zeros((n, 32), np.uint8), np.zeros((m, 32), np.uint8))
    assert len(query) == len(target) == 0


@pytest.mark.parametrize("turn_rad", [-3.0, -1.0, -0.05, 0.0, 0.05, 0.5, 2.0, np.pi])
def test_a_common_turn_is_kept_and_strays_are_not(turn_rad: float) -> None:
    rng = np.random.default_rng(0)
    second = rng.uniform(-np.pi, np.pi, 200)
    off = np.where(np.arange(200) < 170, rng.uniform(-0.05, 0.05, 200), rng.uniform(0.7, 2 * np.pi - 0.7, 200))
    first = np.angle(np.exp(1j * (second + turn_rad + off)))
    steady = consistent_rotation(first.astype(np.float32), second.astype(np.float32))
    # A turn that falls on the border of two bins may lose a few to the rarer one.
    assert steady[:170].mean() > 0.9
    assert steady[170:].mean() < 0.2


def test_only_three_turns_are_kept_and_the_rarer_only_with_a_tenth_of_the_first() -> None:
    width = 2 * np.pi / 30
    turns = np.repeat(width * np.array([2, 9, 15, 21]), [50, 20, 10, 8])
    np.testing.assert_array_equal(consistent_rotation(turns, np.zeros(88)), np.repeat([1, 1, 1, 0], [50, 20, 10, 8]))
    turns = np.repeat(width * np.array([2, 9, 15]), [50, 5, 4])
    np.testing.assert_array_equal(consistent_rotation(turns, np.zeros(59)), np.repeat([1, 1, 0], [50, 5, 4]))


def test_a_camera_that_does_not_roll_loses_no_match_to_either_side() -> None:
    turns = np.linspace(-0.3, 0.3, 301)
    assert consistent_rotation(turns, np.zeros(301)).all()


def test_no_matches_have_no_turn() -> None:
    assert consistent_rotation(np.zeros(0, np.float32), np.zeros(0, np.float32)).shape == (0,)
