"""Refine the border of a mask by depth: a depth camera sees outlines more exactly than a network."""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from stillroom.bounds import bounded
from stillroom.geometry.arrays import F32, U8, Bool
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
    label, depth_m = segments.label[around], depth_m[around]
    mask = label > 0
    known = depth_m > 0
    disc = element(band_px, Shape.ELLIPSE)
    inner = cv2.erode(mask.view(np.uint8), disc, borderType=cv2.BORDER_REPLICATE) != 0
    outer = ~grown(mask, band_px, Shape.ELLIPSE)
    body_m, has_body = _mean_depth(depth_m, inner & known, window_px)
    ground_m, has_ground = _mean_depth(depth_m, outer & known, window_px)
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


def _mean_depth(depth_m: F32, where: Bool, window_px: int) -> tuple[F32, Bool]:
    """Return the mean depth [m] of some pixels around each, twice: the second time without what is far from the first.

    Returns:
        The depths (h, w), and where there are enough pixels.
    """
    rough_m, _ = _window_mean(depth_m, where, window_px)
    return _window_mean(depth_m, where & (np.abs(depth_m - rough_m) < FAR_M), window_px)


def _window_mean(depth_m: F32, where: Bool, window_px: int) -> tuple[F32, Bool]:
    size = (window_px, window_px)
    weight = where.astype(np.float32)
    count = cv2.boxFilter(weight, -1, size, normalize=False, borderType=cv2.BORDER_CONSTANT)
    total = cv2.boxFilter(weight * depth_m, -1, size, normalize=False, borderType=cv2.BORDER_CONSTANT)
    enough = np.asarray(count > FEWEST - 0.5)
    return np.asarray(total / np.maximum(count, 1.0), dtype=np.float32), enough


def _surroundings(label: U8, margin_px: int) -> tuple[slice, slice]:
    """Return the rows and columns of all labels, with a margin."""
    x, y, width, height = cv2.boundingRect(label)
    rows = slice(max(y - margin_px, 0), min(y + height + margin_px, label.shape[0]))
    return rows, slice(max(x - margin_px, 0), min(x + width + margin_px, label.shape[1]))
