"""The accuracy of person segmentation on pictures that were not in the training set."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from stillroom.geometry.arrays import U8, Bool

Segment = Callable[[U8], Bool]
"""From a picture (H, W, 3) uint8 to where people are (H, W)."""


@dataclass(frozen=True)
class Overlap:
    """Intersection over union of people's pixels, predicted and true.

    Attributes:
        mean: Mean over the pictures.
        total: Of all pictures' pixels together.
        pictures: How many there are.
    """

    mean: float
    total: float
    pictures: int


def overlap(segment: Segment, pictures: Iterable[tuple[U8, U8]]) -> Overlap:
    """Return the overlap over pictures and their masks (255 = person). A picture without any person counts 1 or 0."""
    counts = [_counts(segment(rgb), mask > 127) for rgb, mask in pictures]
    both, either = np.array(counts, dtype=np.float64).reshape(-1, 2).T
    each = np.where(either > 0, both / np.maximum(either, 1.0), 1.0)
    total = both.sum() / max(either.sum(), 1.0)
    return Overlap(float(each.mean()) if len(each) else 1.0, float(total), len(each))


def called_person(segment: Segment, pictures: Iterable[U8]) -> float:
    """Return the share of the pixels of some pictures that is classified as person."""
    shares = [float(segment(rgb).mean()) for rgb in pictures]
    return float(np.mean(shares)) if shares else 0.0


def _counts(told: Bool, true: Bool) -> tuple[int, int]:
    return int((told & true).sum()), int((told | true).sum())
