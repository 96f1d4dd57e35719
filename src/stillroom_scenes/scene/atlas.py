"""The atlas: all textures of a scene with their mipmaps in one flat array."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from stillroom.geometry.arrays import I64, U8

MAX_LEVELS = 9
SMALLEST_PX = 4


@dataclass(frozen=True)
class Atlas:
    """Textures with mipmaps.

    Attributes:
        texels: Colours 0x00BBGGRR (M,) uint32, level after level, row after row.
        levels: Offset, width, height of each level (T, MAX_LEVELS, 3) int64; levels a texture lacks repeat its
            coarsest.
    """

    texels: NDArray[np.uint32]
    levels: I64


class AtlasBuilder:
    """Collects textures and gives each a number."""

    def __init__(self) -> None:
        self._chunks: list[NDArray[np.uint32]] = []
        self._levels: list[I64] = []
        self._size = 0

    def add(self, picture: U8) -> int:
        """Add a picture (H, W, 3) RGB and return its number."""
        levels = np.zeros((MAX_LEVELS, 3), dtype=np.int64)
        image = picture
        for level in range(MAX_LEVELS):
            levels[level:] = self._size, image.shape[1], image.shape[0]
            self._chunks.append(_pack(image))
            self._size += image.shape[0] * image.shape[1]
            if min(image.shape[:2]) < 2 * SMALLEST_PX:
                break
            half = (image.shape[1] // 2, image.shape[0] // 2)
            image = np.asarray(cv2.resize(image, half, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        self._levels.append(levels)
        return len(self._levels) - 1

    def build(self) -> Atlas:
        """Return the atlas of all that was added."""
        return Atlas(np.concatenate(self._chunks), np.stack(self._levels))


def _pack(image: U8) -> NDArray[np.uint32]:
    wide = image.astype(np.uint32)
    return np.ascontiguousarray(wide[..., 0] | wide[..., 1] << 8 | wide[..., 2] << 16).reshape(-1)
