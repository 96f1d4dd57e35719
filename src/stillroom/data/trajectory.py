"""Poses over time, and the TUM text format."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stillroom.data.replacing import replacing
from stillroom.data.text import read_text
from stillroom.errors import TrajectoryError
from stillroom.geometry import se3
from stillroom.geometry.arrays import F64

UP_TO_SCALE = "up to scale"
"""What a comment in a file says of a trajectory that is not metric."""


@dataclass(frozen=True)
class Trajectory:
    """M poses with strictly increasing times.

    Attributes:
        timestamps_s: Times (M,) float64 [s].
        T_world_cam: Poses (M, 4, 4) float64; a point of the camera frame goes to the world.
        is_metric: Whether lengths are metres. Those of a monocular run are known up to scale: what stands in metres
            here is in a unit of its map.
    """

    timestamps_s: F64
    T_world_cam: F64
    is_metric: bool = True

    def __len__(self) -> int:
        """Number of poses."""
        return len(self.timestamps_s)

    @property
    def positions_m(self) -> F64:
        """Camera centres (M, 3) [m]."""
        return self.T_world_cam[:, :3, 3]

    def scaled(self, scale: float) -> "Trajectory":
        """Return it with positions multiplied by the scale that makes it metric."""
        T_world_cam = self.T_world_cam.copy()
        T_world_cam[:, :3, 3] *= scale
        return Trajectory(self.timestamps_s, T_world_cam)

    def write_tum(self, path: Path | str) -> None:
        """Write `timestamp tx ty tz qx qy qz qw`, one pose a line; a file that is there is replaced as a whole.

        A comment says where it is up to scale; `read_tum` understands it, and other tools skip it.

        Raises:
            StillroomError: It cannot be written.
        """
        quaternions_xyzw = se3.to_quaternions_xyzw(self.T_world_cam) if len(self) else np.zeros((0, 4))
        lines = [] if self.is_metric else [f"# {UP_TO_SCALE}: positions are in a unit of the map, not in metres"]
        lines.append("# timestamp tx ty tz qx qy qz qw")
        for stamp, position, quaternion in zip(self.timestamps_s, self.positions_m, quaternions_xyzw, strict=True):
            numbers = " ".join(f"{value:.7f}" for value in (*position, *quaternion))
            lines.append(f"{stamp:.6f} {numbers}")
        with replacing(Path(path)) as file:
            file.write(("\n".join(lines) + "\n").encode("utf-8"))


def read_tum(path: Path) -> Trajectory:
    """Read a trajectory in the TUM format; it is metric unless a comment at its start says that it is up to scale.

    Raises:
        TrajectoryError: The file is missing, empty or not text; a line has other than eight numbers, a number
            that is not finite, or a quaternion whose length is not 1 within 1 %; times repeat or go back.
    """
    text = _text_of(path)
    rows = _read_rows(path, text)
    if not rows:
        raise TrajectoryError(f"{path}: no poses in it; expected lines 'timestamp tx ty tz qx qy qz qw'")
    numbers = np.array([values for _, values in rows])
    lengths = np.linalg.norm(numbers[:, 4:], axis=1)
    for (line, values), length in zip(rows, lengths, strict=True):
        if not np.all(np.isfinite(values)):
            raise TrajectoryError(f"{path}:{line}: a number is not finite; remove or correct this pose")
        if abs(length - 1.0) > 0.01:
            raise TrajectoryError(f"{path}:{line}: the quaternion has length {length:.3f}; it must be 1")
    steps = np.diff(numbers[:, 0])
    if np.any(steps <= 0):
        bad = int(np.argmax(steps <= 0)) + 1
        word = "repeats" if steps[bad - 1] == 0 else "goes back"
        raise TrajectoryError(f"{path}:{rows[bad][0]}: the timestamp {word}; times must increase")
    is_metric = not text.startswith(f"# {UP_TO_SCALE}")
    return Trajectory(numbers[:, 0], se3.from_quaternions_xyzw(numbers[:, 4:], numbers[:, 1:4]), is_metric)


def _text_of(path: Path) -> str:
    try:
        return read_text(path)
    except FileNotFoundError:
        raise TrajectoryError(f"{path}: no such file; expected a trajectory in the TUM format") from None
    except (OSError, UnicodeError) as error:
        raise TrajectoryError(f"{path}: cannot be read as text ({error}) [see troubleshooting: text-files]") from error


def _read_rows(path: Path, text: str) -> list[tuple[int, list[float]]]:
    rows: list[tuple[int, list[float]]] = []
    for line_number, line in enumerate(text.splitlines(), start=1):
        words = line.replace(",", " ").split()
        if not words or words[0].startswith("#") or (not rows and is_header(words)):
            continue
        try:
            values = [float(word) for word in words]
        except ValueError:
            raise TrajectoryError(f"{path}:{line_number}: not a number in '{line.strip()[:60]}'") from None
        if len(values) != 8:
            raise TrajectoryError(f"{path}:{line_number}: {len(values)} numbers; a pose has 8")
        rows.append((line_number, values))
    return rows


def is_header(words: Sequence[str]) -> bool:
    """Return whether the words of a line name columns: none of them is a number, nor the path of a file."""
    return not any(_is_number(word) or "." in word for word in words)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
