"""FAST corners, spread evenly over every level of the pyramid."""

from dataclasses import dataclass
from operator import attrgetter

import cv2
import numpy as np

from stillroom.geometry.arrays import F32, I32, I64, U8, Floats

_response = attrgetter("response")


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
    """Find FAST corners with non-maximum suppression on each level, at least `border_px` from its edges."""
    fast = cv2.FastFeatureDetector.create(threshold, nonmaxSuppression=True)
    px, score, level = [], [], []
    for number, image in enumerate(levels):
        inner = image[border_px - 3 : image.shape[0] - border_px + 3, border_px - 3 : image.shape[1] - border_px + 3]
        found = fast.detect(inner) if min(inner.shape) > 6 else ()
        px.append(np.asarray(cv2.KeyPoint.convert(found), dtype=np.float32).reshape(-1, 2) + (border_px - 3))
        score.append(np.fromiter(map(_response, found), np.float32, len(found)))
        level.append(np.full(len(found), number, dtype=np.int32))
    return Corners(np.concatenate(px).astype(np.float32), np.concatenate(score), np.concatenate(level))


def spread(corners: Corners, sizes: list[tuple[int, int]], quotas: list[int], strong: float, seed: int) -> I64:
    """Choose corners evenly: the best of every cell, then every cell's second best, until a level's quota is full.

    Each level is cut into about as many square cells as it may keep corners. Where a cell has a strong corner its weak
    ones are left out (ORB-SLAM2's two thresholds). Corners of equal score, of which there are many, are ordered by a
    hash of place and seed: runs with different seeds sample how much the result depends on such accidents.

    Args:
        corners: What was found.
        sizes: Width and height of each level [px].
        quotas: Corners to keep on each level.
        strong: Score from which a corner counts as strong.
        seed: Orders what is equal.

    Returns:
        Indices of the chosen corners (K,), level after level, best first.
    """
    if len(corners.level) == 0:
        return np.zeros(0, dtype=np.int64)
    cell = _cells(corners, sizes, quotas)
    merit = (255 - np.clip(corners.score, 0, 255).astype(np.int64)) << 16 | _hash16(corners.px, seed)
    order = np.argsort(cell << 24 | merit, kind="stable")
    cell_sorted = cell[order]
    first = np.flatnonzero(np.r_[True, cell_sorted[1:] != cell_sorted[:-1]])
    sizes_of_cells = np.diff(np.r_[first, len(order)])
    rank = np.arange(len(order)) - np.repeat(first, sizes_of_cells)
    best = np.repeat(corners.score[order[first]], sizes_of_cells)
    fit = (best < strong) | (corners.score[order] >= strong)
    order, rank = order[fit], rank[fit]
    level = corners.level[order].astype(np.int64)
    turn = level << 44 | np.minimum(rank, (1 << 19) - 1) << 24 | merit[order]
    by_turn = np.argsort(turn, kind="stable")
    starts = np.searchsorted(level[by_turn], np.arange(len(quotas)))
    place = np.arange(len(by_turn)) - starts[level[by_turn]]
    return order[by_turn[place < np.asarray(quotas)[level[by_turn]]]]


def _cells(corners: Corners, sizes: list[tuple[int, int]], quotas: list[int]) -> I64:
    """Return a number for each corner's cell (C,), different over all levels and increasing with the level."""
    width_px, height_px = (np.array(side, dtype=np.float64) for side in zip(*sizes, strict=True))
    side_px = np.sqrt(width_px * height_px / np.maximum(1, quotas))
    per_row = np.ceil(width_px / side_px).astype(np.int64) + 1
    per_level = per_row * (np.ceil(height_px / side_px).astype(np.int64) + 1)
    offset = np.concatenate(([0], np.cumsum(per_level)[:-1]))
    column = (corners.px[:, 0] / side_px[corners.level]).astype(np.int64)
    row = (corners.px[:, 1] / side_px[corners.level]).astype(np.int64)
    return np.asarray(offset[corners.level] + row * per_row[corners.level] + column, dtype=np.int64)


def _hash16(px: Floats, seed: int) -> I64:
    x, y = px[:, 0].astype(np.int64), px[:, 1].astype(np.int64)
    mixed = (x * 73856093) ^ (y * 19349663) ^ ((seed + 1) * 83492791)
    return np.asarray((mixed ^ (mixed >> 13)) & 0xFFFF, dtype=np.int64)
