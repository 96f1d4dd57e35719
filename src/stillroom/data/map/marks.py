"""Sets of points without a pass over the whole map: what was met is marked with a number that is new each time."""

import threading

import numpy as np
from numba import njit

from stillroom.geometry.arrays import I32, I64


class Marks(threading.local):
    """Marks of the calling thread, so that tracking and mapping may ask at the same time.

    Clearing a flag for every point would cost more with every keyframe; a mark of yesterday is simply another number.
    """

    def __init__(self) -> None:
        """Start without marks."""
        self._marks: I64 = np.zeros(0, dtype=np.int64)
        self._number = 0

    def fresh(self, n_points: int) -> tuple[I64, int]:
        """Return marks of at least so many points, and a number that none of them has."""
        if len(self._marks) < n_points:
            self._marks = np.zeros(2 * n_points, dtype=np.int64)
        self._number += 1
        return self._marks, self._number


@njit(nogil=True, cache=True)
def collect(keyframes: I64, first_row: I64, n_rows: I64, row_point: I32, marks: I64, number: int, found: I32) -> int:
    """Write each point that any of the keyframes sees into `found` once, in the order met; return how many."""
    n = 0
    for i in range(len(keyframes)):
        start = first_row[keyframes[i]]
        for row in range(start, start + n_rows[keyframes[i]]):
            point = row_point[row]
            if point >= 0 and marks[point] != number:
                marks[point] = number
                found[n] = point
                n += 1
    return n


@njit(nogil=True, cache=True)
def keep_others(point_ids: I32, excluded: I32, marks: I64, number: int, kept: I32) -> int:
    """Write the points that are not excluded (−1 is skipped) into `kept`, in order; return how many."""
    for i in range(len(excluded)):
        if excluded[i] >= 0:
            marks[excluded[i]] = number
    n = 0
    for i in range(len(point_ids)):
        if marks[point_ids[i]] != number:
            kept[n] = point_ids[i]
            n += 1
    return n
