"""FAST corners on every level of a pyramid, spread evenly (Rosten and Drummond, ECCV 2006)."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from stillroom.compiled import njit
from stillroom.geometry.arrays import F32, I32, I64, U8

_STRETCH = 32
"""Pixels of a row that are looked at together: one vector."""


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
        n_inside = width - 2 * border_px
        if n_inside < _STRETCH:
            image = np.pad(image, ((0, 0), (0, _STRETCH - n_inside)))
        n = _detect(np.ascontiguousarray(image), n_inside, max(1, threshold), border_px, found, margin)
        px.append(found[:n])
        score.append(margin[:n] - np.float32(1.0))
        level.append(np.full(n, number, np.int32))
    if not px:
        return Corners(np.zeros((0, 2), np.float32), np.zeros(0, np.float32), np.zeros(0, np.int32))
    return Corners(np.concatenate(px), np.concatenate(score), np.concatenate(level))


@njit(nogil=True, cache=True)
def _detect(image: U8, n_inside: int, threshold: int, border_px: int, px: F32, margin: U8) -> int:
    """Write position and margin of each corner, in order of rows; return how many there are.

    Args:
        image: The image (H, W), at least `_STRETCH` + 2 · border wide.
        n_inside: Columns to search, from `border_px` on.
        threshold: Margins above it are of corners.
        border_px: Rows and columns at the edges to leave out.
        px, margin: What is written.
    """
    height, width = image.shape
    flat, least = image.reshape(-1), np.uint8(threshold)
    n = 0
    # Margins of the last three rows, with a zero at either end, and which of the middle one are highest among their
    # eight neighbours.
    n_wide = max(n_inside, _STRETCH)
    rows = np.zeros((3, n_wide + 2), np.uint8)
    words = np.zeros(n_inside // 8 + 1, np.uint64)
    peaks = words.view(np.uint8)
    for y in range(border_px, height - border_px + 1):
        below = rows[y % 3]
        if y < height - border_px:
            for first in range(0, n_wide, _STRETCH):
                x = min(first, n_wide - _STRETCH)  # the last stretch overlaps the one before it, so that all are whole
                _write_margins(flat, y * width + border_px + x, width, least, below, 1 + x)
            below[n_inside + 1 :] = 0
        else:
            below[:] = 0
        above, row = rows[(y - 2) % 3], rows[(y - 1) % 3]
        _peaks(above[: n_inside + 2], row[: n_inside + 2], below[: n_inside + 2], threshold, peaks)
        for w in range(len(words)):
            if words[w] == 0:
                continue
            for x in range(8 * w, 8 * w + 8):
                if peaks[x] > 0:
                    px[n, 0], px[n, 1], margin[n] = border_px + x, y - 1, peaks[x]
                    n += 1
    return n


_RING = (
    (0, 3), (1, 3), (2, 2), (3, 1), (3, 0), (3, -1), (2, -2), (1, -3),
    (0, -3), (-1, -3), (-2, -2), (-3, -1), (-3, 0), (-3, 1), (-2, 2), (-1, 3),
)  # fmt: skip
"""Steps in x and y to the sixteen pixels that tell a corner, one after the other."""
_PIXELS, _LONG = ir.VectorType(ir.IntType(8), _STRETCH), ir.IntType(64)


def _lower(builder: Any, a: Any, b: Any) -> Any:
    """Return the lower of two pixels, lane by lane."""
    return builder.select(builder.icmp_unsigned("<", a, b), a, b)


def _higher(builder: Any, a: Any, b: Any) -> Any:
    """Return the higher of two pixels, lane by lane."""
    return builder.select(builder.icmp_unsigned(">", a, b), a, b)


def _over_arcs(builder: Any, ring: list[Any], low: Any, high: Any) -> Any:
    """Return the highest over all arcs of nine pixels of the lowest in an arc; or the reverse, by `low` and `high`."""
    odd = range(1, 16, 2)
    twos = {k: low(builder, ring[k], ring[(k + 1) % 16]) for k in odd}
    fours = {k: low(builder, twos[k], twos[(k + 2) % 16]) for k in odd}
    # Two fours that follow each other, and one pixel more at either end, are two arcs.
    arcs = [
        low(builder, low(builder, fours[k], fours[(k + 4) % 16]), high(builder, ring[k - 1], ring[(k + 8) % 16]))
        for k in odd
    ]
    while len(arcs) > 1:
        arcs = [high(builder, arcs[k], arcs[k + 1]) for k in range(0, len(arcs), 2)]
    return arcs[0]


@intrinsic
def _write_margins(typing_context: Any, flat: Any, at: Any, width: Any, threshold: Any, row: Any, to: Any) -> Any:
    """Write by how much `_STRETCH` pixels from `flat[at]` on differ from their rings to `row[to]` (kernels only).

    Over all arcs of nine pixels, the most that all nine differ by, which is a corner's score plus one. Where nothing in
    the stretch is above the threshold it is zero, whatever its margins are: nine of the ring in a row have one of each
    two opposite pixels, which bounds them. One vector of pixels here: of a loop in Python numba makes twice the code.
    """

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        image, margins = (context.make_array(signature.args[k])(context, builder, args[k]).data for k in (0, 4))

        def pixels(dx: int, dy: int) -> Any:
            place = builder.add(args[1], builder.add(builder.mul(args[2], _LONG(dy)), _LONG(dx)))
            return builder.load(builder.bitcast(builder.gep(image, [place]), _PIXELS.as_pointer()), align=1)

        def margin(bright: Any, dark: Any) -> Any:
            above = builder.sub(_higher(builder, bright, value), value)
            return _higher(builder, above, builder.sub(value, _lower(builder, dark, value)))

        value, below, right, above, left = pixels(0, 0), *(pixels(*_RING[k]) for k in (0, 4, 8, 12))
        bright = _lower(builder, _higher(builder, above, below), _higher(builder, left, right))
        dark = _higher(builder, _lower(builder, above, below), _lower(builder, left, right))
        first = builder.insert_element(ir.Constant(_PIXELS, ir.Undefined), args[3], ir.IntType(32)(0))
        least = builder.shuffle_vector(
            first, first, ir.Constant(ir.VectorType(ir.IntType(32), _STRETCH), [0] * _STRETCH)
        )
        may_be = builder.bitcast(builder.icmp_unsigned(">", margin(bright, dark), least), ir.IntType(_STRETCH))
        target = builder.bitcast(builder.gep(margins, [args[5]]), _PIXELS.as_pointer())
        with builder.if_else(builder.icmp_unsigned("!=", may_be, may_be.type(0))) as (some, none):
            with some:
                ring = [pixels(*step) for step in _RING]
                bright, dark = _over_arcs(builder, ring, _lower, _higher), _over_arcs(builder, ring, _higher, _lower)
                builder.store(margin(bright, dark), target, align=1)
            with none:
                builder.store(ir.Constant(_PIXELS, [0] * _STRETCH), target, align=1)
        return context.get_dummy_value()

    return types.void(flat, types.int64, types.int64, types.uint8, row, types.int64), codegen


# Indices are unsigned: numba then leaves out the question whether they count from the end, and LLVM makes vectors of 32
# pixels of the loop.
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
