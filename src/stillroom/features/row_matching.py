"""Matches of keypoints along the rows of a rectified pair (ORB-SLAM2: ComputeStereoMatches)."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from stillroom.compiled import njit
from stillroom.geometry.arrays import F32, F64, I32, I64, U8, U64, Bool
from stillroom.geometry.hamming import hamming

BAND_LEVEL_PX = 2.0
"""A right keypoint is searched from this many pixels of its level above it to as many below."""
PATCH_REACH_PX = 5
"""Patches of 11×11 pixels are compared, of the left keypoint's level."""
SLIDE_PX = 5
"""How far the right patch is slid to either side of the matched keypoint, in pixels of the level."""


class RowKeypoints(NamedTuple):
    """Keypoints of one image of a rectified pair, as the search along rows takes them.

    Attributes:
        px: Positions (N, 2) float32 [px].
        octave: Pyramid levels (N,) int32.
        words: Descriptors (N, 4) uint64.
    """

    px: F32
    octave: I32
    words: U64


def search_rows(
    left: RowKeypoints, right: RowKeypoints, scale_factors: F64, height: int, max_disparity_px: float, max_bits: int
) -> I32:
    """Find for each left keypoint the right one with the nearest descriptor in the same row of a rectified pair.

    Args:
        left, right: The keypoints; on rows of images of this height.
        scale_factors: Size of a pixel of each level in the image (L,) [px].
        height: Rows of the images.
        max_disparity_px: How far to the left a right keypoint may lie.
        max_bits: Descriptors this far apart, or further, do not match.

    Returns:
        Index of the right keypoint (N,), −1 where there is none. Several left ones may have the same, as in ORB-SLAM2.
    """
    start, order = _by_rows(right.px, right.octave, BAND_LEVEL_PX * scale_factors, height)
    found: I32 = _search_rows(left, right, start, order, max_disparity_px, max_bits)
    return found


@njit(nogil=True, cache=True)
def _by_rows(px: F32, octave: I32, band_px: F64, height: int) -> tuple[I32, I32]:
    """Return where each row's keypoints start (height + 1,), and the keypoints row after row."""
    start = np.zeros(height + 1, np.int32)
    first, last = np.empty(len(px), np.int32), np.empty(len(px), np.int32)
    for i in range(len(px)):
        band = band_px[octave[i]]
        first[i] = max(0, int(np.floor(px[i, 1] - band)))
        last[i] = min(height - 1, int(np.ceil(px[i, 1] + band)))
        for row in range(first[i], last[i] + 1):
            start[row + 1] += 1
    for row in range(height):
        start[row + 1] += start[row]
    fill = start[:-1].copy()
    order = np.empty(start[-1], np.int32)
    for i in range(len(px)):
        for row in range(first[i], last[i] + 1):
            order[fill[row]] = i
            fill[row] += 1
    return start, order


@njit(nogil=True, cache=True)
def _search_rows(
    left: RowKeypoints, right: RowKeypoints, start: I32, order: I32, max_disparity_px: float, max_bits: int
) -> I32:
    found = np.full(len(left.px), -1, np.int32)
    for i in range(len(left.px)):
        x, level, best = left.px[i, 0], left.octave[i], max_bits
        row = min(max(int(np.floor(left.px[i, 1])), 0), len(start) - 2)
        for k in range(start[row], start[row + 1]):
            j = order[k]
            disparity_px = x - right.px[j, 0]
            # All at once, for each is a toss of a coin that the processor would guess wrong.
            fits = (disparity_px >= 0.0) & (disparity_px <= max_disparity_px) & (abs(right.octave[j] - level) <= 1)
            if fits:
                bits = hamming(left.words, i, right.words, j)
                if bits < best:
                    best, found[i] = bits, j
    return found


class Slid(NamedTuple):
    """Where patches of one level of the left image are found in the right one.

    Attributes:
        x_px: Column in the right image (K,) float64, in pixels of the level; NaN where it is not certain.
        distance: L1 distance of the patches there (K,) float64; infinite where the column is not known.
    """

    x_px: F64
    distance: F64


