"""A plain folder of the user's own: `rgb/` and `depth/`, with or without lists.

Without lists, times come from the file names or from a frame rate:

- names that are numbers with a decimal point are seconds (`1305031229.528748.png`);
- names of 19 digits are nanoseconds, as ROS writes them (`1403636579763555584.png`), and of 16 and 13 digits micro- and
  milliseconds;
- other names (`000017.png`, `frame17.png`) tell the order only, and need a frame rate. Equal numbers are one moment.
"""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from stillroom.data.sensor import Sensor
from stillroom.datasets.camera_file import choose_camera
from stillroom.datasets.image_sequence import GROUNDTRUTH_NAME, ImageSequence, build_sequence, read_groundtruth
from stillroom.datasets.kind import DatasetKind, SequenceRequest
from stillroom.datasets.listing import HIDDEN, IMAGE_SUFFIXES, Listing, increasing
from stillroom.datasets.mono_sequence import MonoSequence
from stillroom.datasets.pairing import BY_NAME, Pairing, last_number, pair_images
from stillroom.datasets.time_units import EPOCH_DIGITS, LARGEST_COUNTED_STEP, in_seconds
from stillroom.datasets.tum import DEPTH_LIST_NAME, RGB_LIST_NAME, WITHOUT_DEPTH, colour_listing, open_tum, require_rate
from stillroom.errors import DatasetError
from stillroom.geometry.arrays import F64
from stillroom.protocols import Dataset

SECONDS = re.compile(r"\d+\.\d+")
NUMBER = re.compile(r"\d+(\.\d+)?")


def open_folder(
    folder: Path,
    camera: str | None = None,
    name: str | None = None,
    fps: float | None = None,
    pairing: Pairing | None = None,
) -> ImageSequence:
    """Open a folder with `rgb/` and `depth/`.

    Args:
        folder: The sequence.
        camera: The calibration asked for, a name or a file; the sequence's own where not given.
        name: Name of the sequence; the folder's where not given.
        fps: Frames per second [1/s] of images whose names do not tell the time, or that lists give wrong times. Names
            that count tell which images were lost; image n is then at (n − first) / fps.
        pairing: How times are read and images are paired.

    Raises:
        DatasetError: The folder is missing or empty, the names tell no times and `fps` is not given, they do not tell
            which images belong together, or no frame can be used.
        CalibrationError: No calibration is known, or it does not fit the images.
        ConfigError: `fps` is not a positive number.
    """
    if not folder.is_dir():
        raise DatasetError(f"{folder}: no such folder")
    if fps is not None:
        require_rate(fps)
    if (folder / RGB_LIST_NAME).exists():
        return open_tum(folder, camera, name, fps, pairing)
    pairing = pairing or Pairing()
    rgb_files, depth_files = _images(folder / "rgb"), _images(folder / "depth")
    if fps is None:
        rgb, depth = (_timed_by_name(files[0].parent, files, pairing.time_unit) for files in (rgb_files, depth_files))
        return build_sequence(folder, rgb, depth, camera, name, pairing)
    if all(pairing.time_unit or _told_unit(files) for files in (rgb_files, depth_files)):
        # The names tell which images belong together, though not when they were taken.
        rgb, depth = (_timed_by_name(files[0].parent, files, pairing.time_unit) for files in (rgb_files, depth_files))
        pairs = pair_images(folder, rgb, depth, pairing)
        rgb = replace(rgb, timestamps_s=rgb.timestamps_s[0] + np.arange(len(rgb.files)) / fps)
        return build_sequence(folder, rgb, depth, camera, name, pairing, pairs)
    rgb, depth = (Listing(files[0].parent, _counted(files, fps), tuple(files)) for files in (rgb_files, depth_files))
    pairs = pair_images(folder, rgb, depth, pairing, BY_NAME)
    return build_sequence(folder, rgb, depth, camera, name, pairing, pairs)


