"""Earlier depth images: was a surface at the same place before?"""

from collections import deque
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from stillroom.bounds import bounded
from stillroom.compiled import njit
from stillroom.data.frame import Frame
from stillroom.geometry import se3
from stillroom.geometry.arrays import F32, F64, I64
from stillroom.geometry.camera import Camera, Lens
from stillroom.geometry.distortion import seen_at

STRIDE = 4
"""Stride of the stored depth images [px]."""


@dataclass(frozen=True)
class DepthHistoryConfig:
    """Ages and tolerances of the comparison with earlier depth images.

    Attributes:
        interval_s: Time between stored images.
        ages_s: Ages of the images that are compared, the nearest stored ones; the oldest bounds how long something must
            stand still to be classified as static.
        tolerance_m, tolerance_share: Two depths agree when they differ by less than the larger of the first and this
            share of the depth: Kinect noise, and the pose's.
    """

    interval_s: float = bounded(0.25, above=0)
    ages_s: tuple[float, ...] = bounded((0.3, 0.6, 1.2, 2.4, 4.8, 9.6), above=0)
    tolerance_m: float = bounded(0.08, least=0)
    tolerance_share: float = bounded(0.04, least=0)


@dataclass(frozen=True)
class Evidence:
    """Evidence of earlier depth images on N points.

    Attributes:
        agrees: In how many of them a surface lay where the point is now (N,).
        empty: In how many the ray passed through that place to something behind it (N,): the point moved there since.
    """

    agrees: I64
    empty: I64


@dataclass(frozen=True)
class _Remembered:
    timestamp_s: float
    T_cam_world: F64
    depth_m: F32 = field(repr=False)


class DepthHistory:
    """A few seconds of subsampled depth images with their poses."""

    def __init__(self, config: DepthHistoryConfig) -> None:
        """Start without images."""
        self.config = config
        length = int(np.ceil(max(config.ages_s) / config.interval_s)) + 2
        self._images: deque[_Remembered] = deque(maxlen=length)
        self._asked: list[tuple[_Remembered, DepthRange]] = []
        self._asked_at_s: float | None = None

    def remember(self, frame: Frame, T_cam_world: F64) -> None:
        """Store the frame's depth image, if the last stored one is old enough."""
        stamp = frame.timestamp_s
        if self._images and stamp - self._images[-1].timestamp_s < self.config.interval_s:
            return
        stride = frame.camera.in_pixels(STRIDE)
        small = frame.image.depth_m[::stride, ::stride].copy()
        self._images.append(_Remembered(stamp, T_cam_world.copy(), small))
        self._asked_at_s = None

    def follow(self, T_new_old: F64) -> None:
        """Move the stored poses by a motion (4, 4) of the world's coordinates."""
        T_old_new = se3.inverse(T_new_old)
        moved = [replace(image, T_cam_world=image.T_cam_world @ T_old_new) for image in self._images]
        self._images = deque(moved, maxlen=self._images.maxlen)
        self._asked_at_s = None

    def evidence(self, camera: Camera, points_world_m: F64, now_s: float) -> Evidence:
        """Compare points (N, 3) [m, world] with earlier images."""
        agrees = np.zeros(len(points_world_m), dtype=np.int64)
        empty = np.zeros(len(points_world_m), dtype=np.int64)
        tolerances, stride = (self.config.tolerance_m, self.config.tolerance_share), camera.in_pixels(STRIDE)
        for image, around in self._nearest(now_s):
            view = SmallView(image.depth_m, image.T_cam_world, camera.lens, stride)
            ask_ranges(view, around, points_world_m, *tolerances, agrees, empty)
        return Evidence(agrees, empty)

    def _nearest(self, now_s: float) -> list[tuple[_Remembered, "DepthRange"]]:
        """Return the stored images nearest to the configured ages, each once, with the ranges around their pixels."""
        if not self._images or now_s == self._asked_at_s:
            return self._asked
        ages_s = now_s - np.array([image.timestamp_s for image in self._images])
        wanted = {int(np.argmin(np.abs(ages_s - age))) for age in self.config.ages_s}
        chosen = [self._images[i] for i in sorted(wanted) if ages_s[i] >= self.config.interval_s / 2]
        # Only those that are asked have ranges, so that memory does not grow; most were asked about the image before.
        known = {id(image): around for image, around in self._asked}
        self._asked = [(image, known.get(id(image)) or depth_ranges(image.depth_m)) for image in chosen]
        self._asked_at_s = now_s
        return self._asked


class SmallView(NamedTuple):
    """A small depth image.

    Attributes:
        depth_m: Every `stride`-th pixel of an image as taken (h, w) [m]; 0 where unknown.
        T_cam_world: Its pose (4, 4).
        lens: Of the whole image.
        stride: Of the small one [px].
    """

    depth_m: F32
    T_cam_world: F64
    lens: Lens
    stride: int = STRIDE


