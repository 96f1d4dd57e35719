"""What the depth camera saw before, asked whether a surface was there then too."""

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from stillroom.data.frame import Frame
from stillroom.geometry import se3
from stillroom.geometry.arrays import F32, F64, I64
from stillroom.geometry.camera import Camera

_STRIDE = 4
_NEIGHBOURS = [(dx, dy) for dy in (-1, 0, 1) for dx in (-1, 0, 1)]


@dataclass(frozen=True)
class DepthHistoryConfig:
    """How far back to look, and how exactly.

    Attributes:
        interval_s: Time between remembered images.
        ages_s: The remembered images nearest to these ages are asked; the oldest bounds how long something must stand
            still to pass for static.
        tolerance_m, tolerance_share: Two depths agree when they differ by less than the larger of the first and this
            share of the depth: Kinect noise, and the pose's.
    """

    interval_s: float = 0.25
    ages_s: tuple[float, ...] = (0.3, 0.6, 1.2, 2.4, 4.8, 9.6)
    tolerance_m: float = 0.06
    tolerance_share: float = 0.03


@dataclass(frozen=True)
class Evidence:
    """What earlier images say of N points.

    Attributes:
        agrees: In how many of them a surface lay where the point is now (N,).
        empty: In how many the ray passed through that place to something behind it (N,): it moved there since.
    """

    agrees: I64
    empty: I64


@dataclass(frozen=True)
class _Remembered:
    timestamp_s: float
    T_cam_world: F64
    depth_m: F32 = field(repr=False)


class DepthHistory:
    """A few seconds of small depth images with their poses."""

    def __init__(self, config: DepthHistoryConfig) -> None:
        """Start without a past."""
        self.config = config
        length = int(np.ceil(max(config.ages_s) / config.interval_s)) + 2
        self._images: deque[_Remembered] = deque(maxlen=length)

    def remember(self, frame: Frame, T_cam_world: F64) -> None:
        """Keep the frame's depth image, if the last one kept is old enough."""
        stamp = frame.timestamp_s
        if self._images and stamp - self._images[-1].timestamp_s < self.config.interval_s:
            return
        small = frame.image.depth_m[::_STRIDE, ::_STRIDE].copy()
        self._images.append(_Remembered(stamp, T_cam_world.copy(), small))

    def evidence(self, camera: Camera, points_world_m: F64, now_s: float) -> Evidence:
        """Ask earlier images about points (N, 3) [m, world]."""
        agrees = np.zeros(len(points_world_m), dtype=np.int64)
        empty = np.zeros(len(points_world_m), dtype=np.int64)
        for image in self._asked(now_s):
            expected_m, seen_m = self._look_up(image, camera, points_world_m)
            tolerance_m = np.maximum(self.config.tolerance_m, self.config.tolerance_share * expected_m)
            known = seen_m > 0
            there = known & (np.abs(seen_m - expected_m) <= tolerance_m)
            behind = known & (seen_m > expected_m + tolerance_m)
            agrees += there.any(axis=0)
            empty += behind.any(axis=0) & ~there.any(axis=0) & ~(known & ~behind).any(axis=0)
        return Evidence(agrees, empty)

    def _asked(self, now_s: float) -> list[_Remembered]:
        """Return the remembered images nearest to the configured ages, each once."""
        if not self._images:
            return []
        ages_s = np.array([now_s - image.timestamp_s for image in self._images])
        wanted = {int(np.argmin(np.abs(ages_s - age))) for age in self.config.ages_s}
        return [self._images[i] for i in sorted(wanted) if ages_s[i] >= self.config.interval_s / 2]

    def _look_up(self, image: _Remembered, camera: Camera, points_world_m: F64) -> tuple[F64, F64]:
        """Return expected depth (N,) and the depths seen around there (9, N); 0 where nothing is known."""
        points_cam = se3.transform(image.T_cam_world, points_world_m)
        expected_m = points_cam[:, 2].copy()
        ahead = expected_m > 0.1
        points_cam[~ahead] = (0.0, 0.0, 1.0)
        raw_px = camera.distort(camera.project(points_cam))
        column, row = np.rint(raw_px / _STRIDE).astype(np.int64).T
        height, width = image.depth_m.shape
        inside = ahead & (column >= 1) & (row >= 1) & (column < width - 1) & (row < height - 1)
        column, row = np.where(inside, column, 1), np.where(inside, row, 1)
        seen_m = np.stack([image.depth_m[row + dy, column + dx] for dx, dy in _NEIGHBOURS])
        return expected_m, np.where(inside, seen_m, 0.0).astype(np.float64)
