"""Where the camera is at any time: hand-held paths that end where they started."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from stillroom.geometry.arrays import F64

HOME_M = np.array([0.0, -1.5, 1.42])
LOOK_DOWN_RAD = -0.06
LAP_S = 24.0
LOOP_RADII_M = (1.95, 1.6)

# Amplitude [m] or [rad] and frequency [Hz] of the swings of one coordinate.
Swings = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Wander:
    """Amplitudes and frequencies of hand shake: swings of x, y, z [m] and of yaw, pitch, roll [rad]."""

    x: Swings = ()
    y: Swings = ()
    z: Swings = ()
    yaw: Swings = ()
    pitch: Swings = ()
    roll: Swings = ()


TREMOR = Wander(
    x=((0.0006, 2.7), (0.0003, 5.1)),
    y=((0.0005, 2.3), (0.0003, 4.7)),
    z=((0.0008, 2.9), (0.0003, 5.6)),
    yaw=((0.0008, 2.1), (0.0005, 4.3)),
    pitch=((0.0009, 2.6), (0.0005, 5.3)),
    roll=((0.0008, 2.4), (0.0004, 4.9)),
)
SWAY = Wander(
    x=((0.21, 0.13), (0.05, 0.31)),
    y=((0.13, 0.17), (0.03, 0.37)),
    z=((0.06, 0.21), (0.02, 0.43)),
    yaw=((0.08, 0.15), (0.02, 0.41)),
    pitch=((0.04, 0.19), (0.015, 0.47)),
    roll=((0.025, 0.23), (0.01, 0.39)),
)
TURNS = Wander(
    x=((0.02, 0.2),),
    y=((0.02, 0.25),),
    z=((0.015, 0.3),),
    yaw=((0.22, 0.17), (0.04, 0.4)),
    pitch=((0.12, 0.23), (0.03, 0.5)),
    roll=((0.16, 0.29), (0.03, 0.55)),
)
WALK = Wander(
    x=((0.015, 0.9),),
    y=((0.015, 0.7),),
    z=((0.02, 1.1), (0.03, 0.2)),
    yaw=((0.12, 0.16), (0.02, 0.6)),
    pitch=((0.03, 0.3),),
    roll=((0.02, 0.35),),
)
COORDINATES = ("x", "y", "z", "yaw", "pitch", "roll")


class Hand:
    """Hand shake: periodic sums of sinusoids, exact at any time."""

    def __init__(self, wander: Wander, rng: np.random.Generator, period_s: float) -> None:
        """Sample the frequencies and phases; each frequency fits the period a whole number of times."""
        rows = []
        for row, name in enumerate(COORDINATES):
            for amplitude, frequency_hz in (*getattr(wander, name), *getattr(TREMOR, name)):
                rounds = max(1, round(frequency_hz * period_s * rng.uniform(0.9, 1.1)))
                rows.append((row, amplitude, 2 * np.pi * rounds / period_s, rng.uniform(0, 2 * np.pi)))
        self._swings = np.array(rows)

    def strayed(self, times_s: F64) -> F64:
        """Return the offsets of x, y, z [m] and yaw, pitch, roll [rad] (6, N) at times (N,) [s]."""
        row, amplitude, speed, phase = self._swings.T[..., None]
        swings = amplitude * np.sin(speed * times_s + phase)
        strayed = np.zeros((len(COORDINATES), len(times_s)))
        np.add.at(strayed, row[:, 0].astype(np.int64), swings)
        return strayed


class CameraPath:
    """A path of one of the kinds of `PATHS`; exact at any time, for any number of frames."""

    def __init__(self, kind: str, seed: int, duration_s: float) -> None:
        """Fix the path.

        Args:
            kind: One of `PATHS`.
            seed: Chooses the swings' phases.
            duration_s: When the path is back where it started.
        """
        wander, self._course = PATHS[kind]
        self._duration_s = duration_s
        self._hand = Hand(wander, np.random.default_rng([seed, 53]), duration_s)

    def poses(self, times_s: F64) -> F64:
        """Return `T_world_cam` (N, 4, 4) at times (N,) [s]."""
        return looking(*self._course(times_s, self._duration_s, self._hand.strayed(times_s)))


Course = tuple[F64, F64, F64, F64]


def _at_home(strayed: F64) -> Course:
    return HOME_M + strayed[:3].T, strayed[3], LOOK_DOWN_RAD + strayed[4], strayed[5]


def _still(times_s: F64, duration_s: float, strayed: F64) -> Course:
    """Never move."""
    return _at_home(np.zeros((6, len(times_s))))


def _ahead(times_s: F64, duration_s: float, strayed: F64) -> Course:
    """Stay about home, looking across the room."""
    return _at_home(strayed)


def _halfsphere(times_s: F64, duration_s: float, strayed: F64) -> Course:
    """Move on a half sphere of 0.9 m across, looking at its middle beyond."""
    rounds = max(1, round(duration_s / 9.0))
    turn = 2 * np.pi * rounds * times_s / duration_s
    polar = 0.75 * np.sin(np.pi * times_s / duration_s) ** 2 + 0.25
    target_m = np.array([0.0, 0.9, 1.25])
    offset_m = np.stack(
        (0.45 * np.sin(polar) * np.cos(turn), 0.2 - 0.3 * np.cos(polar), 0.3 * np.sin(polar) * np.sin(turn)), axis=1
    )
    position_m = HOME_M + offset_m + strayed[:3].T
    towards = target_m - position_m
    yaw = np.arctan2(-towards[:, 0], towards[:, 1])
    pitch = np.arctan2(towards[:, 2], np.hypot(towards[:, 0], towards[:, 1]))
    return position_m, yaw + strayed[3], pitch + strayed[4], strayed[5] + 0.08 * np.sin(turn)


def _loop(times_s: F64, duration_s: float, strayed: F64) -> Course:
    """Walk round the room, looking across it, and come back."""
    laps = max(1, round(duration_s / LAP_S))
    turn = 2 * np.pi * laps * times_s / duration_s
    position_m = np.stack((LOOP_RADII_M[0] * np.sin(turn), -LOOP_RADII_M[1] * np.cos(turn), 0 * turn), axis=1)
    position_m += np.array([0, 0, HOME_M[2]]) + strayed[:3].T
    return position_m, turn + strayed[3], LOOK_DOWN_RAD - 0.04 + strayed[4], strayed[5]


PATHS: dict[str, tuple[Wander, Callable[[F64, float, F64], Course]]] = {
    "still": (Wander(), _still),
    "sway": (SWAY, _ahead),
    "rpy": (TURNS, _ahead),
    "halfsphere": (Wander(), _halfsphere),
    "loop": (WALK, _loop),
}


def looking(position_m: F64, yaw_rad: F64, pitch_rad: F64, roll_rad: F64) -> F64:
    """Return poses of cameras at positions (N, 3) that look along +y, turned left, up and about their axis."""
    cy, sy, cp, sp = np.cos(yaw_rad), np.sin(yaw_rad), np.cos(pitch_rad), np.sin(pitch_rad)
    zero = np.zeros_like(cy)
    forward = np.stack((-sy * cp, cy * cp, sp + zero), axis=1)
    right = np.stack((cy, sy, zero), axis=1)
    down = np.cross(forward, right)
    c, s = np.cos(roll_rad)[:, None], np.sin(roll_rad)[:, None]
    T_world_cam = np.zeros((len(position_m), 4, 4))
    T_world_cam[:, :3, 0] = c * right + s * down
    T_world_cam[:, :3, 1] = c * down - s * right
    T_world_cam[:, :3, 2] = forward
    T_world_cam[:, :3, 3] = position_m
    T_world_cam[:, 3, 3] = 1.0
    return T_world_cam
