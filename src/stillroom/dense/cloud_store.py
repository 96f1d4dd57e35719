"""Keyframe clouds, kept so that they can be subtracted from the map; the least recently used are swapped to a file."""

import logging
from collections import OrderedDict
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from stillroom.dense.keyframe_cloud import KeyframeCloud
from stillroom.dense.swap_file import SwapFile
from stillroom.geometry.arrays import U8, U16

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class _Packed:
    """A cloud with its usable pixels as bits."""

    depth: U16 = field(repr=False)
    rgb: U8 = field(repr=False)
    bits: U8 = field(repr=False)

    @property
    def n_bytes(self) -> int:
        return self.depth.nbytes + self.rgb.nbytes + self.bits.nbytes


class CloudStore:
    """Clouds by keyframe, all of one shape, within a bound of memory."""

    def __init__(self, shape: tuple[int, int], max_bytes: float, folder: Path | None) -> None:
        """Start empty.

        Args:
            shape: Rows and columns of the clouds.
            max_bytes: Above this, the least recently used clouds go to a file.
            folder: Where the file goes; None for the system's default.
        """
        self._shape, self._max_bytes = shape, max_bytes
        self._resident: OrderedDict[int, _Packed] = OrderedDict()
        self._places: dict[int, int] = {}
        self._file = SwapFile(folder)
        self._bytes_of_one = 0

    @property
    def n_bytes(self) -> int:
        """Memory that is held."""
        return len(self._resident) * self._bytes_of_one

    @property
    def n_swapped(self) -> int:
        """How many clouds lie in the file."""
        return len(self._places)

    def __contains__(self, keyframe: int) -> bool:
        """Return whether the cloud of a keyframe is kept."""
        return keyframe in self._resident or keyframe in self._places

    def put(self, keyframe: int, cloud: KeyframeCloud) -> list[int]:
        """Keep a cloud; return the keyframes whose clouds were dropped because the file is full."""
        packed = _Packed(cloud.depth, cloud.rgb, np.packbits(cloud.usable))
        self._bytes_of_one = packed.n_bytes
        self._resident[keyframe] = packed
        lost = []
        while self.n_bytes > self._max_bytes and len(self._resident) > 1:
            oldest, spilled = self._resident.popitem(last=False)
            try:
                self._places[oldest] = self._file.write(_to_bytes(spilled))
            except OSError as error:
                logger.warning("dense map: keyframe %d can no longer be corrected: %s", oldest, error)
                lost.append(oldest)
        return lost

    def take(self, keyframe: int) -> KeyframeCloud:
        """Return a cloud that is kept, and keep it no more."""
        packed = self._resident.pop(keyframe, None)
        if packed is None:
            packed = self._from_bytes(self._file.take(self._places.pop(keyframe), self._bytes_of_one))
        usable = np.unpackbits(packed.bits, count=packed.depth.size).reshape(self._shape)
        return KeyframeCloud(packed.depth, packed.rgb, usable)

    def _from_bytes(self, read: bytes) -> _Packed:
        piece = bytearray(read)  # arrays on bytes are read-only: kernels would be compiled again for these
        h, w = self._shape
        n = h * w
        depth = np.frombuffer(piece, dtype=np.uint16, count=n).reshape(h, w)
        rgb = np.frombuffer(piece, dtype=np.uint8, offset=2 * n, count=3 * n).reshape(h, w, 3)
        return _Packed(depth, rgb, np.frombuffer(piece, dtype=np.uint8, offset=5 * n))


def _to_bytes(packed: _Packed) -> bytes:
    return packed.depth.tobytes() + packed.rgb.tobytes() + packed.bits.tobytes()
