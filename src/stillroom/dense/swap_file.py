"""A temporary file for what does not fit into memory; it is deleted with the process."""

import tempfile
from pathlib import Path
from typing import Any, TypeAlias

RawFile: TypeAlias = Any
"""What `tempfile` gives has no public type."""

GRAIN = 1 << 14
"""Pieces are rounded up to this many bytes, so that a place that is free again fits the next piece."""


class SwapFile:
    """Pieces of bytes by the places where they lie."""

    def __init__(self, folder: Path | None) -> None:
        """Open no file yet: most runs never need one.

        Args:
            folder: Where the file goes; the system's own choice where None.
        """
        self._folder = folder
        self._file: RawFile | None = None
        self._end = 0
        self._free: dict[int, list[int]] = {}

    def write(self, piece: bytes) -> int:
        """Write a piece and return its place.

        Raises:
            OSError: There is no room, or the folder cannot be written to.
        """
        if self._file is None:
            self._file = _vanishing_file(self._folder)
        size = _rounded(len(piece))
        places = self._free.get(size)
        place = places[-1] if places else self._end
        self._file.seek(place)
        if self._file.write(piece) < len(piece):
            raise OSError(f"{self._file.name}: no room left")
        if places:
            places.pop()
        self._end = max(self._end, place + size)
        return place

    def take(self, place: int, n_bytes: int) -> bytes:
        """Read a piece and let its place be used again."""
        piece = self.read(place, n_bytes)
        self._free.setdefault(_rounded(n_bytes), []).append(place)
        return piece

    def read(self, place: int, n_bytes: int) -> bytes:
        """Read a piece.

        Raises:
            OSError: It cannot be read.
        """
        assert self._file is not None
        self._file.seek(place)
        piece: bytes = self._file.read(n_bytes)
        if len(piece) < n_bytes:
            raise OSError(f"{self._file.name}: ends too early")
        return piece


def _vanishing_file(folder: Path | None) -> RawFile:
    return tempfile.NamedTemporaryFile(  # open as long as the map is
        buffering=0, prefix="stillroom-", suffix=".swap", dir=folder
    )


def _rounded(n_bytes: int) -> int:
    return -(-n_bytes // GRAIN) * GRAIN
