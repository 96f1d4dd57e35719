"""Rendered frames on disk: `<cache>/stillroom/synthetic/<hash of spec and renderer>/<index>.frame`."""

import logging
import os
import shutil
import struct
import tempfile
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stillroom.data.locations import cache_folder
from stillroom.geometry.arrays import U8, U16

logger = logging.getLogger(__name__)

MAGIC = b"SRF1"
HEADER = struct.Struct("<4sIII")  # magic, checksum of the rest, height, width
BYTES_PER_PIXEL = 6
BUDGET_BYTES = 2 << 30


@dataclass(frozen=True)
class StoredFrame:
    """A rendered frame as the sensor returns it, and the instance of each pixel.

    Attributes:
        rgb: (H, W, 3) uint8.
        measured: What else the sensor gives (H, W) uint16: depth in its units, 0 where unknown; of a pair of cameras
            the brightness of the right image.
        instance: (H, W) uint8.
    """

    rgb: U8
    measured: U16
    instance: U8


class FrameCache:
    """Stores frames of one sequence, each in a file of its own, uncompressed: reading must be faster than rendering.

    The whole cache has a size limit: opening one removes the least recently used sequences, and a sequence
    that alone is larger keeps its first frames only. Damaged or missing frames are rendered again.
    """

    def __init__(self, key: str, budget_bytes: int = BUDGET_BYTES) -> None:
        """Open the cache of the sequence with a key; nothing is written before the first frame is kept."""
        self.folder = cache_folder() / "synthetic" / key
        self._budget_bytes = budget_bytes
        self._usable = True
        _make_room(self.folder, budget_bytes // 2)

    def read(self, index: int) -> StoredFrame | None:
        """Return frame `index`; None where it is not kept, or damaged."""
        try:
            content = self._path(index).read_bytes()
        except OSError:
            return None
        return _unpacked(content)

    def keep(self, index: int, frame: StoredFrame) -> None:
        """Write frame `index` atomically, if it fits the size limit."""
        size = frame.instance.size * BYTES_PER_PIXEL + HEADER.size
        if not self._usable or (index + 1) * size > self._budget_bytes // 2:
            return
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            _write_whole(self._path(index), _packed(frame))
        except OSError as error:
            self._usable = False
            logger.info("%s: rendered frames are not kept (%s)", self.folder, error)

    def _path(self, index: int) -> Path:
        return self.folder / f"{index:06d}.frame"


def _write_whole(path: Path, content: bytes) -> None:
    """Write a file atomically: to a temporary name, then renamed."""
    with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".part", delete=False) as file:
        part = Path(file.name)
        try:
            file.write(content)
            file.flush()
            part.replace(path)
        except OSError:
            part.unlink(missing_ok=True)
            raise


def _packed(frame: StoredFrame) -> bytes:
    body = frame.rgb.tobytes() + frame.measured.tobytes() + frame.instance.tobytes()
    return HEADER.pack(MAGIC, zlib.crc32(body), *frame.instance.shape) + body


def _unpacked(content: bytes) -> StoredFrame | None:
    if len(content) < HEADER.size:
        return None
    magic, checksum, height, width = HEADER.unpack_from(content)
    body = memoryview(content)[HEADER.size :]
    pixels = height * width
    if magic != MAGIC or len(body) != BYTES_PER_PIXEL * pixels or zlib.crc32(body) != checksum:
        return None
    rgb = np.frombuffer(body, np.uint8, 3 * pixels).reshape(height, width, 3)
    measured = np.frombuffer(body, np.uint16, pixels, 3 * pixels).reshape(height, width)
    instance = np.frombuffer(body, np.uint8, pixels, 5 * pixels).reshape(height, width)
    # Copies, so that the arrays can be written to, as those just rendered: kernels are compiled for one kind only.
    return StoredFrame(rgb.copy(), measured, instance.copy())


def _make_room(folder: Path, budget_bytes: int) -> None:
    """Mark the folder as used now, and remove others until the cache fits the size limit."""
    try:
        if folder.is_dir():
            os.utime(folder)
        others = [place for place in folder.parent.iterdir() if place.is_dir() and place != folder]
        by_age = sorted(others, key=lambda place: place.stat().st_mtime, reverse=True)
        total = 0
        for place in by_age:
            total += sum(file.stat().st_size for file in place.iterdir())
            if total > budget_bytes:
                shutil.rmtree(place, ignore_errors=True)
    except OSError as error:
        logger.debug("%s: not tidied (%s)", folder.parent, error)
