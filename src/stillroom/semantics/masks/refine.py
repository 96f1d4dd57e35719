"""Refine the border of a mask by depth: a depth camera sees outlines more exactly than a network."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np

from stillroom.bounds import bounded
from stillroom.compiled import njit
from stillroom.geometry.arrays import F32, F64, I8, I32, U8, Bool
from stillroom.geometry.pixels import Shape, element, grown
from stillroom.semantics.masks.mask_segments import MaskSegments

FEWEST = 12
"""Fewest pixels of known depth in a window for a mean depth."""
FAR_M = np.float32(0.6)
"""Depths this far from the first mean are left out of the second."""

BODY, GROUND, NEITHER = 0, 1, -1
"""Kinds of pixels: well inside of a mask, well outside, or in the band between, or of unknown depth."""
GOES, COMES = 1, 2


@dataclass(frozen=True)
class RefineConfig:
    """How the border of a mask is refined.

    Attributes:
        enabled: Whether it is.
        band_px: Width of the band around the border in which pixels may change [px].
        window_px: Side of the square around a pixel in which the depths of body and background are averaged [px].
        jump_m: A pixel that is this much nearer or farther than the body around it does not belong to it [m].
        near_m: A pixel beside the mask belongs to the body when it is this near to its depth [m].
    """

    enabled: bool = True
    band_px: int = bounded(14, least=0, pixels=1)
    window_px: int = bounded(90, least=0, pixels=1)
    jump_m: float = bounded(0.30, least=0)
    near_m: float = bounded(0.30, least=0)

    def contradiction(self) -> tuple[str, str] | None:
        """Return that the window is not larger than the band."""
        return None if self.window_px > self.band_px else ("window_px", "band_px")


def refined(segments: MaskSegments, depth_m: F32, config: RefineConfig) -> MaskSegments:
    """Move the border of a mask to the depth discontinuity.

    Each pixel near the border is compared with the mean depth of the body around it (what lies well inside of the
    mask) and of the background around it (what lies well outside). Where the two differ, the pixel gets the nearer one:
    those of the mask off the body's depth are removed, those next to it at the body's depth are added. Where they do
    not, as where feet stand on the floor, and where depth is unknown, the network decides.

    Args:
        segments: What is potentially dynamic, at half size.
        depth_m: Depth (h, w) [m] on the same pixels.
        config: Sizes in pixels of the whole image.
    """
    if not config.enabled or not segments.has_any:
        return segments
    band_px, window_px = max(config.band_px // 2, 1), max(config.window_px // 2, 3)
    around = _surroundings(segments.label, band_px + window_px)
    label, depth_m = segments.label[around], np.ascontiguousarray(depth_m[around])
    mask = label > 0
    inner = ~grown(~mask, band_px, Shape.ELLIPSE)
    outer = ~grown(mask, band_px, Shape.ELLIPSE)
    verdict = border_verdicts(
        depth_m, mask, inner, outer, window_px, np.float32(config.jump_m), np.float32(config.near_m)
    )
    return _changed(segments, around, verdict == GOES, verdict == COMES, band_px)


def _changed(
    segments: MaskSegments, around: tuple[slice, slice], goes: Bool, comes: Bool, band_px: int
) -> MaskSegments:
    """Return segments without some pixels, and with others, which take the label of what is next to them."""
    label, probability = segments.label.copy(), segments.probability.copy()
    part, likely = label[around], probability[around]
    beside = cv2.dilate(part, element(band_px, Shape.ELLIPSE))
    part[goes] = 0
    part[comes] = beside[comes]
    likely[comes] = np.maximum(likely[comes], 0.5)
    likely[goes] = np.minimum(likely[goes], 0.49)
    return replace(segments, label=label, probability=probability)


@njit(nogil=True, cache=True)
def border_verdicts(
    depth_m: F32, mask: Bool, inner: Bool, outer: Bool, window_px: int, jump_m: float, near_m: float
) -> U8:
    """Return which pixels (h, w) do not belong to the mask, `GOES`, which belong to it, `COMES`, and 0 for the others.

    Each mean depth is taken twice: the second time without what is far from the first.

    Args:
        depth_m: Depths (h, w) [m]; 0 where unknown.
        mask: The mask (h, w).
        inner, outer: What lies well inside and well outside of it (h, w); between them is the band that may change.
        window_px: Side of the window [px].
        jump_m, near_m: See `RefineConfig`.
    """
    height, width = depth_m.shape
    which, verdict = np.empty((height, width), np.int8), np.zeros((height, width), np.uint8)
    for y in range(height):
        for x in range(width):
            known = depth_m[y, x] > 0
            which[y, x] = BODY if inner[y, x] & known else (GROUND if outer[y, x] & known else NEITHER)
    sums = empty_sums(width, window_px)
    near = np.empty_like(which)
    for y in range(height):
        slide_to(y, depth_m, which, window_px, sums)
        means_along(window_px, sums)
        for x in range(width):
            kind = which[y, x]
            own_m = sums.mean_m[max(kind, BODY), x]
            near[y, x] = kind if abs(depth_m[y, x] - own_m) < FAR_M else NEITHER
    sums = empty_sums(width, window_px)
    for y in range(height):
        slide_to(y, depth_m, near, window_px, sums)
        in_band = depth_m[y] > 0
        in_band &= ~(inner[y] | outer[y])
        if not in_band.any():
            continue
        means_along(window_px, sums)
        for x in range(width):
            if not in_band[x] or sums.n_pixels[BODY, x] < FEWEST:
                continue
            to_body = abs(depth_m[y, x] - sums.mean_m[BODY, x])
            to_ground = abs(depth_m[y, x] - sums.mean_m[GROUND, x])
            has_ground = sums.n_pixels[GROUND, x] >= FEWEST
            if mask[y, x]:
                # An arm may be off the body's mean as far as a table beside it is: only what is clearly at the
                # background's depth is removed.
                if to_body > jump_m and has_ground and np.float32(2.0) * to_ground < to_body:
                    verdict[y, x] = GOES
            elif to_body < near_m and (not has_ground or to_ground > jump_m):
                verdict[y, x] = COMES
    return verdict


class RunningSums(NamedTuple):
    """Sums of two kinds of pixels in a window that moves down an image of width w, and what they are in a row of it.

    Attributes:
        counts: Pixels of each column of the window (2, w and a window on either side).
        sums_m: Sum of their depths [m], of the same shape.
        n_pixels: Pixels in the window around each pixel of the row (2, w).
        mean_m: Mean of their depths (2, w) float32 [m]; 0 where there is none.
    """

    counts: I32
    sums_m: F64
    n_pixels: I32
    mean_m: F32


@njit(nogil=True, cache=True)
def empty_sums(width: int, window_px: int) -> RunningSums:
    """Return the sums of a window above the image."""
    room = width + 2 * window_px
    return RunningSums(
        np.zeros((2, room), np.int32),
        np.zeros((2, room), np.float64),
        np.empty((2, width), np.int32),
        np.empty((2, width), np.float32),
    )


@njit(nogil=True, cache=True)
def slide_to(y: int, depth_m: F32, which: I8, window_px: int, sums: RunningSums) -> None:
    """Move the window down to a row; rows come one after the other from the first.

    Args:
        y: The row.
        depth_m: Depths (h, w) [m].
        which: `BODY`, `GROUND` or `NEITHER` (h, w).
        window_px: Side of the window [px]; a window of an even side reaches further to the left and up, as OpenCV's.
        sums: Changed.
    """
    height = len(depth_m)
    before, behind = window_px // 2, window_px - window_px // 2
    for row in range(0 if y == 0 else y + behind - 1, min(y + behind, height)):
        add_row(depth_m[row], which[row], 1, window_px, sums)
    if y - before - 1 >= 0:
        add_row(depth_m[y - before - 1], which[y - before - 1], -1, window_px, sums)


@njit(nogil=True, cache=True)
def add_row(depth_m: F32, which: I8, sign: int, window_px: int, sums: RunningSums) -> None:
    """Add a row (w,) to the sums of the columns, or subtract it."""
    width = len(depth_m)
    for kind in range(2):
        counts = sums.counts[kind, window_px : window_px + width]
        sums_m = sums.sums_m[kind, window_px : window_px + width]
        for x in range(width):
            counts[x] += sign if which[x] == kind else 0
            sums_m[x] += sign * (np.float64(depth_m[x]) if which[x] == kind else 0.0)


@njit(nogil=True, cache=True, error_model="numpy")
def means_along(window_px: int, sums: RunningSums) -> None:
    """Take counts and means of a row from the sums of the columns, which run along."""
    counts, sums_m, n_pixels, mean_m = sums
    width = n_pixels.shape[1]
    before, behind = window_px // 2, window_px - window_px // 2
    n_body, n_ground, body_m, ground_m = 0, 0, 0.0, 0.0
    for at in range(window_px, window_px + min(behind - 1, width)):
        n_body, n_ground = n_body + counts[BODY, at], n_ground + counts[GROUND, at]
        body_m, ground_m = body_m + sums_m[BODY, at], ground_m + sums_m[GROUND, at]
    for x in range(width):
        comes, goes = window_px + x + behind - 1, window_px + x - before - 1
        n_body, n_ground = n_body + counts[BODY, comes], n_ground + counts[GROUND, comes]
        body_m, ground_m = body_m + sums_m[BODY, comes], ground_m + sums_m[GROUND, comes]
        n_body, n_ground = n_body - counts[BODY, goes], n_ground - counts[GROUND, goes]
        body_m, ground_m = body_m - sums_m[BODY, goes], ground_m - sums_m[GROUND, goes]
        n_pixels[BODY, x], n_pixels[GROUND, x] = n_body, n_ground
        mean_m[BODY, x], mean_m[GROUND, x] = body_m / max(n_body, 1), ground_m / max(n_ground, 1)


def _surroundings(label: U8, margin_px: int) -> tuple[slice, slice]:
    """Return the rows and columns of all labels, with a margin."""
    x, y, width, height = cv2.boundingRect(label)
    rows = slice(max(y - margin_px, 0), min(y + height + margin_px, label.shape[0]))
    return rows, slice(max(x - margin_px, 0), min(x + width + margin_px, label.shape[1]))
