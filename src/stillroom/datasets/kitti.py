"""KITTI odometry's layout: `image_0`, `image_1`, `calib.txt`, `times.txt`, `poses.txt` (Geiger et al., CVPR 2012).

The grey pair is used; it is rectified. Poses are those of its left camera (docs/reference.md#kitti).
"""

import logging
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stillroom.data.sensor import Sensor
from stillroom.data.text import read_text
from stillroom.data.trajectory import Trajectory
from stillroom.datasets.camera_file import camera_of
from stillroom.datasets.image_sequence import PROBED_FRAMES, read_gray
from stillroom.datasets.kind import DatasetKind, SequenceRequest
from stillroom.datasets.listing import HIDDEN, IMAGE_SUFFIXES, increasing
from stillroom.datasets.mono_sequence import MonoSequence
from stillroom.datasets.stereo_sequence import StereoSequence
from stillroom.datasets.tum import require_rate
from stillroom.errors import CalibrationError, DatasetError, FrameError, TrajectoryError
from stillroom.geometry import se3
from stillroom.geometry.arrays import F64
from stillroom.geometry.camera import Camera
from stillroom.protocols import Dataset

log = logging.getLogger(__name__)
LEFT, RIGHT = "image_0", "image_1"
COLOURS = "image_2", "image_3"
"""The pair in colour, a download of its own, which is not read."""
CALIBRATION_NAME, TIMES_NAME, POSES_NAME = "calib.txt", "times.txt", "poses.txt"
NAMED_ROW = re.compile(r"(\w+)\s*:\s*(.*)")
SAME_PX = 1e-3
"""By how much the intrinsics of a rectified pair may differ [px], as files round."""


def open_kitti(
    folder: Path,
    camera: str | None = None,
    name: str | None = None,
    fps: float | None = None,
    sensor: Sensor | None = None,
) -> MonoSequence | StereoSequence:
    """Open a folder with `image_0`, and `image_1` unless it is monocular.

    Args:
        folder: The sequence. Poses are `poses.txt` in it, or, as in the data set, `../../poses/<name>.txt`.
        camera: A camera file, in place of `calib.txt`; its baseline is that of the pair.
        name: Name of the sequence; the folder's where not given.
        fps: Frames per second [1/s], where `times.txt` is missing.
        sensor: What is to be used: the pair, or the left image alone; what is there where not given.

    Raises:
        DatasetError: Images or times are missing or do not go together, or no frame can be used.
        CalibrationError: `calib.txt` is missing or malformed, or does not fit the images.
        ConfigError: `fps` is not a positive number.
    """
    name = name or folder.resolve().name
    left = _images(folder / LEFT)
    has_pair = (folder / RIGHT).is_dir()
    if sensor is Sensor.STEREO and not has_pair:
        raise DatasetError(f"{folder}: no {RIGHT}/ in it; a stereo sequence needs the right images")
    is_pair = has_pair and sensor is not Sensor.MONOCULAR
    size = _size(left)
    given = None if camera is None else camera_of(camera, has_depth=False, is_pair=is_pair)
    calibration, source = given or (_camera(folder / CALIBRATION_NAME, size, is_pair), f"its own {CALIBRATION_NAME}")
    if given is not None and is_pair and calibration.is_distorted:
        raise CalibrationError(f"--camera {camera}: has a distortion, and the pairs of {name} are rectified")
    timed = _times(folder, left, fps)
    groundtruth, flaw = _groundtruth(folder, name, timed)
    if not is_pair:
        files = tuple(timed.left)
        return MonoSequence(name, calibration, source, timed.times_s, files, groundtruth, flaw).checked(folder)
    right = {path.stem: path for path in _images(folder / RIGHT)}
    paired = np.array([path.stem in right for path in timed.left])
    if not paired.any():
        raise DatasetError(f"{folder}: no image of {RIGHT} is called like one of {LEFT}, so there are no pairs")
    sequence = StereoSequence(
        name=name,
        camera=calibration,
        camera_source=source,
        timestamps_s=timed.times_s[paired],
        left_files=tuple(path for path in timed.left if path.stem in right),
        right_files=tuple(right[path.stem] for path in timed.left if path.stem in right),
        groundtruth=groundtruth,
        unpaired_s=timed.times_s[~paired],
        groundtruth_flaw=flaw,
    )
    return sequence.checked(folder)


