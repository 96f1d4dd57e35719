"""Masks made larger, and what they are made larger by."""

from enum import IntEnum
from functools import lru_cache

import cv2
import numpy as np

from stillroom.geometry.arrays import U8, Bool


class Shape(IntEnum):
    """What a pixel grows to; the values are OpenCV's."""

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
    """Return a mask (H, W) with all pixels that a pixel of it reaches; the mask itself where nothing is to grow."""
    if reach_px <= 0 or not mask.any():
        return mask
    pixels = np.ascontiguousarray(mask).view(np.uint8)
    return np.asarray(cv2.dilate(pixels, element(reach_px, shape)), dtype=np.uint8).view(np.bool_)