def open_colours(
    folder: Path,
    camera: str | None = None,
    name: str | None = None,
    fps: float | None = None,
    pairing: Pairing | None = None,
) -> MonoSequence:
    """Open the colour images of a folder that has no depth images, as those of a single camera.

    Arguments are those of `open_folder`.

    Raises:
        DatasetError: The images are missing, or do not tell when they were taken; or no frame can be used.
        CalibrationError: No calibration is known, or it does not fit the images.
        ConfigError: `fps` is not a positive number.
    """
    if fps is not None:
        require_rate(fps)
    pairing, name = pairing or Pairing(), name or folder.resolve().name
    if (folder / RGB_LIST_NAME).exists():
        rgb = colour_listing(folder, fps, pairing)
    else:
        files = _images(folder / "rgb")
        if fps is None or pairing.time_unit or _told_unit(files):
            rgb = _timed_by_name(folder / "rgb", files, pairing.time_unit)
        else:
            rgb = Listing(folder / "rgb", _counted(files, fps), tuple(files))
        if fps is not None and (pairing.time_unit or _told_unit(files)):
            rgb = replace(rgb, timestamps_s=rgb.timestamps_s[0] + np.arange(len(rgb.files)) / fps)
    calibration, source = choose_camera(folder, name, camera, has_depth=False)
    groundtruth, flaw = read_groundtruth(folder / GROUNDTRUTH_NAME, rgb.timestamps_s)
    sequence = MonoSequence(name, calibration, source, rgb.timestamps_s, rgb.files, groundtruth, flaw)
    return sequence.checked(folder)


def _images(folder: Path) -> list[Path]:
    """Return the images of a folder in the order of their names, numbers in them counted as numbers."""
    if not folder.is_dir():
        hint = f"; {WITHOUT_DEPTH}" if folder.name == "depth" else ""
        raise DatasetError(f"{folder.parent}: no {RGB_LIST_NAME} and no folder {folder.name}/ in it{hint}")
    files = [p for p in folder.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES and not p.name.startswith(HIDDEN)]
    if not files:
        raise DatasetError(f"{folder}: no images in it; is the sequence complete?")
    return sorted(files, key=_natural_order)


def _natural_order(path: Path) -> tuple[tuple[str | int, ...], str]:
    # The parts alternate between text and digits, so text is only ever compared with text.
    parts = re.split(r"(\d+)", path.stem)
    return tuple(int(part) if i % 2 else part for i, part in enumerate(parts)), path.name


def _timed_by_name(source: Path, files: list[Path], unit: str | None) -> Listing:
    told = unit or _told_unit(files)
    odd = next((path for path in files if not NUMBER.fullmatch(path.stem)), None if told else files[0])
    if odd is not None or told is None:
        raise DatasetError(
            f"{odd}: the name tells no time (seconds like 1305031229.5287, or 19 digits of nanoseconds); "
            f"give the frame rate (--fps), or a list {RGB_LIST_NAME} [see troubleshooting: time-unit]"
        )
    times_s = [in_seconds(path.stem, told) for path in files]
    order = sorted(range(len(files)), key=lambda i: times_s[i])
    ordered = tuple(files[i] for i in order)
    places = [f"/{path.name}" for path in ordered]
    return Listing(source, increasing(source, [times_s[i] for i in order], places), ordered)


def _told_unit(files: list[Path]) -> str | None:
    """Return the unit of names that are times; None where they are none, or may only count."""
    names = [path.stem for path in files]
    if all(SECONDS.fullmatch(name) for name in names):
        return "s"
    if all(name.isdecimal() and len(name) in EPOCH_DIGITS.values() for name in names):
        return next(unit for unit, digits in EPOCH_DIGITS.items() if len(names[0]) == digits)
    return None


def _counted(files: list[Path], fps: float) -> F64:
    """Return the time of each image (N,) [s]: by the number in its name where those count, else by its place."""
    places = np.arange(len(files))
    numbers = [number for path in files if (number := last_number(path)) is not None]
    steps = np.diff(numbers)
    if len(numbers) == len(files) > 1 and np.all(steps > 0):
        stride = int(np.gcd.reduce(steps))
        # Larger steps are those of times rather than of images that were lost.
        if np.median(steps) < LARGEST_COUNTED_STEP * stride:
            places = (np.asarray(numbers, dtype=np.int64) - numbers[0]) // stride
    return np.asarray(places / fps, dtype=np.float64)


def _is_sequence(asked: SequenceRequest) -> bool:
    folder = asked.folder
    return folder is not None and ((folder / RGB_LIST_NAME).is_file() or (folder / "rgb").is_dir())


def _open(asked: SequenceRequest, camera: str | None, fps: float | None) -> Dataset:
    assert asked.folder is not None, "recognised by its folder"
    has_depth = any((asked.folder / name).exists() for name in ("depth", DEPTH_LIST_NAME))
    open_it = open_colours if asked.sensor is Sensor.MONOCULAR and not has_depth else open_folder
    return open_it(asked.folder, camera, asked.name, fps, asked.pairing)


KIND = DatasetKind(
    "folder",
    f"a folder with rgb/ and depth/, or with {RGB_LIST_NAME} as in TUM's",
    _is_sequence,
    _open,
    takes_pairing=True,
)
