"""The text files of EuRoC's layout: `sensor.yaml`, and `data.csv` of cameras and of the ground truth.

`sensor.yaml` is read by its known keys alone; a reader of all YAML would be a dependency for six of them.
"""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stillroom.data.text import read_text
from stillroom.data.trajectory import Trajectory
from stillroom.datasets.time_units import in_seconds
from stillroom.errors import CalibrationError, DatasetError, TrajectoryError
from stillroom.geometry import se3
from stillroom.geometry.arrays import F64
from stillroom.geometry.camera import Camera

COMMENT = re.compile(r"#.*")
NUMBERS = re.compile(r"\[([^\]]*)\]", re.DOTALL)
WORD = re.compile(r"[\w-]+")
PINHOLE = "pinhole"
RADIAL = ("radial-tangential", "radtan", "plumb_bob")
STAMP = re.compile(r"\d{1,19}")


@dataclass(frozen=True)
class MountedCamera:
    """A camera of EuRoC's rig.

    Attributes:
        camera: Its calibration, as it takes its images.
        T_body_cam: Its pose (4, 4) on the body, which is the inertial sensor: T_BS of its file.
    """

    camera: Camera
    T_body_cam: F64


def read_sensor(path: Path) -> MountedCamera:
    """Read a camera's `sensor.yaml`.

    Raises:
        CalibrationError: The file cannot be read, a key is missing or no list of numbers, or the lens is of another
            model than a pinhole with radial-tangential distortion, such as a fisheye.
    """
    try:
        text = COMMENT.sub("", read_text(path))
    except (OSError, UnicodeError) as error:
        raise CalibrationError(f"{path}: cannot be read as text ({error}) [see troubleshooting: text-files]") from error
    for key, known in (("camera_model", (PINHOLE,)), ("distortion_model", RADIAL)):
        word = WORD.match(_after(path, text, key))
        if word is None or word[0] not in known:
            raise CalibrationError(
                f"{path}: '{key}' is '{word[0] if word else ''}'; only {known[0]} is supported, no fisheye"
            )
    pose = _numbers(path, _after(path, text, "T_BS"), "data", 16, of="T_BS: data")
    width, height = _numbers(path, text, "resolution", 2)
    fx, fy, cx, cy = _numbers(path, text, "intrinsics", 4)
    k1, k2, p1, p2 = _numbers(path, text, "distortion_coefficients", 4)
    T_body_cam = np.array(pose).reshape(4, 4)
    if np.abs(T_body_cam[:3, :3] @ T_body_cam[:3, :3].T - np.eye(3)).max() > 1e-3:
        raise CalibrationError(f"{path}: 'T_BS' is no pose: its upper left 3x3 is no rotation")
    try:
        return MountedCamera(Camera(int(width), int(height), fx, fy, cx, cy, (k1, k2, p1, p2, 0.0)), T_body_cam)
    except CalibrationError as error:
        raise CalibrationError(f"{path}: {error}") from error


def _after(path: Path, text: str, key: str) -> str:
    found = re.search(rf"^[ \t]*{key}[ \t]*:\s*", text, re.MULTILINE)
    if found is None:
        raise CalibrationError(f"{path}: '{key}' is missing; is this the sensor.yaml of a camera?")
    return text[found.end() :]


def _numbers(path: Path, text: str, key: str, n: int, of: str = "") -> list[float]:
    found = NUMBERS.match(_after(path, text, key))
    words = found[1].replace(",", " ").split() if found is not None else []
    try:
        values = [float(word) for word in words]
    except ValueError:
        values = []
    if len(values) != n or not np.all(np.isfinite(values)):
        raise CalibrationError(f"{path}: '{of or key}' must be a list of {n} numbers, like [1.0, …]")
    return values


def read_stamps(path: Path) -> dict[int, Path]:
    """Read a camera's `data.csv`: its images by their times [ns], in order of time.

    Stamps stay whole numbers: as float64 they would come in steps of 256 ns.

    Raises:
        DatasetError: The file is missing, empty or malformed, or times do not increase.
    """
    images: dict[int, Path] = {}
    last = -1
    for line_number, words in _rows(path, DatasetError):
        stamp = _stamp(path, line_number, words[0], DatasetError)
        if len(words) != 2 or not words[1]:
            raise DatasetError(f"{path}:{line_number}: '{','.join(words)[:60]}' is no line 'timestamp [ns],filename'")
        if stamp <= last:
            raise DatasetError(f"{path}:{line_number}: the timestamp {stamp} does not increase; remove it")
        images[stamp] = path.parent / "data" / words[1].replace("\\", "/")
        last = stamp
    if not images:
        raise DatasetError(f"{path}: lists no images; is the sequence complete?")
    return images


def read_states(path: Path) -> Trajectory:
    """Read the poses of the body from the `data.csv` of a ground truth: ns, position, quaternion w x y z, and more.

    Raises:
        TrajectoryError: The file is empty or malformed, or times do not increase.
    """
    times_s, values = [], []
    for line_number, words in _rows(path, TrajectoryError):
        stamp = _stamp(path, line_number, words[0], TrajectoryError)
        try:
            numbers = [float(word) for word in words[1:8]]
        except ValueError:
            raise TrajectoryError(f"{path}:{line_number}: not a number in '{','.join(words)[:60]}'") from None
        if len(numbers) != 7 or not np.all(np.isfinite(numbers)):
            raise TrajectoryError(f"{path}:{line_number}: no stamp, position and quaternion (ns, x y z, w x y z)")
        if abs(np.linalg.norm(numbers[3:]) - 1.0) > 0.01:
            raise TrajectoryError(f"{path}:{line_number}: the length of the quaternion is not 1")
        times_s.append(in_seconds(str(stamp), "ns"))
        values.append(numbers)
    if not values:
        raise TrajectoryError(f"{path}: no poses in it")
    stamps_s, poses = np.array(times_s), np.array(values)
    if np.any(np.diff(stamps_s) <= 0):
        raise TrajectoryError(f"{path}: the timestamps do not increase; remove what repeats or goes back")
    return Trajectory(stamps_s, se3.from_quaternions_xyzw(np.roll(poses[:, 3:], -1, axis=1), poses[:, :3]))


def _rows(path: Path, kind: type[DatasetError] | type[TrajectoryError]) -> list[tuple[int, list[str]]]:
    try:
        lines = read_text(path).splitlines()
    except FileNotFoundError:
        raise kind(f"{path}: no such list; is the sequence complete?") from None
    except (OSError, UnicodeError) as error:
        raise kind(f"{path}: cannot be read as text ({error}) [see troubleshooting: text-files]") from error
    rows = [(number, [word.strip() for word in line.split(",")]) for number, line in enumerate(lines, start=1)]
    return [(number, words) for number, words in rows if any(words) and not words[0].startswith("#")]


def _stamp(path: Path, line: int, word: str, kind: type[DatasetError] | type[TrajectoryError]) -> int:
    if not STAMP.fullmatch(word):
        raise kind(f"{path}:{line}: '{word[:40]}' is no time in whole nanoseconds")
    return int(word)
