"""Depth and colours of keyframes, if wanted: a dense map can be made from them later."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from stillroom.data.image import Image, RgbdImage
from stillroom.errors import MapError
from stillroom.geometry.arrays import U8, Bool

JPEG_QUALITY = 95
PNG_LEVEL = 1
_LARGEST = 65535.0


@dataclass(frozen=True)
class Pictures:
    """The images of a keyframe, compressed.

    Attributes:
        keyframe: Its id.
        depth_png: Depth in the camera's units, 16 bits, without loss; 0 where unknown and where something moved.
        rgb_jpeg: Colours.
    """

    keyframe: int
    depth_png: bytes
    rgb_jpeg: bytes


def compress(keyframe: int, image: Image, moving: Bool, depth_factor: float) -> Pictures:
    """Compress a keyframe's images.

    Args:
        keyframe: Its id.
        image: Its image.
        moving: Pixels that move (H, W); their depth is left out.
        depth_factor: Units of depth in a metre.
    """
    units = np.rint(np.where(moving, 0.0, image.depth_m) * depth_factor)
    units[units > _LARGEST] = 0.0
    _, depth_png = cv2.imencode(".png", units.astype(np.uint16), [cv2.IMWRITE_PNG_COMPRESSION, PNG_LEVEL])
    bgr = cv2.cvtColor(image.rgb, cv2.COLOR_RGB2BGR)
    _, rgb_jpeg = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return Pictures(keyframe, depth_png.tobytes(), rgb_jpeg.tobytes())


def restore(pictures: Pictures, image_index: int, timestamp_s: float, depth_factor: float) -> RgbdImage:
    """Return a keyframe's image; pixels that moved have no depth.

    Raises:
        MapError: The pictures are damaged.
    """
    units, bgr = _decoded(pictures.depth_png, cv2.IMREAD_UNCHANGED), _decoded(pictures.rgb_jpeg, cv2.IMREAD_COLOR)
    if units is None or bgr is None or units.shape != bgr.shape[:2]:
        raise MapError(f"the images of keyframe {pictures.keyframe} cannot be decoded; the map is damaged")
    rgb: U8 = np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), dtype=np.uint8)
    depth_m = (units.astype(np.float64) / depth_factor).astype(np.float32)
    return RgbdImage(timestamp_s, rgb, depth_m, image_index)


def _decoded(encoded: bytes, flags: int) -> NDArray[Any] | None:
    """Return the pixels of an image; None where it cannot be decoded."""
    try:
        return cv2.imdecode(np.frombuffer(encoded, dtype=np.uint8), flags) if encoded else None
    except cv2.error:  # of a size that OpenCV refuses
        return None