class DepthRange(NamedTuple):
    """The known depths of each pixel of a small depth image and its eight neighbours.

    Attributes:
        nearest: The smallest (h, w) [m]; infinite where none is known, −infinite where one is not a number.
        farthest: The largest (h, w) [m]; −infinite where none is known. Neither is set on the border.
    """

    nearest: F32
    farthest: F32


@njit(nogil=True, cache=True)
def depth_ranges(depth_m: F32) -> DepthRange:
    """Return the ranges around the pixels of a small depth image (h, w) [m]."""
    nearest, farthest = np.empty_like(depth_m), np.empty_like(depth_m)
    for row in range(1, depth_m.shape[0] - 1):
        for column in range(1, depth_m.shape[1] - 1):
            low, high = np.float32(np.inf), np.float32(-np.inf)
            for dy in range(-1, 2):
                for dx in range(-1, 2):
                    seen = depth_m[row + dy, column + dx]
                    if seen > 0.0:
                        low, high = min(low, seen), max(high, seen)
                    elif np.isnan(seen):
                        low = np.float32(-np.inf)
            nearest[row, column], farthest[row, column] = low, high
    return DepthRange(nearest, farthest)


@njit(nogil=True, cache=True, error_model="numpy")
def ask(
    view: SmallView, points_world_m: F64, tolerance_m: float, tolerance_share: float, agrees: I64, empty: I64
) -> None:
    """Add the evidence of one small depth image on points (N, 3) to `agrees` and `empty` (N,).

    The pixel and its eight neighbours are compared: one that agrees is enough; for `empty` all known ones must lie
    behind.

    Args:
        view: The image.
        points_world_m: The points.
        tolerance_m, tolerance_share: See `DepthHistoryConfig`.
        agrees, empty: Counters.
    """
    depth_m, T, lens, stride = view
    last_row, last_column = depth_m.shape[0] - 1, depth_m.shape[1] - 1
    for i in range(len(points_world_m)):
        u, v, z = seen_at(T, lens, points_world_m[i, 0], points_world_m[i, 1], points_world_m[i, 2])
        if not (z > 0.1 and u >= stride and v >= stride and u < stride * 10000 and v < stride * 10000):
            continue
        column, row = int(u / stride + 0.5), int(v / stride + 0.5)
        if row >= last_row or column >= last_column:
            continue
        there, behind = compare(depth_m, row, column, z, max(tolerance_m, tolerance_share * z))
        agrees[i] += there
        empty[i] += behind


# In line, for a call that passes arrays counts references, which takes longer than the work.
@njit(nogil=True, cache=True, inline="always")
def compare(depth_m: F32, row: int, column: int, z: float, tolerance: float) -> tuple[bool, bool]:
    """Return whether a pixel or a neighbour has a depth within a tolerance of z [m], and whether all lie behind."""
    n_known, n_there, n_behind = 0, 0, 0
    for dy in range(-1, 2):
        for dx in range(-1, 2):
            seen = depth_m[row + dy, column + dx]
            known = not seen <= 0.0
            n_known += known
            n_there += known & (abs(seen - z) <= tolerance)
            n_behind += known & (seen > z + tolerance)
    return n_there > 0, n_known > 0 and n_behind == n_known


@njit(nogil=True, cache=True, error_model="numpy")
def ask_ranges(
    view: SmallView,
    around: DepthRange,
    points_world_m: F64,
    tolerance_m: float,
    tolerance_share: float,
    agrees: I64,
    empty: I64,
) -> None:
    """Do what `ask` does, by the ranges around the view's pixels; neighbours are read only where z is in between."""
    depth_m, T, lens, stride = view
    nearest, farthest = around
    last_row, last_column = depth_m.shape[0] - 1, depth_m.shape[1] - 1
    for i in range(len(points_world_m)):
        u, v, z = seen_at(T, lens, points_world_m[i, 0], points_world_m[i, 1], points_world_m[i, 2])
        if not (z > 0.1 and u >= stride and v >= stride and u < stride * 10000 and v < stride * 10000):
            continue
        column, row = int(u / stride + 0.5), int(v / stride + 0.5)
        if row >= last_row or column >= last_column:
            continue
        tolerance = max(tolerance_m, tolerance_share * z)
        low, high = nearest[row, column], farthest[row, column]
        there = abs(low - z) <= tolerance or abs(high - z) <= tolerance
        if not there and low < z < high:
            there, _ = compare(depth_m, row, column, z, tolerance)
        agrees[i] += there
        empty[i] += low > z + tolerance and high > 0.0
