"""The searches written plainly: all pairs, one condition a line."""

import numpy as np

from stillroom.features.matching import CELL_PX, Queries, Targets


def bits_between(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Differing bits of all pairs of descriptors (N, 32) and (M, 32), (N, M)."""
    ones = np.array([bin(value).count("1") for value in range(256)])
    return ones[first[:, None] ^ second[None]].sum(axis=2)


def one_to_one(wanted: dict[int, tuple[int, int]]) -> dict[int, int]:
    """From query → (target, bits) keep for each target the query with fewest bits, of equals the first."""
    owner: dict[int, int] = {}
    for query in sorted(wanted, key=lambda q: (wanted[q][1], q)):
        owner.setdefault(wanted[query][0], query)
    return {query: target for query, (target, _) in wanted.items() if owner[target] == query}


def best_two(bits: np.ndarray, allowed: np.ndarray) -> tuple[int, int]:
    """Return the nearest and the second nearest allowed target, of equals the first in order; −1 for none."""
    order = sorted(np.flatnonzero(allowed).tolist(), key=lambda i: bits[i])
    return (*order, -1, -1)[:2]


def windows_allow(queries: Queries, targets: Targets, q: int) -> np.ndarray:
    """Return which targets (N,) lie in the window of query q."""
    allowed = targets.usable & (targets.octave >= queries.min_octave[q]) & (targets.octave <= queries.max_octave[q])
    allowed &= (np.abs(targets.px - queries.px[q]) <= queries.radius_px[q]).all(axis=1)
    if queries.right_px[q] >= 0:
        apart = np.abs(targets.right_px - queries.right_px[q]) > queries.radius_px[q]
        allowed &= ~((targets.right_px >= 0) & apart)
    return allowed


def search_windows_plainly(queries: Queries, targets: Targets, max_bits: int, ratio: float) -> dict[int, int]:
    """Query → target of the windowed search."""
    # Of equals the one in the first cell counts, row by row.
    row, column = np.floor((targets.px - targets.px.min(axis=0)) / CELL_PX).T[::-1]
    order = np.lexsort((column, row))
    bits, wanted = bits_between(queries.descriptors, targets.descriptors)[:, order], {}
    for q in range(len(queries.px)):
        nearest, second = best_two(bits[q], windows_allow(queries, targets, q)[order])
        if nearest < 0 or bits[q, nearest] > max_bits:
            continue
        is_rival = second >= 0 and targets.octave[order[second]] == targets.octave[order[nearest]]
        if is_rival and bits[q, nearest] > ratio * bits[q, second]:
            continue
        wanted[q] = (int(order[nearest]), int(bits[q, nearest]))
    return one_to_one(wanted)
