"""Counting bits."""

import numpy as np
from numba import njit

from stillroom.geometry.hamming import hamming, popcount64, words


@njit
def _count(word: np.uint64) -> int:
    return popcount64(word)


def test_popcount_is_pythons() -> None:
    rng = np.random.default_rng(0)
    values = [0, 1, 2**63, 2**64 - 1, 2**32, *rng.integers(0, 2**64, 500, dtype=np.uint64).tolist()]
    assert [_count(np.uint64(value)) for value in values] == [value.bit_count() for value in values]


def test_distance_of_descriptors_is_the_number_of_different_bits() -> None:
    rng = np.random.default_rng(1)
    first, second = rng.integers(0, 256, (2, 40, 32), dtype=np.uint8)
    second[0], second[1] = first[0], ~first[1]
    for i in range(40):
        expected = int((np.unpackbits(first[i]) != np.unpackbits(second[i])).sum())
        assert hamming(words(first), i, words(second), i) == expected
    assert hamming(words(first), 0, words(second), 0) == 0
    assert hamming(words(first), 1, words(second), 1) == 256


def test_words_of_any_layout_hold_the_same_bytes() -> None:
    descriptors = np.random.default_rng(2).integers(0, 256, (10, 64), dtype=np.uint8)[::2, ::2]
    assert not descriptors.flags.c_contiguous
    assert words(descriptors).tobytes() == descriptors.tobytes()
    assert words(descriptors).shape == (5, 4)
    assert words(np.zeros((0, 32), np.uint8)).shape == (0, 4)
