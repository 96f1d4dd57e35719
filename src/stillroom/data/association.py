"""Association of two lists of timestamps."""

from bisect import bisect_left, insort

import numpy as np

from stillroom.geometry.arrays import F64, I64

TUM_MAX_GAP_S = 0.02
"""The largest gap that TUM's tools accept (docs/reference.md#tum-rgb-d-association)."""


def associate(first_s: F64, second_s: F64, max_gap_s: float = TUM_MAX_GAP_S) -> tuple[I64, I64]:
    """Pair times one to one, the smallest gaps first.

    One to one matters: nearest-neighbour pairing uses one depth image twice and leaves another out, and pairs with
    gaps several times as large (docs/reference.md#tum-rgb-d-association). Pairs never cross in time, so both results
    are in order.

    Args:
        first_s: Times (N,) float64 [s], in any order.
        second_s: Times (M,) float64 [s], in any order.
        max_gap_s: Pairs further apart than this are left out [s].

    Returns:
        Indices (K,) into the first and (K,) into the second, in order of time.
    """
    first_order, second_order = np.argsort(first_s, kind="stable"), np.argsort(second_s, kind="stable")
    first, second = _candidates(first_s[first_order], second_s[second_order], max_gap_s)
    chosen: list[tuple[int, int]] = []
    used_first, used_second = set[int](), set[int]()
    for i, j in zip(first.tolist(), second.tolist(), strict=True):
        if i in used_first or j in used_second or _crosses(chosen, i, j):
            continue
        insort(chosen, (i, j))
        used_first.add(i)
        used_second.add(j)
    pairs = np.array(chosen, dtype=np.int64).reshape(-1, 2)
    return first_order[pairs[:, 0]], second_order[pairs[:, 1]]


def closest(sorted_s: F64, wanted_s: F64) -> I64:
    """Return the index (K,) of the time closest to each wanted time (K,)."""
    if len(sorted_s) == 1:
        return np.zeros(len(wanted_s), dtype=np.int64)
    right = np.clip(np.searchsorted(sorted_s, wanted_s), 1, len(sorted_s) - 1)
    left_is_closer = wanted_s - sorted_s[right - 1] <= sorted_s[right] - wanted_s
    return np.asarray(right - left_is_closer, dtype=np.int64)


def _candidates(first_s: F64, second_s: F64, max_gap_s: float) -> tuple[I64, I64]:
    """Return all pairs (K,), (K,) within the gap of two sorted lists, the smallest gap first."""
    # A little slack, then the exact test: sums of times near 1e9 s round.
    low = np.searchsorted(second_s, first_s - max_gap_s - 1e-6, side="left")
    high = np.searchsorted(second_s, first_s + max_gap_s + 1e-6, side="right")
    counts = np.where(np.isfinite(first_s), high - low, 0)
    first = np.repeat(np.arange(len(first_s)), counts)
    starts = np.repeat(np.cumsum(counts) - counts, counts)
    second = np.repeat(low, counts) + np.arange(counts.sum()) - starts
    gaps_s = np.abs(first_s[first] - second_s[second])
    close = gaps_s <= max_gap_s
    first, second = first[close], second[close]
    order = np.argsort(gaps_s[close], kind="stable")
    return first[order], second[order]


def _crosses(chosen: list[tuple[int, int]], i: int, j: int) -> bool:
    """Return whether a pair would swap the order of time with one of the sorted pairs chosen so far."""
    place = bisect_left(chosen, (i, j))
    behind = place > 0 and chosen[place - 1][1] > j
    return behind or (place < len(chosen) and chosen[place][1] < j)