def _images(folder: Path) -> list[Path]:
    """Return the images of a folder in the order of their names."""
    if not folder.is_dir():
        raise DatasetError(
            f"{folder.parent}: no folder {folder.name}/ in it; the grey pair, {LEFT}/ and {RIGHT}/, is read"
        )
    files = [p for p in folder.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES and not p.name.startswith(HIDDEN)]
    if not files:
        raise DatasetError(f"{folder}: no images in it; is the sequence complete?")
    return sorted(files)


def _size(files: list[Path]) -> tuple[int, int]:
    """Return width and height of the first image that can be read: the calibration does not say it."""
    for path in files[:PROBED_FRAMES]:
        try:
            gray = read_gray(path)
        except FrameError as error:
            last = error
        else:
            return int(gray.shape[1]), int(gray.shape[0])
    raise DatasetError(f"{files[0].parent}: none of the first images can be read; {last}")


def read_projections(path: Path) -> dict[str, F64]:
    """Read the projection matrices (3, 4) of a `calib.txt` by name; rows without names are P0, P1 and so on.

    Raises:
        CalibrationError: The file is missing or no text, or a row has not twelve numbers.
    """
    try:
        lines = read_text(path).splitlines()
    except FileNotFoundError:
        raise CalibrationError(f"{path}: no such file; a KITTI sequence needs its calibration") from None
    except (OSError, UnicodeError) as error:
        raise CalibrationError(f"{path}: cannot be read as text ({error}) [see troubleshooting: text-files]") from error
    found: dict[str, F64] = {}
    for number, line in enumerate(lines, start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        named = NAMED_ROW.fullmatch(line.strip())
        key, text = (named[1], named[2]) if named else (f"P{len(found)}", line)
        if named and not re.fullmatch(r"P\d", key):
            continue  # such as Tr, the pose of the laser scanner
        found[key] = _matrix(text, CalibrationError(f"{path}:{number}: '{key}' has not twelve numbers, row by row"))
    return found


def _matrix(text: str, error: CalibrationError | TrajectoryError) -> F64:
    try:
        values = np.array([float(word) for word in text.replace(",", " ").split()])
    except ValueError:
        raise error from None
    if len(values) != 12 or not np.all(np.isfinite(values)):
        raise error
    return values.reshape(3, 4)


def _camera(path: Path, size: tuple[int, int], is_pair: bool) -> Camera:
    """Return the camera of a `calib.txt`.

    Raises:
        CalibrationError: A matrix is missing, or the two are not those of a rectified pair.
    """
    projections = read_projections(path)
    for key in ("P0", "P1") if is_pair else ("P0",):
        if key not in projections:
            raise CalibrationError(f"{path}: '{key}' is missing, the projection of {LEFT if key == 'P0' else RIGHT}")
    left = projections["P0"]
    fx, fy, cx, cy = (float(left[i]) for i in ((0, 0), (1, 1), (0, 2), (1, 2)))
    try:
        if not is_pair:
            return Camera(*size, fx, fy, cx, cy)
        right = projections["P1"]
        if np.abs(left[:, :3] - right[:, :3]).max() > SAME_PX:
            raise CalibrationError("P0 and P1 differ in their intrinsics; those of a rectified pair are the same")
        if right[0, 3] >= 0:
            raise CalibrationError(f"the baseline times fx is {-right[0, 3]:g}; are left and right exchanged?")
        return Camera(*size, fx, fy, cx, cy, bf=float(-right[0, 3]))
    except CalibrationError as error:
        raise CalibrationError(f"{path}: {error}") from error


@dataclass(frozen=True)
class _Timed:
    """The left images, their times (N,) [s], and the row (N,) of `times.txt` and `poses.txt` that each has."""

    left: list[Path]
    times_s: F64
    rows: list[int]
    n_rows: int


def _times(folder: Path, left: list[Path], fps: float | None) -> _Timed:
    path = folder / TIMES_NAME
    if fps is not None:
        require_rate(fps)
        return _Timed(left, np.arange(len(left)) / fps, list(range(len(left))), len(left))
    try:
        words = read_text(path).split()
    except FileNotFoundError:
        raise DatasetError(f"{folder}: no {TIMES_NAME} in it; give the frame rate (--fps)") from None
    except (OSError, UnicodeError) as error:
        raise DatasetError(f"{path}: cannot be read as text ({error}) [see troubleshooting: text-files]") from error
    try:
        all_s = increasing(path, [float(word) for word in words], [f": row {i + 1}" for i in range(len(words))])
    except ValueError:
        raise DatasetError(f"{path}: not a time in seconds in every row") from None
    rows = list(range(len(left)))
    if len(left) != len(all_s):  # a part of the images was kept; their names say which
        rows = [int(path.stem) if path.stem.isdecimal() else len(all_s) for path in left]
        if max(rows) >= len(all_s) or len(set(rows)) < len(rows):
            raise DatasetError(
                f"{path}: {len(all_s)} times for {len(left)} images in {LEFT}/, whose names do not tell which is whose"
            )
    return _Timed(left, all_s[rows], rows, len(all_s))


def _groundtruth(folder: Path, name: str, timed: _Timed) -> tuple[Trajectory | None, str]:
    """Return the poses of the left camera, where there are any, and what is wrong with those that cannot be used."""
    beside = folder.resolve().parent.parent / "poses" / f"{folder.resolve().name}.txt"
    path = next((path for path in (folder / POSES_NAME, beside) if path.is_file()), None)
    if path is None:
        return None, ""
    try:
        return _read_poses(path, timed), ""
    except TrajectoryError as error:
        flaw = str(error).partition(" [see")[0]
        log.warning("ground truth is left out, so there are no figures: %s [see troubleshooting: groundtruth]", flaw)
        return None, flaw


def _read_poses(path: Path, timed: _Timed) -> Trajectory:
    try:
        lines = [line for line in read_text(path).splitlines() if line.strip()]
    except (OSError, UnicodeError) as error:
        raise TrajectoryError(f"{path}: cannot be read as text ({error})") from error
    if len(lines) != timed.n_rows:
        raise TrajectoryError(f"{path}: {len(lines)} poses for {timed.n_rows} images")
    T_world_cam = np.tile(np.eye(4), (len(timed.rows), 1, 1))
    for pose, row in zip(T_world_cam, timed.rows, strict=True):
        pose[:3] = _matrix(lines[row], TrajectoryError(f"{path}:{row + 1}: a pose has twelve numbers, row by row"))
        if np.abs(pose[:3, :3] @ pose[:3, :3].T - np.eye(3)).max() > 1e-2:
            raise TrajectoryError(f"{path}:{row + 1}: the first three columns are no rotation")
    return Trajectory(timed.times_s, np.stack([se3.orthonormalize(pose) for pose in T_world_cam]))


def _is_kitti(asked: SequenceRequest) -> bool:
    # One without the left images is told what it lacks.
    return asked.folder is not None and any((asked.folder / name).is_dir() for name in (LEFT, RIGHT, *COLOURS))


def _open(asked: SequenceRequest, camera: str | None, fps: float | None) -> Dataset:
    assert asked.folder is not None, "recognised by its folder"
    return open_kitti(asked.folder, camera, asked.name, fps, asked.sensor)


KIND = DatasetKind(
    "kitti",
    f"a sequence of KITTI odometry: {LEFT}/, {RIGHT}/ and {CALIBRATION_NAME} (stereo, or monocular with one)",
    _is_kitti,
    _open,
)
