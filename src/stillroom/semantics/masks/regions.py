"""From segments to semantics: a dilated mask of the whole image, and a box around each region."""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from stillroom.bounds import bounded
from stillroom.compiled import njit
from stillroom.data.semantics import Box, Semantics, nothing
from stillroom.geometry.arrays import F32, F64, I32, Bool
from stillroom.geometry.pixels import Shape, grown
from stillroom.semantics.masks.mask_segments import MaskSegments


@dataclass(frozen=True)
class RegionsConfig:
    """Dilation of masks, and boxes of regions.

    Attributes:
        min_px: Smallest region that counts [px of the whole image].
        dilate_px: Dilation of the mask [px]; corners on a border are no surface points (DynaSLAM: 15;
            docs/reference.md#dynaslam).
        crowd_share, crowd_px: Where the dilated mask would cover more than this share of the image, it is dilated by no
            more than this: in a crowd, the room is seen between people.
        boxes: Whether each region becomes a box, too; boxes are not dilated.
    """

    min_px: int = bounded(400, least=0, pixels=2)
    dilate_px: int = bounded(5, least=0, pixels=1)
    crowd_share: float = bounded(0.6, least=0)
    crowd_px: int = bounded(5, least=0, pixels=1)
    boxes: bool = True


def without_specks(segments: MaskSegments, min_px: int) -> MaskSegments:
    """Return segments without regions smaller than `min_px` pixels of the whole image."""
    if not segments.has_any or min_px == 0:
        return segments
    around, region, statistics = _regions(segments.mask)
    counts = 4 * statistics[:, cv2.CC_STAT_AREA] >= min_px
    if counts[1:].all():
        return segments
    label = segments.label.copy()
    label[around][~counts[region] & (region > 0)] = 0
    return replace(segments, label=label)


def as_semantics(
    segments: MaskSegments,
    names: tuple[str, ...],
    height: int,
    width: int,
    age: int,
    config: RegionsConfig,
    still: tuple[str, ...] = (),
) -> Semantics:
    """Return segments as semantics of an image.

    Args:
        segments: What is potentially dynamic, at half size.
        names: The movable classes.
        height: Rows of the image.
        width: Its columns.
        age: Age of the network's result, in frames.
        config: Dilation and boxes.
        still: The named classes, which do not move by themselves.
    """
    named: tuple[Box, ...] = ()
    if segments.named is not None:
        there = without_specks(MaskSegments(segments.named, segments.probability), config.min_px)
        named = _boxes(there, still, height, width, age)
    if not segments.has_any:
        return replace(nothing(height, width), named=named)
    boxes = _boxes(segments, names, height, width, age) if config.boxes else ()
    # At twice the size the nearest pixel has 9/16 of the weight in a linear interpolation: it decides alone.
    twice = cv2.resize(segments.mask.view(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST)
    mask = np.asarray(twice, dtype=np.uint8).view(np.bool_)
    movable = grown(mask, config.dilate_px, Shape.ELLIPSE)
    if config.crowd_px < config.dilate_px and np.count_nonzero(movable) > config.crowd_share * movable.size:
        movable = grown(mask, config.crowd_px, Shape.ELLIPSE)
    return Semantics(height, width, boxes, movable, named=named)


def _boxes(segments: MaskSegments, names: tuple[str, ...], height: int, width: int, age: int) -> tuple[Box, ...]:
    """Return the box around each region of a class, the largest first; its confidence is the mean probability."""
    found = []
    for number in range(1, len(names) + 1):
        of_class = segments.label == number
        if not of_class.any():
            continue
        around, region, statistics = _regions(of_class)
        area = statistics[:, cv2.CC_STAT_AREA]
        sums = np.zeros(len(area), dtype=np.float64)
        add_up(region, np.ascontiguousarray(segments.probability[around]), sums)
        for k in range(1, len(area)):
            x, y, columns, rows = statistics[k, :4].tolist()
            x, y = x + around[1].start, y + around[0].start
            # A pixel of the half image is two of the whole one; a last odd row or column belongs to the last of them.
            x1 = width - 1 if x + columns == segments.label.shape[1] else 2 * (x + columns) - 1
            y1 = height - 1 if y + rows == segments.label.shape[0] else 2 * (y + rows) - 1
            confidence = float(np.clip(sums[k] / area[k], 0.0, 1.0))
            found.append((int(area[k]), Box(2.0 * x, 2.0 * y, x1, y1, names[number - 1], confidence, age)))
    found.sort(key=lambda pair: -pair[0])
    return tuple(box for _, box in found)


def _regions(mask: Bool) -> tuple[tuple[slice, slice], I32, I32]:
    """Return the connected regions of a mask (h, w) that is not empty.

    Returns:
        Rows and columns of the rectangle around all of them; the number of each of its pixels' region, from 1, and 0
        beside them; and OpenCV's statistics of each number, in that rectangle.
    """
    pixels = mask.view(np.uint8)
    x, y, width, height = cv2.boundingRect(pixels)
    around = slice(y, y + height), slice(x, x + width)
    _, region, statistics, _ = cv2.connectedComponentsWithStats(pixels[around], connectivity=8)
    return around, np.asarray(region, dtype=np.int32), np.asarray(statistics, dtype=np.int32)


@njit(nogil=True, cache=True)
def add_up(region: I32, values: F32, sums: F64) -> None:
    """Add the values (H, W) of the pixels of each region to its sum (R,); `region` is the number of each pixel's."""
    height, width = region.shape
    for y in range(height):
        for x in range(width):
            if region[y, x] != 0:
                sums[region[y, x]] += values[y, x]
