"""The searches written plainly: all pairs, one condition a line."""

import numpy as np

from stillroom.features.matching import Queries, Targets


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


def best_two(bits: np.ndarray, allowed: np.ndarray) -> tuple[int, int, int]:
    """Return the nearest allowed target, and nearest and second nearest distance; −1 and 257 where there is none."""
    order = sorted(np.flatnonzero(allowed), key=lambda i: bits[i])
    nearest = int(order[0]) if order else -1
    return nearest, int(bits[order[0]]) if order else 257, int(bits[order[1]]) if len(order) > 1 else 257


def windows_allow(queries: Queries, targets: Targets, q: int) -> np.ndarray:
    """Tell which targets (N,) lie in the window of query q."""
    allowed = targets.usable & (targets.octave >= queries.min_octave[q]) & (targets.octave <= queries.max_octave[q])
    allowed &= (np.abs(targets.px - queries.px[q]) <= queries.radius_px[q]).all(axis=1)
    if queries.right_px[q] >= 0:
        apart = np.abs(targets.right_px - queries.right_px[q]) > queries.radius_px[q]
        allowed &= ~((targets.right_px >= 0) & apart)
    return allowed


def search_windows_plainly(queries: Queries, targets: Targets, max_bits: int, ratio: float) -> dict[int, int]:
    """Query → target of the windowed search. Random descriptors only: equal distances are not decided as the kernel."""
    bits = bits_between(queries.descriptors, targets.descriptors)
    wanted = {}
    for q in range(len(queries.px)):
        allowed = windows_allow(queries, targets, q)
        nearest, best, second = best_two(bits[q], allowed)
        if nearest < 0 or best > max_bits:
            continue
        others = np.flatnonzero(allowed & (bits[q] == second))
        rivals = [i for i in others if i != nearest and targets.octave[i] == targets.octave[nearest]]
        if rivals and best > ratio * second:
            continue
        wanted[q] = (nearest, best)
    return one_to_one(wanted)
