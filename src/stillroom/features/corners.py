"""FAST corners on every level of a pyramid, spread evenly (Rosten and Drummond, ECCV 2006)."""

from dataclasses import dataclass

import numpy as np

from stillroom.compiled import njit
from stillroom.geometry.arrays import F32, I32, I64, U8

_RING_PX = 3
"""A corner is told from sixteen pixels on a ring of this radius."""
_STRETCH = 64
"""Pixels of a row that are looked at together; whole vectors, and short enough to be passed over where all is even."""


@dataclass(frozen=True)
class Corners:
    """C corners on the levels of a pyramid, level after level.

    Attributes:
        px: Position on the corner's own level (C, 2) float32 [px], whole numbers.
        score: FAST score (C,) float32: the largest threshold at which it still is a corner.
        level: Pyramid level (C,) int32.
    """

    px: F32
    score: F32
    level: I32


def detect(levels: list[U8], threshold: int, border_px: int) -> Corners:
    """Find FAST corners with non-maximum suppression on each level, at least `border_px` from its edges.

    They are those of OpenCV's `FastFeatureDetector`, which costs twice as much and hands out objects.

    Args:
        levels: Images (H, W).
        threshold: Lowest score of a corner.
        border_px: At least 3.
    """
    px, score, level = [], [], []
    for number, image in enumerate(levels):
        height, width = image.shape
        if min(height, width) <= 2 * border_px:
            continue
        # Of four neighbouring pixels at most one is a strict maximum.
        room = ((height - 2 * border_px + 1) // 2) * ((width - 2 * border_px + 1) // 2)
        found, margin = np.empty((room, 2), np.float32), np.empty(room, np.uint8)
        n = _detect(np.ascontiguousarray(image), max(1, threshold), border_px, found, margin)
        px.append(found[:n])
        score.append(margin[:n] - np.float32(1.0))
        level.append(np.full(n, number, np.int32))
    if not px:
        return Corners(np.zeros((0, 2), np.float32), np.zeros(0, np.float32), np.zeros(0, np.int32))
    return Corners(np.concatenate(px), np.concatenate(score), np.concatenate(level))


@njit(nogil=True, cache=True)
def _detect(image: U8, threshold: int, border_px: int, px: F32, margin: U8) -> int:
    """Write position and margin of each corner, in order of rows; return how many there are."""
    height, width = image.shape
    n = 0
    # Margins of the last three rows, and which of the middle one are highest among their eight neighbours.
    rows = np.zeros((3, width - 2 * border_px + 2), np.uint8)
    words = np.zeros(width // 8 + 1, np.uint64)
    peaks = words.view(np.uint8)
    for y in range(border_px, height - border_px + 1):
        below = rows[y % 3]
        if y < height - border_px:
            _margins(image, y, border_px, threshold, below[1:-1])
        else:
            below[:] = 0
        _peaks(rows[(y - 2) % 3], rows[(y - 1) % 3], below, threshold, peaks)
        for w in range(len(words)):
            if words[w] == 0:
                continue
            for x in range(8 * w, 8 * w + 8):
                if peaks[x] > 0:
                    px[n, 0], px[n, 1], margin[n] = border_px + x, y - 1, peaks[x]
                    n += 1
    return n


@njit(nogil=True, cache=True)
def _margins(image: U8, y: int, border_px: int, threshold: int, margins: U8) -> None:
    """Write by how much each pixel of a row differs from its ring, (W − 2 · border): a corner's score, plus one.

    A stretch in which nothing is above the threshold is zero, whatever its margins are.
    """
    x, w = border_px - 3, image.shape[1] - border_px + 3
    r0, r1, r2, r3 = image[y - 3, x:w], image[y - 2, x:w], image[y - 1, x:w], image[y, x:w]
    r4, r5, r6 = image[y + 1, x:w], image[y + 2, x:w], image[y + 3, x:w]
    n = len(margins)
    for first in range(0, n, _STRETCH):
        # The last stretch overlaps the one before it, so that all are whole.
        start = max(0, min(first, n - _STRETCH))
        end = min(start + _STRETCH, n)
        if _may_have_corner(r0, r3, r6, start, end) > threshold:
            _ring_margins((r0, r1, r2, r3, r4, r5, r6), start, end, margins)
        else:
            margins[start:end] = 0


# Indices below are unsigned: numba then leaves out the question whether they count from the end, and LLVM makes
# vectors of 32 pixels of the loops. Inlined because calls that pass this many arrays cost a quarter of the time.


@njit(nogil=True, cache=True, inline="always")
def _may_have_corner(above: U8, row: U8, below: U8, start: int, end: int) -> np.uint8:
    """Return a bound on the margins of a stretch: nine of the ring in a row have one of each two opposite pixels."""
    u3, u6 = np.uint64(3), np.uint64(6)
    most = np.uint8(0)
    for x in range(np.uint64(start), np.uint64(end)):
        value, left, right = row[x + u3], row[x], row[x + u6]
        bright = min(max(above[x + u3], below[x + u3]), max(left, right))
        dark = max(min(above[x + u3], below[x + u3]), min(left, right))
        most = max(most, np.uint8(max(bright, value) - value), np.uint8(value - min(dark, value)))
    return most


@njit(nogil=True, cache=True, inline="always")
def _ring_margins(rows: tuple[U8, ...], start: int, end: int, margins: U8) -> None:
    """Write the margins of a stretch of a row: over all arcs of nine pixels, the most that all nine differ by."""
    r0, r1, r2, r3, r4, r5, r6 = rows
    u1, u2, u3, u4, u5, u6 = np.uint64(1), np.uint64(2), np.uint64(3), np.uint64(4), np.uint64(5), np.uint64(6)
    for x in range(np.uint64(start), np.uint64(end)):
        a0, a1, a2, a3 = r6[x + u3], r6[x + u4], r5[x + u5], r4[x + u6]
        a4, a5, a6, a7 = r3[x + u6], r2[x + u6], r1[x + u5], r0[x + u4]
        a8, a9, a10, a11 = r0[x + u3], r0[x + u2], r1[x + u1], r2[x]
        a12, a13, a14, a15 = r3[x], r4[x], r5[x + u1], r6[x + u2]
        # Fours that start at each odd pixel; two of them and one pixel more at either end are arcs of nine.
        l1, l3, l5, l7 = min(a1, a2), min(a3, a4), min(a5, a6), min(a7, a8)
        l9, l11, l13, l15 = min(a9, a10), min(a11, a12), min(a13, a14), min(a15, a0)
        l1, l3, l5, l7, l9, l11, l13, l15 = (
            min(l1, l3), min(l3, l5), min(l5, l7), min(l7, l9), min(l9, l11), min(l11, l13), min(l13, l15), min(l15, l1)
        )  # fmt: skip
        bright = max(
            max(
                max(min(min(l1, l5), max(a0, a9)), min(min(l3, l7), max(a2, a11))),
                max(min(min(l5, l9), max(a4, a13)), min(min(l7, l11), max(a6, a15))),
            ),
            max(
                max(min(min(l9, l13), max(a8, a1)), min(min(l11, l15), max(a10, a3))),
                max(min(min(l13, l1), max(a12, a5)), min(min(l15, l3), max(a14, a7))),
            ),
        )
        h1, h3, h5, h7 = max(a1, a2), max(a3, a4), max(a5, a6), max(a7, a8)
        h9, h11, h13, h15 = max(a9, a10), max(a11, a12), max(a13, a14), max(a15, a0)
        h1, h3, h5, h7, h9, h11, h13, h15 = (
            max(h1, h3), max(h3, h5), max(h5, h7), max(h7, h9), max(h9, h11), max(h11, h13), max(h13, h15), max(h15, h1)
        )  # fmt: skip
        dark = min(
            min(
                min(max(max(h1, h5), min(a0, a9)), max(max(h3, h7), min(a2, a11))),
                min(max(max(h5, h9), min(a4, a13)), max(max(h7, h11), min(a6, a15))),
            ),
            min(
                min(max(max(h9, h13), min(a8, a1)), max(max(h11, h15), min(a10, a3))),
                min(max(max(h13, h1), min(a12, a5)), max(max(h15, h3), min(a14, a7))),
            ),
        )
        value = r3[x + u3]
        margins[x] = max(max(bright, value) - value, value - min(dark, value))


@njit(nogil=True, cache=True, inline="always")
def _peaks(above: U8, row: U8, below: U8, threshold: int, peaks: U8) -> None:
    """Write the margins of a row that are above the threshold and those of all eight neighbours, else zero.

    The rows have a zero more at either end.
    """
    u1, u2, least = np.uint64(1), np.uint64(2), np.uint8(threshold)
    for x in range(np.uint64(len(row) - 2)):
        beside = max(max(row[x], row[x + u2]), max(max(above[x], above[x + u1]), above[x + u2]))
        beside = max(max(beside, least), max(max(below[x], below[x + u1]), below[x + u2]))
        peaks[x] = row[x + u1] if row[x + u1] > beside else np.uint8(0)


def spread(corners: Corners, sizes: list[tuple[int, int]], quotas: list[int], strong: float, seed: int) -> I64:
    """Choose corners evenly: the best of every cell, then every cell's second best, until a level's quota is full.

    Each level is cut into about as many square cells as it may keep corners. Where a cell has a strong corner its weak
    ones are left out (ORB-SLAM2's two thresholds). Corners of equal score, of which there are many, are ordered by a
    hash of place and seed: runs with different seeds sample how much the result depends on such ties.

    Args:
        corners: What was found.
        sizes: Width and height of each level [px].
        quotas: Corners to keep on each level.
        strong: Score from which a corner counts as strong.
        seed: Orders corners of equal score.

    Returns:
        Indices of the chosen corners (K,), level after level, best first.
    """
    edges = np.searchsorted(corners.level, np.arange(len(quotas) + 1))
    chosen = np.empty(sum(quotas), np.int64)
    n = 0
    for (width, height), quota, first, last in zip(sizes, quotas, edges[:-1], edges[1:], strict=True):
        side_px = float(np.sqrt(width * height / max(1, quota)))
        cells = int(np.ceil(height / side_px)) + 1, int(np.ceil(width / side_px)) + 1
        px, score = corners.px[first:last], corners.score[first:last]
        taken = _spread(px, score, side_px, cells, strong, (seed + 1) * 83492791, chosen[n : n + quota])
        chosen[n : n + taken] += first
        n += taken
    return chosen[:n]


@njit(nogil=True, cache=True)
def _spread(px: F32, score: F32, side_px: float, cells: tuple[int, int], strong: float, salt: int, chosen: I64) -> int:
    """Write the indices of the chosen corners of one level, as many as there is room for; return how many they are."""
    n_cells = cells[0] * cells[1]
    cell, merit = np.empty(len(px), np.int64), np.empty(len(px), np.int64)
    best = np.zeros(n_cells, np.float32)
    for i in range(len(px)):
        x, y = int(px[i, 0]), int(px[i, 1])
        mixed = (x * 73856093) ^ (y * 19349663) ^ salt
        merit[i] = (255 - int(min(max(score[i], 0.0), 255.0))) << 16 | ((mixed ^ (mixed >> 13)) & 0xFFFF)
        cell[i] = int(px[i, 1] / side_px) * cells[1] + int(px[i, 0] / side_px)
        best[cell[i]] = max(best[cell[i]], score[i])
    start = np.zeros(n_cells + 1, np.int64)
    for i in range(len(px)):
        start[cell[i] + 1] += best[cell[i]] < strong or score[i] >= strong
    # Not by np.cumsum: for it numba imports scipy.linalg.
    for c in range(n_cells):
        start[c + 1] += start[c]
    end = start[:-1].copy()
    queues = np.empty(start[-1], np.int64)  # of each cell, the best first
    for i in range(len(px)):
        if best[cell[i]] < strong or score[i] >= strong:
            at = end[cell[i]]
            end[cell[i]] += 1
            while at > start[cell[i]] and merit[queues[at - 1]] > merit[i]:
                queues[at] = queues[at - 1]
                at -= 1
            queues[at] = i
    n, turn = 0, np.empty(n_cells, np.int64)
    while True:
        n_left = 0
        for c in range(n_cells):
            if start[c] < end[c]:
                turn[n_left] = merit[queues[start[c]]] << 32 | start[c]
                start[c] += 1
                n_left += 1
        if n_left == 0 or n == len(chosen):
            return n
        for key in np.sort(turn[:n_left])[: len(chosen) - n]:
            chosen[n] = queues[key & 0xFFFFFFFF]
            n += 1
