"""Descriptor matching: in a window, along epipolar lines, or over the whole image (ORB-SLAM2's searches)."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from stillroom.compiled import njit
from stillroom.geometry.arrays import F32, F64, I32, I64, U8, U64, Bool, Floats, Ints
from stillroom.geometry.hamming import hamming, words

# Keypoints sorted by level and into square cells, so that a window is searched on some levels and not the whole image.


CELL_PX = 16.0
"""Side of a cell on the finest three levels; each three more have cells larger by as much, as their windows are."""


class Grid(NamedTuple):
    """Cells row by row over the extent of the keypoints, level after level.

    Attributes:
        origin_px: Corner of the first cell (2,) float32 [px].
        shape: Rows and columns of cells on each level (L, 2) int64.
        first: Number of the first cell of each level (L,) int64.
        start: Where each cell's keypoints start in `order` (cells + 1,) int64.
        order: Indices of the keypoints, cell after cell (M,) int64; those that are not usable are left out.
    """

    origin_px: F32
    shape: I64
    first: I64
    start: I64
    order: I64


@njit(nogil=True, cache=True)
def side_px(level: int) -> float:
    """Return the side of a level's cells [px]."""
    return CELL_PX * (1 + level // 3)


@njit(nogil=True, cache=True)
def build_grid(px: F32, octave: I32, usable: Bool) -> Grid:
    """Sort keypoints (N, 2) [px], found on levels (N,), into cells."""
    origin_px, far_px = np.zeros(2, np.float32), np.zeros(2, np.float32)
    n_levels = 1
    for i in range(len(px)):
        for k in range(2):
            origin_px[k] = px[i, k] if i == 0 else min(origin_px[k], px[i, k])
            far_px[k] = px[i, k] if i == 0 else max(far_px[k], px[i, k])
        n_levels = max(n_levels, octave[i] + 1)
    shape, first = np.empty((n_levels, 2), np.int64), np.empty(n_levels, np.int64)
    n_cells = 0
    for level in range(n_levels):
        first[level] = n_cells
        for k in range(2):
            shape[level, 1 - k] = int((far_px[k] - origin_px[k]) / side_px(level)) + 1
        n_cells += shape[level, 0] * shape[level, 1]
    cell = np.empty(len(px), np.int64)
    start = np.zeros(n_cells + 1, np.int64)
    for i in range(len(px)):
        if usable[i]:
            level, side = octave[i], side_px(octave[i])
            row, column = int((px[i, 1] - origin_px[1]) / side), int((px[i, 0] - origin_px[0]) / side)
            cell[i] = first[level] + row * shape[level, 1] + column
            start[cell[i] + 1] += 1
    for c in range(n_cells):
        start[c + 1] += start[c]
    fill = start[:-1].copy()
    order = np.empty(start[-1], np.int64)
    for i in range(len(px)):
        if usable[i]:
            order[fill[cell[i]]] = i
            fill[cell[i]] += 1
    return Grid(origin_px, shape, first, start, order)


FAR_BITS = 100
"""Descriptors further apart than this never match when there is a window to search in (ORB-SLAM2's TH_HIGH)."""
NEAR_BITS = 50
"""The same where there is none (TH_LOW)."""
_HISTOGRAM_BINS = 30
_NOTHING = 257 << 48


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

    @property
    def arrays(self) -> "TargetArrays":
        """The same as kernels take them."""
        return TargetArrays(self.px, self.octave, self.right_px, words(self.descriptors), self.usable)


class TargetArrays(NamedTuple):
    """`Targets` as the kernels take them; descriptors as words (N, 4)."""

    px: F32
    octave: I32
    right_px: F32
    words: U64
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
    q = queries
    row = np.arange(len(q.px), dtype=np.int32) if q.row is None else q.row
    wanted = Wanted(q.px, q.radius_px, q.min_octave, q.max_octave, q.right_px, words(q.descriptors), row)
    query, target = find_in_windows(wanted, targets.arrays, max_bits, ratio)
    return query, target


class Wanted(NamedTuple):
    """`Queries` as the kernel takes them; descriptors as words (R, 4)."""

    px: F32
    radius_px: F32
    min_octave: I32
    max_octave: I32
    right_px: F32
    words: U64
    row: I32


@njit(nogil=True, cache=True)
def find_in_windows(wanted: Wanted, there: TargetArrays, max_bits: int, ratio: float) -> tuple[I32, I32]:
    """Do what `search_windows` tells."""
    grid = build_grid(there.px, there.octave, there.usable)
    target, bits = _search_windows(wanted, there, grid, max_bits, ratio)
    query, nearest = keep_nearest(target, bits, len(there.px))
    return query, nearest


@njit(nogil=True, cache=True)
def _search_windows(wanted: Wanted, there: TargetArrays, grid: Grid, max_bits: int, ratio: float) -> tuple[I32, I32]:
    query_px, radius_px, min_octave, max_octave, query_right_px, query_words, query_row = wanted
    px, octave, right_px, target_words, _ = there
    origin_px, shape, first, start, order = grid
    n = len(query_px)
    found = np.full(n, -1, np.int32)
    found_bits = np.full(n, 257, np.int32)
    # What is asked of every keypoint of a cell lies together. Of equally near ones the first counts, row by row of the
    # finest cells.
    sorted_px, rank = np.empty((len(order), 2), np.float32), np.empty(len(order), np.int64)
    for k in range(len(order)):
        i = order[k]
        sorted_px[k, 0], sorted_px[k, 1] = px[i, 0], px[i, 1]
        row, column = int((px[i, 1] - origin_px[1]) / CELL_PX), int((px[i, 0] - origin_px[0]) / CELL_PX)
        rank[k] = (row * shape[0, 1] + column) * len(px) + i
    for q in range(n):
        x, y, r = query_px[q, 0], query_px[q, 1], radius_px[q]
        best, second, at, after = _NOTHING, _NOTHING, -1, -1
        for level in range(max(0, min_octave[q]), min(len(first) - 1, max_octave[q]) + 1):
            n_rows, n_columns, side = shape[level, 0], shape[level, 1], side_px(level)
            c0 = max(0, int(np.floor((x - r - origin_px[0]) / side)))
            c1 = min(n_columns - 1, int(np.floor((x + r - origin_px[0]) / side)))
            r0 = max(0, int(np.floor((y - r - origin_px[1]) / side)))
            r1 = min(n_rows - 1, int(np.floor((y + r - origin_px[1]) / side)))
            if c1 < c0:
                continue
            for row in range(r0, r1 + 1):
                line = first[level] + row * n_columns
                for k in range(start[line + c0], start[line + c1 + 1]):
                    # Both at once, for each is a toss of a coin that the processor would guess wrong.
                    if not ((abs(sorted_px[k, 0] - x) <= r) & (abs(sorted_px[k, 1] - y) <= r)):
                        continue
                    i = order[k]
                    if query_right_px[q] >= 0 and right_px[i] >= 0 and abs(query_right_px[q] - right_px[i]) > r:
                        continue
                    near = hamming(query_words, query_row[q], target_words, i) << 48 | rank[k]
                    if near < best:
                        second, after = best, at
                        best, at = near, i
                    elif near < second:
                        second, after = near, i
        if at < 0 or best >> 48 > max_bits:
            continue
        if after >= 0 and octave[at] == octave[after] and best >> 48 > ratio * (second >> 48):
            continue
        found[q] = at
        found_bits[q] = best >> 48
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


class Described(NamedTuple):
    """Keypoints with positions (N, 2) float64 [px], and descriptors as words (N, 4)."""

    px: F64
    octave: I32
    right_px: F32
    words: U64


@njit(nogil=True, cache=True)
def find_on_lines(F: F64, first: Described, second: Described, scale_factors: F64, epipole_px: F64) -> tuple[I32, I32]:
    """Match keypoints of two keyframes along epipolar lines (ORB-SLAM2's search for triangulation).

    Args:
        F: Fundamental matrix (3, 3): `p_second @ F @ p_first = 0`.
        first, second: N and M keypoints.
        scale_factors: Size of a pixel of each level in the image (L,) [px].
        epipole_px: Projection of the first camera's centre in the second image (2,); without depth nothing near it
            can be triangulated.

    Returns:
        The second keypoint that each first one looks like most (N,), −1 for none, and how many bits differ (N,).
    """
    px1, _, right1, words1 = first
    px2, octave2, right2, words2 = second
    found = np.full(len(px1), -1, np.int32)
    found_bits = np.full(len(px1), 257, np.int32)
    n = len(px2)
    x2, y2, reach2 = np.empty(n), np.empty(n), np.empty(n)
    by_epipole = np.empty(n, np.bool_)
    for j in range(n):
        sigma = scale_factors[octave2[j]]
        x2[j], y2[j], reach2[j] = px2[j, 0], px2[j, 1], 3.84 * sigma * sigma
        ex, ey = epipole_px[0] - x2[j], epipole_px[1] - y2[j]
        by_epipole[j] = right2[j] < 0 and ex * ex + ey * ey < 100.0 * sigma * scale_factors[0]
    # Few lie near a line: all are asked by whole vectors, and the answers looked through eight at a time.
    eights = np.zeros(n // 8 + 1, np.uint64)
    is_near = eights.view(np.uint8)
    for i in range(len(px1)):
        x, y = px1[i, 0], px1[i, 1]
        a = F[0, 0] * x + F[0, 1] * y + F[0, 2]
        b = F[1, 0] * x + F[1, 1] * y + F[1, 2]
        c = F[2, 0] * x + F[2, 1] * y + F[2, 2]
        norm = a * a + b * b
        if norm == 0.0:
            continue
        for j in range(np.uint64(n)):
            distance = a * x2[j] + b * y2[j] + c
            is_near[j] = distance * distance <= reach2[j] * norm
        best = NEAR_BITS + 1
        for eight in range(len(eights)):
            if eights[eight] == 0:
                continue
            for j in range(8 * eight, 8 * eight + 8):
                if is_near[j] == 0 or (right1[i] < 0 and by_epipole[j]):
                    continue
                bits = hamming(words1, i, words2, j)
                if bits < best:
                    best = bits
                    found[i] = j
                    found_bits[i] = bits
    return found, found_bits


def one_to_one(target: I32, bits: I32, n_targets: int) -> tuple[I32, I32]:
    """Keep for each target the nearest query, of equal ones the first; `target` (Q,) is −1 where one found nothing."""
    query, found = keep_nearest(target, bits, n_targets)
    return query, found


@njit(nogil=True, cache=True)
def keep_nearest(target: I32, bits: I32, n_targets: int) -> tuple[I32, I32]:
    """Do what `one_to_one` tells."""
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
    return np.asarray(steady_turns(np.asarray(first_rad), np.asarray(second_rad)))


@njit(nogil=True, cache=True)
def steady_turns(first_rad: Floats, second_rad: Floats) -> Bool:
    """Do what `consistent_rotation` tells; both (M,) of one type of numbers."""
    bins = np.empty(len(first_rad), np.int64)
    number = first_rad.dtype.type
    whole, per_rad = number(2.0 * np.pi), number(_HISTOGRAM_BINS / (2.0 * np.pi))
    for i in range(len(first_rad)):
        # Rounded, so that the middle of a bin, not a border, lies at no rotation, the most common case.
        bins[i] = int(np.rint(((first_rad[i] - second_rad[i]) % whole) * per_rad)) % _HISTOGRAM_BINS
    steady: Bool = _in_common_bins(bins)
    return steady


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
