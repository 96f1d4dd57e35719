"""The size of pixels, image values at points, and dilation of masks."""

from enum import IntEnum
from functools import lru_cache
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from stillroom.compiled import njit
from stillroom.geometry.arrays import I64, U8, Bool, Floats

Value = TypeVar("Value", bound=np.generic)
WIDE_PX = 7
"""From this reach on, growing each run of a row takes less time than OpenCV's dilation by an ellipse."""


# The size of pixels. A pixel of a large image is a small angle: thresholds and windows in pixels grow with the image.


USUAL_SIDE_PX = 640
"""Longer side of the images that settings and constants in pixels are made for; a portrait one is 640 high."""


def pixel_scale(width: int, height: int) -> float:
    """Return by what lengths in pixels are multiplied in images of a size [px]; exactly 1 at 640×480 and 480×640."""
    return max(width, height) / USUAL_SIDE_PX


def in_pixels(length_px: int, scale: float) -> int:
    """Return a whole length [px], multiplied by `pixel_scale`; at least 1, but 0 stays 0."""
    return max(1, round(length_px * scale)) if length_px > 0 else length_px


# Dilation of masks, and structuring elements.


class Shape(IntEnum):
    """Shape of a structuring element; the values are OpenCV's."""

    SQUARE = cv2.MORPH_RECT
    ELLIPSE = cv2.MORPH_ELLIPSE


@lru_cache(maxsize=64)
def element(reach_px: int, shape: Shape) -> U8:
    """Return the structuring element (2 · reach + 1, 2 · reach + 1) of a reach, made once; not to be written to."""
    side = 2 * reach_px + 1
    made = np.asarray(cv2.getStructuringElement(shape, (side, side)), dtype=np.uint8)
    made.setflags(write=False)
    return made


def grown(mask: Bool, reach_px: int, shape: Shape) -> Bool:
    """Return a mask (H, W), dilated; the mask itself if the reach is 0."""
    if reach_px <= 0 or not mask.any():
        return mask
    pixels = np.ascontiguousarray(mask).view(np.uint8)
    if shape == Shape.ELLIPSE and reach_px >= WIDE_PX:
        dilated = np.zeros(pixels.shape, dtype=np.uint8)
        grow_runs(pixels, _half_widths(reach_px), dilated)
        return dilated.view(np.bool_)
    return np.asarray(cv2.dilate(pixels, element(reach_px, shape)), dtype=np.uint8).view(np.bool_)


@lru_cache(maxsize=64)
def _half_widths(reach_px: int) -> I64:
    """Return how far each row of an ellipse reaches to either side (2 · reach + 1,) [px]."""
    return np.asarray(element(reach_px, Shape.ELLIPSE).sum(axis=1, dtype=np.int64) // 2)


@njit(nogil=True, cache=True)
def grow_runs(pixels: U8, half_widths: I64, dilated: U8) -> None:
    """Set what a mask (H, W) covers when each of its pixels grows to an ellipse.

    Args:
        pixels: The mask; all but 0 is set.
        half_widths: How far each row of the ellipse reaches to either side (2 · reach + 1,) [px].
        dilated: The result (H, W), zeros before.
    """
    height, width = pixels.shape
    reach = len(half_widths) // 2
    for y in range(height):
        row = pixels[y]
        x = 0
        while x < width:
            while x < width and row[x] == 0:
                x += 1
            if x == width:
                break
            first = x
            while x < width and row[x] != 0:
                x += 1
            for line in range(max(y - reach, 0), min(y + reach + 1, height)):
                beside = half_widths[line - y + reach]
                dilated[line, max(first - beside, 0) : min(x + beside, width)] = 1


def values_at(image: NDArray[Value], px: Floats) -> NDArray[Value]:
    """Return an image's (H, W) values at points (N, 2) [px], (N,): that of the nearest pixel, outside of the edge's."""
    height, width = image.shape
    column, row = np.rint(px).astype(np.int64).T
    values: NDArray[Value] = image[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)]
    return values
