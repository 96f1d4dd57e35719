"""Descriptor matching: in a window, along epipolar lines, or over the whole image (ORB-SLAM2's searches)."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from stillroom.compiled import njit
from stillroom.geometry.arrays import F32, F64, I32, U8, U64, Bool, Floats, Ints
from stillroom.geometry.hamming import hamming, words

# Keypoints sorted into square cells, so that a window is searched and not the whole image.


CELL_PX = 16.0


class Grid(NamedTuple):
    """Cells row by row over the extent of the keypoints.

    Attributes:
        origin_px: Corner of the first cell (2,) float32 [px].
        shape: Rows and columns of cells (2,) int32.
        start: Where each cell's keypoints start in `order` (cells + 1,) int32.
        order: Indices of the keypoints, cell after cell (N,) int32.
    """

    origin_px: F32
    shape: I32
    start: I32
    order: I32


def build_grid(px: F32) -> Grid:
    """Sort keypoints (N, 2) [px] into cells."""
    return Grid(*_sort_into_cells(px))


@njit(nogil=True, cache=True)
def _sort_into_cells(px: F32) -> tuple[F32, I32, I32, I32]:
    origin_px, far_px = np.zeros(2, np.float32), np.zeros(2, np.float32)
    for i in range(len(px)):
        for k in range(2):
            origin_px[k] = px[i, k] if i == 0 else min(origin_px[k], px[i, k])
            far_px[k] = px[i, k] if i == 0 else max(far_px[k], px[i, k])
    shape = np.empty(2, np.int32)
    shape[0] = int((far_px[1] - origin_px[1]) / CELL_PX) + 1
    shape[1] = int((far_px[0] - origin_px[0]) / CELL_PX) + 1
    n_cells = shape[0] * shape[1]
    cell = np.empty(len(px), np.int32)
    start = np.zeros(n_cells + 1, np.int32)
    for i in range(len(px)):
        column = int((px[i, 0] - origin_px[0]) / CELL_PX)
        row = int((px[i, 1] - origin_px[1]) / CELL_PX)
        cell[i] = row * shape[1] + column
        start[cell[i] + 1] += 1
    for c in range(n_cells):
        start[c + 1] += start[c]
    fill = start[:-1].copy()
    order = np.empty(len(px), np.int32)
    for i in range(len(px)):
        order[fill[cell[i]]] = i
        fill[cell[i]] += 1
    return origin_px, shape, start, order


FAR_BITS = 100
"""Descriptors further apart than this never match when there is a window to search in (ORB-SLAM2's TH_HIGH)."""
NEAR_BITS = 50
"""The same where there is none (TH_LOW)."""
_HISTOGRAM_BINS = 30


@dataclass(frozen=True)
class Queries:
    """Q descriptors to find in an image.

    Attributes:
        px: Predicted positions (Q, 2) float32 [px, undistorted].
        radius_px: Search radius (Q,) float32.
        min_octave, max_octave: Levels to look on (Q,) int32, both included.
        right_px: Expected right coordinate (Q,) float32; −1 where not known.
        descriptors: (Q, 32) uint8, or a table (R, 32) of which `row` is some.
        row: Row of `descriptors` of each (Q,) int32; None for all in order.
    """

    px: F32
    radius_px: F32
    min_octave: I32
    max_octave: I32
    right_px: F32
    descriptors: U8
    row: I32 | None = None


@dataclass(frozen=True)
class Targets:
    """N keypoints to search among; `usable` (N,) leaves out those that are matched or dynamic."""

    px: F32
    octave: I32
    right_px: F32
    descriptors: U8
    usable: Bool


def search_windows(queries: Queries, targets: Targets, max_bits: int = FAR_BITS, ratio: float = 1.0) -> tuple[I32, I32]:
    """Find for each query the nearest descriptor in its window.

    Args:
        queries: What to find.
        targets: Where.
        max_bits: Largest distance of descriptors.
        ratio: The best must be nearer than this share of the second best of the same octave; 1 switches it off.

    Returns:
        Query (M,) and target (M,) of each match; a target of several queries goes to the nearest of them.
    """
    grid = build_grid(targets.px)
    q, t = queries, targets
    row = np.arange(len(q.px), dtype=np.int32) if q.row is None else q.row
    target, bits = _search_windows(
        _Wanted(q.px, q.radius_px, q.min_octave, q.max_octave, q.right_px, words(q.descriptors), row),
        _TargetArrays(t.px, t.octave, t.right_px, words(t.descriptors), t.usable),
        grid,
        max_bits,
        ratio,
    )
    return one_to_one(target, bits, len(targets.px))


class _Wanted(NamedTuple):
    """`Queries` as the kernel takes them; descriptors as words (R, 4)."""

    px: F32
    radius_px: F32
    min_octave: I32
    max_octave: I32
    right_px: F32
    words: U64
    row: I32


class _TargetArrays(NamedTuple):
    """`Targets` as the kernels take them; descriptors as words (N, 4)."""

    px: F32
    octave: I32
    right_px: F32
    words: U64
    usable: Bool


@njit(nogil=True, cache=True)
def _search_windows(wanted: _Wanted, there: _TargetArrays, grid: Grid, max_bits: int, ratio: float) -> tuple[I32, I32]:
    query_px, radius_px, min_octave, max_octave, query_right_px, query_words, query_row = wanted
    px, octave, right_px, target_words, usable = there
    origin_px, shape, start, order = grid
    n = len(query_px)
    found = np.full(n, -1, np.int32)
    found_bits = np.full(n, 257, np.int32)
    for q in range(n):
        x, y, r = query_px[q, 0], query_px[q, 1], radius_px[q]
        c0 = max(0, int(np.floor((x - r - origin_px[0]) / CELL_PX)))
        c1 = min(shape[1] - 1, int(np.floor((x + r - origin_px[0]) / CELL_PX)))
        r0 = max(0, int(np.floor((y - r - origin_px[1]) / CELL_PX)))
        r1 = min(shape[0] - 1, int(np.floor((y + r - origin_px[1]) / CELL_PX)))
        if c1 < c0 or r1 < r0:
            continue
        best, second, best_octave, second_octave, at = 257, 257, -1, -1, -1
        for row in range(r0, r1 + 1):
            for k in range(start[row * shape[1] + c0], start[row * shape[1] + c1 + 1]):
                i = order[k]
                # All at once, for each is a toss of a coin that the processor would guess wrong.
                fits = usable[i] & (octave[i] >= min_octave[q]) & (octave[i] <= max_octave[q])
                if not (fits & (abs(px[i, 0] - x) <= r) & (abs(px[i, 1] - y) <= r)):
                    continue
                if query_right_px[q] >= 0 and right_px[i] >= 0 and abs(query_right_px[q] - right_px[i]) > r:
                    continue
                bits = hamming(query_words, query_row[q], target_words, i)
                if bits < best:
                    second, second_octave = best, best_octave
                    best, best_octave, at = bits, octave[i], i
                elif bits < second:
                    second, second_octave = bits, octave[i]
        if best > max_bits:
            continue
        if best_octave == second_octave and best > ratio * second:
            continue
        found[q] = at
        found_bits[q] = best
    return found, found_bits


def match_anywhere(first: U8, second: U8, max_bits: int = NEAR_BITS, ratio: float = 0.7) -> tuple[I32, I32]:
    """Match descriptors (N, 32) with (M, 32) without predicted positions, by nearest neighbour and ratio test.

    Returns:
        Indices into `first` and `second` (K,) of the matches, one to one.
    """
    target, bits = _match_anywhere(words(first), words(second), max_bits, ratio)
    return one_to_one(target, bits, len(second))


@njit(nogil=True, cache=True)
def _match_anywhere(first: U64, second: U64, max_bits: int, ratio: float) -> tuple[I32, I32]:
    found = np.full(len(first), -1, np.int32)
    found_bits = np.full(len(first), 257, np.int32)
    for i in range(len(first)):
        best, runner_up, at = 257, 257, -1
        for j in range(len(second)):
            bits = hamming(first, i, second, j)
            if bits < best:
                runner_up = best
                best, at = bits, j
            elif bits < runner_up:
                runner_up = bits
        if best <= max_bits and best < ratio * runner_up:
            found[i] = at
            found_bits[i] = best
    return found, found_bits


def search_epipolar(
    F_second_first: F64, first: Targets, second: Targets, scale_factors: F64, epipole_px: Floats
) -> tuple[I32, I32]:
    """Match usable keypoints of two keyframes along epipolar lines (ORB-SLAM2's search for triangulation).

    Args:
        F_second_first: Fundamental matrix (3, 3): `p_second @ F @ p_first = 0`.
        first, second: Keypoints; only the usable ones take part.
        scale_factors: Size of a pixel of each level in the image (L,) [px].
        epipole_px: Projection of the first camera's centre in the second image (2,); without depth nothing near it
            can be triangulated.

    Returns:
        Indices into `first` and `second` (K,), one to one.
    """
    mine, theirs = np.flatnonzero(first.usable), np.flatnonzero(second.usable)
    target, bits = _search_epipolar(
        F_second_first,
        _described(first, mine),
        _described(second, theirs),
        scale_factors,
        np.asarray(epipole_px, dtype=np.float64),
    )
    query, found = one_to_one(target, bits, len(theirs))
    return mine[query].astype(np.int32), theirs[found].astype(np.int32)


class _Described(NamedTuple):
    """Keypoints with positions (N, 2) float64 [px], and descriptors as words (N, 4)."""

    px: F64
    octave: I32
    right_px: F32
    words: U64


def _described(targets: Targets, chosen: Ints) -> _Described:
    t = targets
    px = t.px[chosen].astype(np.float64)
    return _Described(px, t.octave[chosen], t.right_px[chosen], words(t.descriptors[chosen]))


@njit(nogil=True, cache=True)
def _search_epipolar(
    F: F64, first: _Described, second: _Described, scale_factors: F64, epipole_px: F64
) -> tuple[I32, I32]:
    px1, _, right1, words1 = first
    px2, octave2, right2, words2 = second
    found = np.full(len(px1), -1, np.int32)
    found_bits = np.full(len(px1), 257, np.int32)
    for i in range(len(px1)):
        x, y = px1[i, 0], px1[i, 1]
        a = F[0, 0] * x + F[0, 1] * y + F[0, 2]
        b = F[1, 0] * x + F[1, 1] * y + F[1, 2]
        c = F[2, 0] * x + F[2, 1] * y + F[2, 2]
        norm = a * a + b * b
        if norm == 0.0:
            continue
        best = NEAR_BITS + 1
        for j in range(len(px2)):
            sigma = scale_factors[octave2[j]]
            distance = a * px2[j, 0] + b * px2[j, 1] + c
            if distance * distance > 3.84 * sigma * sigma * norm:
                continue
            if right1[i] < 0 and right2[j] < 0:
                ex, ey = epipole_px[0] - px2[j, 0], epipole_px[1] - px2[j, 1]
                if ex * ex + ey * ey < 100.0 * sigma * scale_factors[0]:
                    continue
            bits = hamming(words1, i, words2, j)
            if bits < best:
                best = bits
                found[i] = j
                found_bits[i] = bits
    return found, found_bits


def one_to_one(target: I32, bits: I32, n_targets: int) -> tuple[I32, I32]:
    """Keep for each target the nearest query, of equal ones the first; `target` (Q,) is −1 where one found nothing."""
    query, found = _one_to_one(target, bits, n_targets)
    return query, found


@njit(nogil=True, cache=True)
def _one_to_one(target: I32, bits: I32, n_targets: int) -> tuple[I32, I32]:
    owner = np.full(n_targets, -1, np.int32)
    for q in range(len(target)):
        t = target[q]
        if t >= 0 and (owner[t] < 0 or bits[q] < bits[owner[t]]):
            owner[t] = q
    query, found = np.empty(len(target), np.int32), np.empty(len(target), np.int32)
    n = 0
    for q in range(len(target)):
        if target[q] >= 0 and owner[target[q]] == q:
            query[n], found[n] = q, target[q]
            n += 1
    return query[:n], found[:n]


def consistent_rotation(first_rad: Floats, second_rad: Floats) -> Bool:
    """Keep matches (M,) whose change of orientation is among the three most common (ORB-SLAM2's histogram).

    The second and third bin count only with at least a tenth of the first one's matches.
    """
    if len(first_rad) == 0:
        return np.zeros(0, dtype=np.bool_)
    turn = np.mod(np.asarray(first_rad) - np.asarray(second_rad), 2.0 * np.pi)
    # Rounded, so that the middle of a bin, not a border, lies at no rotation, the most common case.
    bins: Ints = np.rint(turn * (_HISTOGRAM_BINS / (2.0 * np.pi))).astype(np.int64) % _HISTOGRAM_BINS
    return np.asarray(_in_common_bins(bins))


@njit(nogil=True, cache=True)
def _in_common_bins(bins: Ints) -> Bool:
    """Return which of the bins (M,) are among the three most common, of equal ones the first."""
    counts = np.zeros(_HISTOGRAM_BINS, np.int64)
    for b in bins:
        counts[b] += 1
    chosen = np.zeros(_HISTOGRAM_BINS, np.bool_)
    most = counts.max()
    for _ in range(3):
        best = np.argmax(counts)
        chosen[best] = counts[best] >= max(1.0, 0.1 * most)
        counts[best] = -1
    return chosen[bins]