@njit(nogil=True, cache=True)
def slide(left: U8, right: U8, left_at: I32, right_x: I32) -> Slid:
    """Find the patches around pixels of a level of the left image in the same rows of the right image's level.

    A patch is compared less its mean, by L1 norm, at each of `SLIDE_PX` columns to either side; two lines of opposite
    slope through the best distance and its neighbours meet at the column.

    Differs from ORB-SLAM2, which takes off the middle pixel and fits a parabola: the noise of that one pixel counts in
    all 121 differences, and the distances make a V. In rendered rooms the error of the column is 0.20 pixels of the
    level so, in the median, and 0.05 in the way that is taken here.

    Args:
        left, right: The level (H, W) of both images.
        left_at: Column and row (K, 2) of the patches' middles; the patch must be inside of the image.
        right_x: About which column (K,) to search. Where that would leave the image nothing is found.
    """
    n, reach, steps = len(left_at), PATCH_REACH_PX, 2 * SLIDE_PX + 1
    side = 2 * reach + 1
    x_px, distance = np.full(n, np.nan), np.full(n, np.inf)
    sums = np.empty(steps, np.int64)
    patch = np.empty((side, side), np.int32)
    for i in range(n):
        first_x = right_x[i] - SLIDE_PX - reach
        if first_x < 0 or first_x + steps - 1 + side > right.shape[1]:
            continue
        best, top, left_x = 0, left_at[i, 1] - reach, left_at[i, 0] - reach
        patch[:] = left[top : top + side, left_x : left_x + side]
        for step in range(steps):
            sums[step] = _distance(patch, right[top : top + side, first_x + step : first_x + step + side])
            if sums[step] < sums[best]:
                best = step
        if best == 0 or best == steps - 1:
            continue
        before, after = sums[best - 1] - sums[best], sums[best + 1] - sums[best]
        steeper = max(before, after)
        # The best is not worse than its neighbours, so the lines meet at most half a pixel away.
        aside = 0.5 * (before - after) / steeper if steeper > 0 else 0.0
        x_px[i], distance[i] = right_x[i] - SLIDE_PX + best + aside, sums[best] / side**2
    return Slid(x_px, distance)


@njit(nogil=True, cache=True)
def _distance(patch: I32, other: U8) -> int:
    """Return the L1 distance of two patches (S, S), each less its mean, times the number of their pixels."""
    size, offset = np.int32(patch.size), np.int32(0)
    for y in range(patch.shape[0]):
        for x in range(patch.shape[1]):
            offset += np.int32(other[y, x]) - patch[y, x]
    total = np.int32(0)
    for y in range(patch.shape[0]):
        for x in range(patch.shape[1]):
            total += abs(size * (np.int32(other[y, x]) - patch[y, x]) - offset)
    return int(total)


def refine(
    left: Sequence[U8], right: Sequence[U8], px: F32, octave: I32, right_x_px: F32, size_px: tuple[int, int]
) -> Slid:
    """Refine matches by patches on the levels of the left keypoints.

    Args:
        left, right: The levels (H, W) of both images, finest first.
        px: Left keypoints (K, 2) [px].
        octave: Their levels (K,).
        right_x_px: Columns of the right keypoints (K,) [px].
        size_px: Width and height of the images.

    Returns:
        Columns in the right image (K,) [px], in pixels of the image, and distances.
    """
    x_px, distance = np.full(len(px), np.nan), np.full(len(px), np.inf)
    for level, (mine, theirs) in enumerate(zip(left, right, strict=True)):
        own: I64 = np.flatnonzero(octave == level)
        if len(own) == 0:
            continue
        ratio = np.array(size_px) / mine.shape[::-1]
        # Pixel centres, not corners, are what a resize keeps.
        left_at = np.rint((px[own] + 0.5) / ratio - 0.5).astype(np.int32)
        right_x = np.rint((right_x_px[own] + 0.5) / ratio[0] - 0.5).astype(np.int32)
        slid = slide(mine, theirs, left_at, right_x)
        x_px[own], distance[own] = (slid.x_px + 0.5) * ratio[0] - 0.5, slid.distance
    return Slid(x_px, distance)


def agreeing(distance: F64, times_median: float) -> Bool:
    """Return which patch distances (K,) are at most so many times their median; those that are not finite never are."""
    finite: Bool = np.isfinite(distance)
    if not finite.any():
        return finite
    return finite & (distance <= times_median * np.median(distance[finite]))
