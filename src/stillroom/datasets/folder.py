"""A plain folder of the user's own: `rgb/` and `depth/`, with or without lists.

Without lists, times come from the file names or from a frame rate:

- names that are numbers with a decimal point are seconds (`1305031229.528748.png`);
- names of 19 digits are nanoseconds, as ROS writes them (`1403636579763555584.png`);
- other names (`000017.png`, `frame17.png`) tell the order only, and need a frame rate.
"""

import re
from pathlib import Path

import numpy as np

from stillroom.datasets.image_sequence import ImageSequence, Listing, build_sequence, increasing
from stillroom.datasets.kind import DatasetKind, SequenceRequest
from stillroom.datasets.tum import RGB_LIST_NAME, open_tum
from stillroom.errors import ConfigError, DatasetError
from stillroom.protocols import Dataset

IMAGE_SUFFIXES = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".ppm", ".pgm"}
SECONDS = re.compile(r"\d+\.\d+")
NANOSECONDS = re.compile(r"\d{19}")


def open_folder(
    folder: Path, camera: str | None = None, name: str | None = None, fps: float | None = None
) -> ImageSequence:
    """Open a folder with `rgb/` and `depth/`.

    Args:
        folder: The sequence.
        camera: The calibration asked for, a name or a file; the sequence's own where not given.
        name: Name of the sequence; the folder's where not given.
        fps: Frames per second [1/s] of images whose names do not tell the time; image k is then at k / fps.

    Raises:
        DatasetError: The folder is missing or empty, the names tell no times and `fps` is not given, or no frame
            can be used.
        CalibrationError: No calibration is known, or it does not fit the images.
        ConfigError: `fps` is not a positive number, or there are lists, which tell the times already.
        TrajectoryError: The ground truth cannot be read.
    """
    if not folder.is_dir():
        raise DatasetError(f"{folder}: no such folder")
    if fps is not None and not (np.isfinite(fps) and fps > 0):
        raise ConfigError(f"fps is {fps}; it must be a positive number")
    if (folder / RGB_LIST_NAME).exists():
        if fps is not None:
            raise ConfigError(f"{folder}: {RGB_LIST_NAME} tells the times; leave fps out")
        return open_tum(folder, camera, name)
    rgb_files, depth_files = _images(folder / "rgb"), _images(folder / "depth")
    if fps is None:
        rgb, depth = _timed_by_name(folder / "rgb", rgb_files), _timed_by_name(folder / "depth", depth_files)
        return build_sequence(folder, rgb, depth, camera, name)
    rgb_files, depth_files = _same_places(folder, rgb_files, depth_files)
    times_s, places = np.arange(len(rgb_files)) / fps, np.arange(len(rgb_files))
    rgb = Listing(folder / "rgb", times_s, tuple(rgb_files))
    depth = Listing(folder / "depth", times_s, tuple(depth_files))
    return build_sequence(folder, rgb, depth, camera, name, pairs=(places, places))


def _images(folder: Path) -> list[Path]:
    """Return the images of a folder in the order of their names, numbers in them counted as numbers."""
    if not folder.is_dir():
        raise DatasetError(f"{folder.parent}: no {RGB_LIST_NAME} and no folder {folder.name}/ in it")
    files = [path for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES]
    if not files:
        raise DatasetError(f"{folder}: no images in it; is the sequence complete?")
    return sorted(files, key=_natural_order)


def _natural_order(path: Path) -> tuple[tuple[str | int, ...], str]:
    # The parts alternate between text and digits, so text is only ever compared with text.
    parts = re.split(r"(\d+)", path.stem)
    return tuple(int(part) if i % 2 else part for i, part in enumerate(parts)), path.name


def _timed_by_name(source: Path, files: list[Path]) -> Listing:
    if all(SECONDS.fullmatch(path.stem) for path in files):
        times_s = [float(path.stem) for path in files]
    elif all(NANOSECONDS.fullmatch(path.stem) for path in files):
        times_s = [int(path.stem) * 1e-9 for path in files]
    else:
        odd = next(path for path in files if not SECONDS.fullmatch(path.stem))
        raise DatasetError(
            f"{odd}: the name tells no time (seconds like 1305031229.5287, or 19 digits of nanoseconds); "
            f"give the frame rate, or a list {RGB_LIST_NAME}"
        )
    order = sorted(range(len(files)), key=lambda i: times_s[i])
    ordered = tuple(files[i] for i in order)
    places = [f"/{path.name}" for path in ordered]
    return Listing(source, increasing(source, [times_s[i] for i in order], places), ordered)


def _same_places(folder: Path, rgb: list[Path], depth: list[Path]) -> tuple[list[Path], list[Path]]:
    """Pair files by equal names, else by their order where there are equally many."""
    depth_of = {path.stem: path for path in depth}
    if all(path.stem in depth_of for path in rgb):
        return rgb, [depth_of[path.stem] for path in rgb]
    if len(rgb) == len(depth):
        return rgb, depth
    raise DatasetError(
        f"{folder}: {len(rgb)} colour and {len(depth)} depth images whose names do not agree; "
        f"name them alike, or write {RGB_LIST_NAME} and depth.txt"
    )


def _is_sequence(asked: SequenceRequest) -> bool:
    folder = asked.folder
    return folder is not None and ((folder / RGB_LIST_NAME).is_file() or (folder / "rgb").is_dir())


def _open(asked: SequenceRequest, camera: str | None, fps: float | None) -> Dataset:
    assert asked.folder is not None, "recognised by its folder"
    return open_folder(asked.folder, camera, asked.name, fps)


KIND = DatasetKind("folder", f"a folder with rgb/ and depth/, or with {RGB_LIST_NAME} as in TUM's", _is_sequence, _open)
