"""Image files and their times, in the order of time."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stillroom.errors import DatasetError
from stillroom.geometry.arrays import F64

IMAGE_SUFFIXES = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".ppm", ".pgm"}
HIDDEN = "."
"""Files whose names begin so are no images of a sequence: macOS writes `._0001.png` beside `0001.png`."""


@dataclass(frozen=True)
class Listing:
    """Image files and their times.

    Attributes:
        source: The list file or folder, for messages.
        timestamps_s: Times (N,) float64 [s], strictly increasing.
        files: The images, in the same order.
    """

    source: Path
    timestamps_s: F64
    files: tuple[Path, ...]


def increasing(source: Path, timestamps_s: Sequence[float], places: Sequence[str]) -> F64:
    """Return times (N,) float64 [s] after making sure that they are finite and strictly increase.

    Raises:
        DatasetError: One does not; the message names its place.
    """
    times = np.asarray(timestamps_s, dtype=np.float64)
    for wrong in np.flatnonzero(~np.isfinite(times)).tolist():
        raise DatasetError(f"{source}{places[wrong]}: the timestamp is not a finite number")
    for step in np.flatnonzero(np.diff(times) <= 0).tolist():
        word = "repeats" if times[step + 1] == times[step] else "goes back"
        raise DatasetError(
            f"{source}{places[step + 1]}: the timestamp {times[step + 1]:.6f} {word}; times must increase, remove it"
        )
    return times
