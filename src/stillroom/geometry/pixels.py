"""Image values at points, and dilation of masks."""

from enum import IntEnum
from functools import lru_cache
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from stillroom.geometry.arrays import U8, Bool, Floats

Value = TypeVar("Value", bound=np.generic)


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
    return np.asarray(cv2.dilate(pixels, element(reach_px, shape)), dtype=np.uint8).view(np.bool_)


def values_at(image: NDArray[Value], px: Floats) -> NDArray[Value]:
    """Return an image's (H, W) values at points (N, 2) [px], (N,): that of the nearest pixel, outside of the edge's."""
    height, width = image.shape
    column, row = np.rint(px).astype(np.int64).T
    values: NDArray[Value] = image[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)]
    return values
