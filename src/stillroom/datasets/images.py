"""Pixels from disk: the only place that knows OpenCV's blue-green-red order and a depth image's integers."""

from pathlib import Path

import cv2
import numpy as np

from stillroom.errors import FrameError
from stillroom.geometry.arrays import F32, U8, U16

# Cameras that write JPEG put how they were held into EXIF; the calibration is of the sensor as it is.
COLOUR_FLAGS = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
PNG_START, PNG_END = b"\x89PNG", b"IEND\xaeB`\x82"
JPEG_START, JPEG_END = b"\xff\xd8", b"\xff\xd9"


def read_rgb(path: Path) -> U8:
    """Read a colour image (H, W, 3) uint8, RGB order.

    Raises:
        FrameError: The file is missing, cut off, or no image.
    """
    bgr = _decode(path, COLOUR_FLAGS)
    return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), dtype=np.uint8)


def read_depth_units(path: Path) -> U16:
    """Read a depth image (H, W) uint16 in the sensor's units; 0 where unknown.

    Raises:
        FrameError: The file is missing, cut off, no image, or not one channel of 16 bits.
    """
    units = _decode(path, cv2.IMREAD_UNCHANGED)
    if units.ndim != 2 or units.dtype != np.uint16:
        channels = 1 if units.ndim == 2 else units.shape[2]
        raise FrameError(
            f"{path}: {channels} channel(s) of {units.dtype.itemsize * 8} bits; depth must be one channel of 16 bits"
        )
    return units.astype(np.uint16, copy=False)


def depth_in_metres(units: U16, depth_factor: float) -> F32:
    """Return depth (H, W) float32 [m] of sensor units with `depth_factor` units per metre."""
    return np.divide(units, np.float32(depth_factor), dtype=np.float32)


def _decode(path: Path, flags: int) -> U8 | U16:
    try:
        encoded = path.read_bytes()
    except FileNotFoundError:
        raise FrameError(f"{path}: no such image, though the sequence lists it") from None
    except OSError as error:
        raise FrameError(f"{path}: cannot be read ({error.strerror})") from error
    if _is_cut_off(encoded):
        raise FrameError(f"{path}: the image is cut off after {len(encoded)} bytes; fetch the sequence again")
    try:
        pixels = cv2.imdecode(np.frombuffer(encoded, dtype=np.uint8), flags) if encoded else None
    except cv2.error as error:
        raise FrameError(f"{path}: does not decode as an image ({error.err})") from error
    if pixels is None:
        raise FrameError(f"{path}: does not decode as an image ({len(encoded)} bytes)")
    return pixels  # type: ignore[return-value]  # OpenCV types it as any integer or float array


def _is_cut_off(encoded: bytes) -> bool:
    """Tell whether a PNG or JPEG lacks its end.

    Some decoders fill what is missing with gray and say nothing that a program can hear. Phones append data after a
    JPEG's end mark, and thumbnails at its start have end marks of their own, so the second half is searched; the
    coded pixels themselves cannot contain it.
    """
    if encoded.startswith(PNG_START):
        return PNG_END not in encoded[-64:]
    return encoded.startswith(JPEG_START) and JPEG_END not in encoded[len(encoded) // 2 :]
