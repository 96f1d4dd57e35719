"""Counting bits, which numba does not offer by itself."""

from typing import Any

import numpy as np
from numba import types
from numba.extending import intrinsic

from stillroom.compiled import njit
from stillroom.geometry.arrays import U8, U64


@intrinsic
def popcount64(typing_context: Any, word: Any) -> Any:
    """Count the set bits of an unsigned 64-bit word (inside kernels only)."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.ctpop(args[0])

    return types.int64(types.uint64), codegen


@njit(nogil=True, cache=True)
def hamming(first: U64, i: int, second: U64, j: int) -> int:
    """Return the bits in which row i of `first` (N, 4) uint64 differs from row j of `second` (M, 4) uint64."""
    distance = 0
    for w in range(4):
        distance += popcount64(first[i, w] ^ second[j, w])
    return distance


def words(descriptors: U8) -> U64:
    """View descriptors (N, 32) uint8 as words (N, 4) uint64 for the kernels."""
    view: U64 = np.ascontiguousarray(descriptors).view(np.uint64).reshape(-1, 4)
    return view
