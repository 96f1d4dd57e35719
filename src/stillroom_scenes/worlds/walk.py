"""Where the camera is that walks a closed way round a building, again and again, at one pace."""

import numpy as np

from stillroom.geometry.arrays import F64
from stillroom_scenes.camera_path import HOME_M, LOOK_DOWN_RAD, Hand, Wander, looking

STEP_M = 0.02
ROUNDED_M = 0.35  # corners of the way are smoothed so far (standard deviation)
TURNING_M = 0.7  # and the direction of view so far beyond: one looks ahead before one goes there
HAND_PERIOD_S = 3600.0


class Walk:
    """A walk along a closed, rounded line, looking ahead; exact at any time."""

    def __init__(self, corners_m: F64, pace_m_s: float, wander: Wander, seed: int, start_m: float = 0.0) -> None:
        """Fix the way.

        Args:
            corners_m: Of the line (N, 2); closed from the last to the first.
            pace_m_s: Speed along the rounded line.
            wander: How the hand strays from it.
            seed: Chooses the swings' phases.
            start_m: Where on the line the walk begins.
        """
        from scipy.ndimage import gaussian_filter1d

        line_m = _resampled(corners_m)
        for axis in (0, 1):
            line_m[:, axis] = gaussian_filter1d(line_m[:, axis], ROUNDED_M / STEP_M, mode="wrap")
        line_m = _resampled(line_m)
        ahead = np.roll(line_m, -1, axis=0) - np.roll(line_m, 1, axis=0)
        heading = np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0]))
        last = np.arctan2(ahead[0, 1], ahead[0, 0]) - heading[-1]
        turned = heading[-1] + (last + np.pi) % (2 * np.pi) - np.pi - heading[0]
        self._turned_rad = 2 * np.pi * np.round(turned / (2 * np.pi))  # in a whole round
        share = np.arange(len(line_m)) / len(line_m)
        level = gaussian_filter1d(heading - self._turned_rad * share, TURNING_M / STEP_M, mode="wrap")
        self._heading = level + self._turned_rad * share
        self._line_m, self.length_m = line_m, float(len(line_m) * _spacing_m(line_m))
        self._pace_m_s, self._start_m = pace_m_s, start_m
        self._hand = Hand(wander, np.random.default_rng([seed, 53]), HAND_PERIOD_S)

    def poses(self, times_s: F64) -> F64:
        """Return `T_world_cam` (N, 4, 4) at times (N,) [s]."""
        rounds, share = np.divmod((self._start_m + self._pace_m_s * times_s) / self.length_m, 1.0)
        at = share * len(self._line_m)
        before = np.minimum(at.astype(np.int64), len(self._line_m) - 1)
        after, part = (before + 1) % len(self._line_m), at - before
        strayed = self._hand.strayed(times_s)
        floor_m = (1 - part[:, None]) * self._line_m[before] + part[:, None] * self._line_m[after]
        next_heading = self._heading[after] + self._turned_rad * (after == 0)
        heading = (1 - part) * self._heading[before] + part * next_heading + rounds * self._turned_rad
        position_m = np.column_stack((floor_m, np.full(len(times_s), HOME_M[2]))) + strayed[:3].T
        return looking(position_m, heading - np.pi / 2 + strayed[3], LOOK_DOWN_RAD + strayed[4], strayed[5])


def _resampled(line_m: F64) -> F64:
    """Return points at equal distances of about `STEP_M` along a closed line (N, 2)."""
    closed = np.concatenate((line_m, line_m[:1]))
    along_m = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))))
    wanted_m = np.linspace(0.0, along_m[-1], max(8, round(along_m[-1] / STEP_M)), endpoint=False)
    return np.stack([np.interp(wanted_m, along_m, closed[:, axis]) for axis in (0, 1)], axis=1)


def _spacing_m(line_m: F64) -> float:
    return float(np.linalg.norm(np.diff(line_m, axis=0), axis=1).mean())
