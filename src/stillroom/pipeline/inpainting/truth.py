"""How near a painted sequence comes to the same rendered room without people."""

from dataclasses import dataclass

import numpy as np

from stillroom.datasets.recording import rendered
from stillroom.geometry.arrays import U8, Bool
from stillroom.protocols import Dataset

EVERY = 5
"""Every so many-th frame is judged: the empty room must be rendered for it."""
BRIGHTEST = 255.0


@dataclass
class PaintedError:
    """The error of painted pixels, where the background had been seen.

    Attributes:
        empty: The sequence without people.
        n_frames, n_pixels: How many were judged.
        squared: Sum of the squared errors of their red, green and blue.
    """

    empty: Dataset
    n_frames: int = 0
    n_pixels: int = 0
    squared: float = 0.0

    def add(self, index: int, rgb: U8, is_filled: Bool) -> None:
        """Judge the painted pixels (H, W) of a painted image (H, W, 3), if it is its turn."""
        if index % EVERY != 0 or not is_filled.any():
            return
        true = self.empty.load(index).rgb
        self.n_frames += 1
        self.n_pixels += int(np.count_nonzero(is_filled))
        self.squared += float(np.sum((rgb[is_filled].astype(np.float64) - true[is_filled]) ** 2))

    @property
    def psnr_db(self) -> float | None:
        """Peak signal-to-noise ratio over all of them [dB]; None where nothing was judged, infinite without error."""
        if self.n_pixels == 0:
            return None
        mean = self.squared / (3 * self.n_pixels)
        return float(10.0 * np.log10(BRIGHTEST**2 / mean)) if mean > 0 else float("inf")


def painted_error(dataset: Dataset) -> PaintedError | None:
    """Return what judges a painted sequence; None where nobody knows what is behind the people."""
    room = rendered(dataset)
    empty = None if room is None else room.without_people()
    return None if empty is None else PaintedError(empty)
