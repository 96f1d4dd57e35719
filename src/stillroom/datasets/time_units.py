"""In which unit a list's times are, told from their digits and their steps, and times in seconds."""

from collections.abc import Sequence
from decimal import Decimal
from pathlib import Path

import numpy as np

from stillroom.data.trajectory import Trajectory
from stillroom.errors import DatasetError
from stillroom.geometry.arrays import F64

POWERS = {"s": 0, "ms": 3, "us": 6, "ns": 9}
"""The units that times may be in, and how many places of the decimal point each lies below the second."""
NAMES = {"s": "seconds", "ms": "milliseconds", "us": "microseconds", "ns": "nanoseconds"}
EPOCH_DIGITS = {"ms": 13, "us": 16, "ns": 19}
"""How many digits whole times since 1970 have from 2001 to 2286."""
COUNTER = "counter"
"""In place of a unit: the numbers count images, or may do so, and are no times in any unit."""

EPOCH_S = (1e8, 1e10)
"""Times since 1970, as most recorders write them, lie between these [s]: from 1973 to 2286."""
SHORTEST_STEP_S, LONGEST_STEP_S = 1e-3, 3600.0
"""No RGB-D camera is faster, and no sequence for tracking slower."""
FIRST_STEP_OF_NEXT_UNIT_S = 3.0
LARGEST_COUNTED_STEP, LARGEST_STRIDE = 8.0, 30.0
WHOLLY_ELSEWHERE = 0.01


def unit_of(numbers: F64) -> str | None:
    """Return the unit of times (N,) in an unknown one: a key of `POWERS`, `COUNTER`, or None where nothing fits.

    Both the size and the steps have a say: 1548339819874260000 is a time of our days in nanoseconds only, and steps of
    33,000,000 are those of a camera in nanoseconds only.
    """
    numbers = numbers[np.isfinite(numbers)]
    steps = np.diff(numbers)
    steps = steps[steps > 0]
    size = float(np.median(np.abs(numbers))) if len(numbers) else 0.0
    by_digits = next((u for u, p in POWERS.items() if EPOCH_S[0] <= size * 10.0**-p < EPOCH_S[1]), None)
    if len(steps) == 0:
        return by_digits or ("s" if size < EPOCH_S[0] else None)
    step = float(np.median(steps))
    if by_digits is not None and SHORTEST_STEP_S <= step * 10.0 ** -POWERS[by_digits] <= LONGEST_STEP_S:
        return by_digits
    are_whole = bool(np.all(numbers == np.floor(numbers)))
    if are_whole and size < EPOCH_S[0] and (step < LARGEST_COUNTED_STEP or _is_stride(steps, step)):
        return COUNTER
    by_steps = next(
        (u for u, p in POWERS.items() if SHORTEST_STEP_S <= step < FIRST_STEP_OF_NEXT_UNIT_S * 10.0**p), None
    )
    return by_steps if by_steps and size * 10.0 ** -POWERS[by_steps] < EPOCH_S[1] else None


def _is_stride(steps: F64, step: float) -> bool:
    """Return whether whole steps look like those of a counter of every tenth image, say."""
    return step <= LARGEST_STRIDE and bool(np.all(np.mod(steps, step) == 0))


def required_unit(source: Path, words: Sequence[str], asked: str | None = None) -> str:
    """Return the unit of a list's times as written, the one asked for where it is.

    Raises:
        DatasetError: It cannot be told, or the numbers only count images.
    """
    if asked is not None:
        return asked
    numbers = np.array([float(word) for word in words])
    unit = unit_of(numbers)
    if unit == COUNTER:
        some = ", ".join(words[:3])
        raise DatasetError(
            f"{source}: {some} … may count images and are no times that can be told; give the frame rate (--fps), or "
            "--time-unit s|ms|us|ns if they are times [see troubleshooting: time-unit]"
        )
    if unit is None:
        raise DatasetError(
            f"{source}: times like {words[0]} in steps of {_median_step(numbers):g} are those of a camera in no unit; "
            "give --time-unit s|ms|us|ns, or the frame rate (--fps) [see troubleshooting: time-unit]"
        )
    return unit


def _median_step(numbers: F64) -> float:
    return float(np.median(np.diff(numbers))) if len(numbers) > 1 else 0.0


def in_seconds(word: str, unit: str) -> float:
    """Return a time as written in seconds [s], rounded once: whole nanoseconds give what decimal seconds give.

    Raises:
        ValueError: It is no number.
    """
    number = float(word)
    if POWERS[unit] == 0 or not np.isfinite(number):
        return number
    try:
        return float(Decimal(word).scaleb(-POWERS[unit]))
    except ArithmeticError:  # an exponent beyond all bounds
        return number * 10.0 ** -POWERS[unit]


def groundtruth_in_seconds(groundtruth: Trajectory, times_s: F64) -> tuple[Trajectory, str]:
    """Return ground truth with times in seconds, and the unit that they were in.

    The unit is the one in which its stretch of time is that of the images; seconds where none is.

    Args:
        groundtruth: Poses with times as written.
        times_s: Times of the images (N,) [s].
    """
    shared = {unit: _shared(groundtruth.timestamps_s * 10.0**-power, times_s) for unit, power in POWERS.items()}
    unit = max(shared, key=lambda name: shared[name])
    if shared["s"] > WHOLLY_ELSEWHERE or shared[unit] <= WHOLLY_ELSEWHERE:
        return groundtruth, "s"
    return Trajectory(groundtruth.timestamps_s / 10.0 ** POWERS[unit], groundtruth.T_world_cam), unit


def _shared(first_s: F64, second_s: F64) -> float:
    """Return the share, 0 to 1, of two stretches of time that lies in both."""
    start, end = max(first_s.min(), second_s.min()), min(first_s.max(), second_s.max())
    whole = max(first_s.max(), second_s.max()) - min(first_s.min(), second_s.min())
    return float(max(0.0, end - start) / whole) if whole > 0 else 1.0
