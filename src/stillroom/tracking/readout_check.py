"""Whether the rows of a recording were read when its camera file says: judged while tracking, from what rows say.

A frame whose keypoints were moved to mid-frame in the wrong way leaves a twist from row to row in their residuals. That
twist, and the one they were moved with, are the readout times the camera's velocity, which the poses of the frames
before and after it tell (`optimize/readout.py`, which also says why a block of frames has a shear of its own). Each
frame costs one linearisation at its pose.
"""

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from stillroom.geometry import se3, twists
from stillroom.geometry.arrays import F64
from stillroom.optimize.readout import BLOCK_FRAMES, add_equations, of_one_shear

LONGEST_GAP_S = 0.1
"""Between frames that follow each other: over a longer one the motion is not known."""
LEAST_FRAMES = 5
LEAST_FRAMES_SAID = 30
"""Frames without which nothing is said of a readout that is merely another one."""
NOISE = 2.0
"""By what the noise of a block is more than that of its keypoints: the map and the poses have some, too."""
MODEL_S = 0.003
"""Deviation of a block, however many keypoints it has: estimates of one camera differ by as much."""
CERTAIN = 4.0
"""In deviations."""
NONE_OF_IT = 1.0 / 3.0
"""A readout below this share of the one in the camera file is nearer to none, by a margin."""
SETTLED_STRIDE = 2
"""Of the frames whose equations are asked for once rows speak for the camera file."""
STRONGLY = 0.25
"""By which share of that one another is worth a warning."""


class Rows(NamedTuple):
    """A frame's equations at the pose that was found for it.

    Attributes:
        time_s: Its time.
        T_world_cam: Its pose (4, 4).
        n_jumps: How often the map has jumped.
        submap: The sub-map that the pose is in: those of another have another origin, and maybe another unit.
        H, b: Normal equations of pose and twist (12, 12), (12,); empty where they were not asked for.
        moved_with: The twist (6,) by which its keypoints were moved.
    """

    time_s: float
    T_world_cam: F64
    n_jumps: int
    submap: int
    H: F64
    b: F64
    moved_with: F64


@dataclass(frozen=True)
class RowsFound:
    """What a recording says of its readout so far.

    Attributes:
        file_s: What the camera file says [s].
        readout_s, sigma_s: What the rows say, and one standard deviation of it [s].
        n_frames: Frames that it is from.
        as_one: Whether rows are read as one now.
        n_as_one: Frames whose rows were.
    """

    file_s: float
    readout_s: float
    sigma_s: float
    n_frames: int
    as_one: bool
    n_as_one: int

    @property
    def is_other(self) -> bool:
        """Whether the readout is certainly, and by much, another one than the camera file says."""
        off_s = abs(self.readout_s - self.file_s)
        enough = self.n_frames >= LEAST_FRAMES_SAID
        return enough and off_s > max(CERTAIN * self.sigma_s, STRONGLY * self.file_s)


class ReadoutCheck:
    """Collects what the rows of frames say, frame after frame, and judges the camera's readout by it."""

    def __init__(self, file_s: float) -> None:
        """Begin with what the camera file says [s], which holds until rows speak against it."""
        self._file_s = file_s
        self._last: deque[Rows] = deque(maxlen=3)
        self._information, self._slope = np.zeros((7, 7)), np.zeros(7)  # of the block that is not whole yet
        self._n_in_block, self._n_frames, self._n_as_one, self._n_added = 0, 0, 0, 0
        self._sums = np.zeros(4)  # of whole blocks: how many, and Σ w, Σ w ρ, Σ w ρ²
        self._found: tuple[float, float] | None = None
        self.as_one = False

    @property
    def is_settled(self) -> bool:
        """Whether rows speak for the readout in the camera file, and certainly against none."""
        return self._found is not None and not self.as_one and self._found[0] > CERTAIN * self._found[1]

    @property
    def asks_next(self) -> bool:
        """Whether the next frame's equations are asked for: of every second frame once rows speak for the file."""
        return not self.is_settled or self._n_added % SETTLED_STRIDE == 0

    @property
    def found(self) -> RowsFound | None:
        """What was found so far; None before the camera has moved."""
        if self._found is None:
            return None
        return RowsFound(self._file_s, *self._found, self._n_frames, self.as_one, self._n_as_one)

    def add(self, rows: Rows) -> bool:
        """Take the next frame, or the last one found again; return whether the verdict, `as_one`, has changed."""
        if self._last and rows.time_s <= self._last[-1].time_s:
            self._last[-1] = rows
            return False
        self._n_as_one += self.as_one
        self._n_added += 1
        self._last.append(rows)
        velocity, middle = _velocity(self._last), self._last[len(self._last) // 2]
        if velocity is None or len(middle.b) == 0:
            return False
        add_equations(middle.H, middle.b, middle.moved_with, velocity, self._information, self._slope)
        self._n_in_block, self._n_frames = self._n_in_block + 1, self._n_frames + 1
        readout_s, information = of_one_shear(self._information, self._slope)
        weight = 1.0 / (NOISE**2 / information + MODEL_S**2)
        sums: F64 = self._sums + np.array((1.0, weight, weight * readout_s, weight * readout_s**2))
        if self._n_in_block == BLOCK_FRAMES:
            self._sums, self._n_in_block = sums, 0
            self._information, self._slope = np.zeros((7, 7)), np.zeros(7)
        n, total, mean_s = sums[0], sums[1], sums[2] / sums[1]
        scatter = (sums[3] - total * mean_s**2) / (n - 1.0) if n > 1.0 else 1.0
        self._found = float(mean_s), float(np.sqrt(max(scatter, 1.0) / total))
        return self._judged()

    def _judged(self) -> bool:
        """Judge by what was found; return whether the verdict has changed."""
        assert self._found is not None
        readout_s, sigma_s = self._found
        if self._n_frames < LEAST_FRAMES:
            return False
        if self.as_one:
            changed = readout_s > CERTAIN * sigma_s and readout_s > 0.5 * self._file_s
        else:
            changed = self._file_s - readout_s > CERTAIN * sigma_s and readout_s < NONE_OF_IT * self._file_s
        self.as_one ^= changed
        return changed


def _velocity(frames: deque[Rows]) -> F64 | None:
    """Return the velocity (6,) [m/s, rad/s] at the middle one of three frames; None where it is not known."""
    if len(frames) < 3:
        return None
    before, middle, after = frames
    steps_s = middle.time_s - before.time_s, after.time_s - middle.time_s
    if max(steps_s) > LONGEST_GAP_S or before.n_jumps != after.n_jumps:
        return None
    if not before.submap == middle.submap == after.submap:
        return None
    moved = se3.inverse(after.T_world_cam) @ before.T_world_cam
    velocity: F64 = twists.of_motion(moved) / (after.time_s - before.time_s)
    return velocity
