"""Refine the border of a mask by depth: a depth camera sees outlines more exactly than a network."""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from stillroom.bounds import bounded
from stillroom.compiled import njit
from stillroom.geometry.arrays import F32, I8, I32, U8, Bool
from stillroom.geometry.pixels import Shape, element, grown
from stillroom.semantics.masks.mask_segments import MaskSegments

FEWEST = 12
"""Fewest pixels of known depth in a window for a mean depth."""
FAR_M = 0.6
"""Depths this far from the first mean are left out of the second."""


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
    known = depth_m > 0
    inner = ~grown(~mask, band_px, Shape.ELLIPSE)
    outer = ~grown(mask, band_px, Shape.ELLIPSE)
    (body_m, ground_m), (has_body, has_ground) = _mean_depths(depth_m, inner & known, outer & known, window_px)
    to_body, to_ground = np.abs(depth_m - body_m), np.abs(depth_m - ground_m)
    in_band = known & has_body & ~inner & ~outer
    # An arm may be off the body's mean as far as a table beside it is: only what is clearly at the background's depth
    # is removed.
    goes = in_band & mask & (to_body > config.jump_m) & has_ground & (2.0 * to_ground < to_body)
    comes = in_band & ~mask & (to_body < config.near_m) & (~has_ground | (to_ground > config.jump_m))
    return _changed(segments, around, goes, comes, band_px)


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


def _mean_depths(depth_m: F32, body: Bool, ground: Bool, window_px: int) -> tuple[F32, Bool]:
    """Return the mean depth [m] of the body's pixels and of the ground's in the window around each pixel.

    Each mean is taken twice: the second time without what is far from the first.

    Returns:
        The depths (2, h, w), and where there are enough pixels (2, h, w).
    """
    which = np.where(body, np.int8(0), np.where(ground, np.int8(1), np.int8(-1)))
    mean_m, n_pixels = np.empty((2, *depth_m.shape), np.float32), np.empty((2, *depth_m.shape), np.int32)
    window_means(depth_m, which, window_px, mean_m, n_pixels)
    own_m = np.where(ground, mean_m[1], mean_m[0])
    window_means(depth_m, np.where(np.abs(depth_m - own_m) < FAR_M, which, np.int8(-1)), window_px, mean_m, n_pixels)
    return mean_m, n_pixels >= FEWEST


@njit(nogil=True, cache=True)
def window_means(depth_m: F32, which: I8, window_px: int, mean_m: F32, n_pixels: I32) -> None:
    """Fill in the mean depth of two kinds of pixels in the square window around each pixel, by sums that run along.

    Args:
        depth_m: Depths (h, w) [m].
        which: 0 or 1 for a pixel of either kind, −1 for one of neither (h, w).
        window_px: Side of the window [px]; a window of an even side reaches further to the left and up, as OpenCV's.
        mean_m: The means (2, h, w) [m]; 0 where there is no pixel.
        n_pixels: How many pixels each is of (2, h, w).
    """
    height, width = depth_m.shape
    before, behind = window_px // 2, window_px - window_px // 2
    counts, sums_m = np.zeros((2, width), np.int32), np.zeros((2, width), np.float64)
    for y in range(-behind + 1, height):
        if y + behind - 1 < height:
            for x in range(width):
                kind = which[y + behind - 1, x]
                if kind >= 0:
                    counts[kind, x] += 1
                    sums_m[kind, x] += depth_m[y + behind - 1, x]
        if y - before - 1 >= 0:
            for x in range(width):
                kind = which[y - before - 1, x]
                if kind >= 0:
                    counts[kind, x] -= 1
                    sums_m[kind, x] -= depth_m[y - before - 1, x]
        if y < 0:
            continue
        for kind in range(2):
            count, total_m = 0, 0.0
            for x in range(min(behind - 1, width)):
                count += counts[kind, x]
                total_m += sums_m[kind, x]
            for x in range(width):
                if x + behind - 1 < width:
                    count += counts[kind, x + behind - 1]
                    total_m += sums_m[kind, x + behind - 1]
                if x - before - 1 >= 0:
                    count -= counts[kind, x - before - 1]
                    total_m -= sums_m[kind, x - before - 1]
                n_pixels[kind, y, x] = count
                mean_m[kind, y, x] = total_m / max(count, 1)


def _surroundings(label: U8, margin_px: int) -> tuple[slice, slice]:
    """Return the rows and columns of all labels, with a margin."""
    x, y, width, height = cv2.boundingRect(label)
    rows = slice(max(y - margin_px, 0), min(y + height + margin_px, label.shape[0]))
    return rows, slice(max(x - margin_px, 0), min(x + width + margin_px, label.shape[1]))
