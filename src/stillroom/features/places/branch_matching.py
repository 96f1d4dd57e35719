"""Matching two images branch by branch: only keypoints under one node of the tree are compared."""

import numpy as np
from numba import njit

from stillroom.features.matching import NEAR_BITS, one_to_one
from stillroom.geometry.arrays import I32, I64, U8, U64
from stillroom.geometry.hamming import hamming, words


def match_by_branch(
    first: U8, first_nodes: I32, second: U8, second_nodes: I32, max_bits: int = NEAR_BITS, ratio: float = 0.75
) -> tuple[I32, I32]:
    """Match descriptors (N, 32) with (M, 32) by nearest neighbour and ratio test within their branches.

    Args:
        first, second: The descriptors.
        first_nodes, second_nodes: The branch of each, (N,) and (M,), as `Bag.nodes` says; −1 takes no part.
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
