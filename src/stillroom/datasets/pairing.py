"""Which colour and depth images belong together: by time, by name, or in order where that is asked for."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from stillroom.data.association import TUM_MAX_GAP_S, associate, closest
from stillroom.datasets.listing import Listing
from stillroom.datasets.time_units import POWERS
from stillroom.errors import ConfigError, DatasetError
from stillroom.geometry.arrays import F64, I64

BY_TIME, BY_NAME, BY_ORDER = "time", "name", "order"
WAYS = (BY_TIME, BY_NAME, BY_ORDER)


@dataclass(frozen=True)
class Pairing:
    """How the user wants times to be read and images to be paired.

    Attributes:
        time_unit: Unit of the times in lists and names: s, ms, us or ns; told from the numbers where not given.
        by: What tells that two images belong together: time, name or order. Where not given, time where there are
            times, else names.
        max_gap_s: Images further apart in time are not paired [s].
        depth_offset_s: Added to the times of depth [s] before they are compared; negative where depth is stamped late.
            What is then left between a depth image and its colour image is corrected by the camera's motion.
    """

    time_unit: str | None = None
    by: str | None = None
    max_gap_s: float = TUM_MAX_GAP_S
    depth_offset_s: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what cannot be.

        Raises:
            ConfigError: A value is none of those that there are.
        """
        if self.time_unit is not None and self.time_unit not in POWERS:
            raise ConfigError(f"time-unit is '{self.time_unit}'; it must be one of {', '.join(POWERS)}")
        if self.by is not None and self.by not in WAYS:
            raise ConfigError(f"pair-by is '{self.by}'; it must be one of {', '.join(WAYS)}")
        if not (np.isfinite(self.max_gap_s) and self.max_gap_s > 0):
            raise ConfigError(f"max-gap is {self.max_gap_s}; it must be a positive number of seconds")
        if not np.isfinite(self.depth_offset_s):
            raise ConfigError(f"depth-offset is {self.depth_offset_s}; it must be a number of seconds")

    def or_offset(self, depth_offset_s: float) -> "Pairing":
        """Return the same with a camera's offset of the clocks [s], where the user gave none."""
        return self if self.depth_offset_s else replace(self, depth_offset_s=depth_offset_s)


def pair_images(
    folder: Path, rgb: Listing, depth: Listing, pairing: Pairing, default: str = BY_TIME
) -> tuple[I64, I64]:
    """Return indices (K,) of colour and (K,) of depth images that belong together, K ≥ 1, in order of time.

    Args:
        folder: The sequence, for messages.
        rgb: Colour images.
        depth: Depth images.
        pairing: How they are to be paired.
        default: What tells it where the user did not say: time, name or order.

    Raises:
        DatasetError: Nothing belongs together, or it cannot be told.
    """
    by = pairing.by or default
    if by == BY_ORDER:
        return pair_by_order(folder, len(rgb.files), len(depth.files))
    if by == BY_NAME:
        return pair_by_name(folder, rgb.files, depth.files)
    return pair_by_time(folder, rgb.timestamps_s, depth.timestamps_s, pairing)


def pair_by_time(folder: Path, rgb_s: F64, depth_s: F64, pairing: Pairing) -> tuple[I64, I64]:
    """Return indices (K,) of colour and (K,) of depth images that are close in time, K ≥ 1.

    Raises:
        DatasetError: None are.
    """
    shifted_s = depth_s + pairing.depth_offset_s
    of_rgb, of_depth = associate(rgb_s, shifted_s, pairing.max_gap_s)
    if len(of_rgb):
        return of_rgb, of_depth
    late_s = float(np.median(shifted_s[closest(shifted_s, rgb_s)] - rgb_s))
    raise DatasetError(
        f"{folder}: no colour image has a depth image within {pairing.max_gap_s:g} s; the closest ones are stamped "
        f"{abs(late_s):.3g} s {'later' if late_s > 0 else 'earlier'} (median): give --depth-offset "
        f"{pairing.depth_offset_s - late_s:.3g} if the clocks differ, or a larger --max-gap "
        "[see troubleshooting: depth-offset]"
    )


def pair_by_name(folder: Path, rgb: Sequence[Path], depth: Sequence[Path]) -> tuple[I64, I64]:
    """Return indices (K,) of colour and (K,) of depth images of one name, or of one number in their names.

    Raises:
        DatasetError: The names do not tell: fewer than half of them have a counterpart.
    """
    for key in (lambda path: path.stem, last_number):
        rgb_at = {key(path): place for place, path in enumerate(rgb)}
        depth_at = {key(path): place for place, path in enumerate(depth)}
        are_names = None not in rgb_at and len(rgb_at) == len(rgb) and len(depth_at) == len(depth)
        both = [name for name in rgb_at if name in depth_at]
        if are_names and 2 * len(both) >= min(len(rgb), len(depth)):
            pairs = np.array([(rgb_at[name], depth_at[name]) for name in both], dtype=np.int64)
            return pairs[:, 0], pairs[:, 1]
    raise DatasetError(
        f"{folder}: {len(rgb)} colour and {len(depth)} depth images whose names do not tell which belong together "
        f"({rgb[0].name}, {depth[0].name}); name them alike, or give --pair-by order where the first of both belong "
        "together, the second, and so on [see troubleshooting: pairing]"
    )


def pair_by_order(folder: Path, n_rgb: int, n_depth: int) -> tuple[I64, I64]:
    """Return 0 … N − 1 twice: the indices of colour and depth images in order.

    Raises:
        DatasetError: There are not equally many.
    """
    if n_rgb != n_depth:
        raise DatasetError(
            f"{folder}: {n_rgb} colour and {n_depth} depth images; the order tells what belongs together only where "
            "there are equally many [see troubleshooting: pairing]"
        )
    return np.arange(n_rgb), np.arange(n_rgb)


def last_number(path: Path) -> int | None:
    """Return the last whole number in a file's name, which counts its images in most recorders' names."""
    numbers = re.findall(r"\d+", path.stem)
    return int(numbers[-1]) if numbers else None
