"""The TUM RGB-D benchmark's layout: `rgb.txt` and `depth.txt` list times and images (Sturm et al., IROS 2012)."""

import logging
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from stillroom.data.text import read_text
from stillroom.data.trajectory import is_header
from stillroom.datasets.archive import MACOS_PREFIX
from stillroom.datasets.image_sequence import ImageSequence, build_sequence
from stillroom.datasets.listing import Listing, increasing
from stillroom.datasets.pairing import BY_ORDER, BY_TIME, Pairing, pair_images
from stillroom.datasets.time_units import COUNTER, NAMES, POWERS, in_seconds, required_unit, unit_of
from stillroom.errors import ConfigError, DatasetError
from stillroom.geometry.arrays import F64, I64

RGB_LIST_NAME, DEPTH_LIST_NAME = "rgb.txt", "depth.txt"
ASSOCIATION = re.compile(r"([-+.\deE]+)[\s,]+(\S+\.\w+)[\s,]+([-+.\deE]+)[\s,]+(\S+\.\w+)")
"""A line of `associate.py`: the time and the file of a colour image, then those of its depth image."""
WITHOUT_DEPTH = "--sensor monocular tracks by the colour images alone"
log = logging.getLogger(__name__)


def open_tum(
    folder: Path,
    camera: str | None = None,
    name: str | None = None,
    fps: float | None = None,
    pairing: Pairing | None = None,
) -> ImageSequence:
    """Open a folder with `rgb.txt`, `depth.txt` and, where there is one, `groundtruth.txt`.

    Args:
        folder: The sequence.
        camera: The calibration asked for, a name or a file; the sequence's own where not given.
        name: Name of the sequence; the folder's where not given.
        fps: Frames per second [1/s] that stand in for the steps of the list's times; the lists still tell which images
            belong together. Image n of lists that count images is then at n / fps.
        pairing: How times are read and images are paired.

    Raises:
        DatasetError: The folder or a list is missing, empty or malformed, the unit of its times cannot be told, or no
            frame can be used.
        CalibrationError: No calibration is known, or it does not fit the images.
        ConfigError: `fps` is not a positive number.
    """
    if not folder.is_dir():
        raise DatasetError(f"{folder}: no such folder")
    if fps is not None:
        require_rate(fps)
    pairing = pairing or Pairing()
    rgb_rows = _read_rows(folder / RGB_LIST_NAME)
    if rgb_rows.depth is not None:
        return _open_associated(folder, rgb_rows, rgb_rows.depth, camera, name, fps, pairing)
    depth_rows = _read_rows(folder / DEPTH_LIST_NAME)
    if depth_rows.depth is not None:
        raise DatasetError(
            f"{depth_rows.source}: has four columns, as associate.py writes them; save it as {RGB_LIST_NAME}, whose "
            "lines then are the pairs [see troubleshooting: text-files]"
        )
    if fps is None:
        rgb, depth = _in_seconds(folder, rgb_rows, depth_rows, pairing)
        return build_sequence(folder, rgb, depth, camera, name, pairing)
    rgb, pairs = _at_rate(folder, rgb_rows, depth_rows, pairing, fps)
    return build_sequence(folder, rgb, depth_rows.listing("s"), camera, name, pairing, pairs)


def colour_listing(folder: Path, fps: float | None, pairing: Pairing) -> Listing:
    """Return the colour images of `rgb.txt` alone, with their times.

    Raises:
        DatasetError: The list is missing, empty or malformed, or the unit of its times cannot be told.
    """
    rows = _read_rows(folder / RGB_LIST_NAME)
    if fps is None:
        return rows.listing(required_unit(rows.source, rows.words, pairing.time_unit))
    counts = pairing.time_unit is None and rows.unit() == COUNTER
    return Listing(rows.source, (rows.numbers() if counts else np.arange(len(rows.files))) / fps, rows.files)


def require_rate(fps: float) -> None:
    """Refuse an impossible frame rate [1/s].

    Raises:
        ConfigError: It is not a positive number.
    """
    if not (np.isfinite(fps) and fps > 0):
        raise ConfigError(f"fps is {fps}; it must be a positive number")


def read_list(path: Path, unit: str = "s") -> Listing:
    """Read a list of `timestamp file` lines; lines that start with # are comments.

    Args:
        path: The list.
        unit: Unit of its times: s, ms, us or ns.

    Raises:
        DatasetError: The list is missing, no text or empty; a line is malformed; times repeat or go back.
    """
    return _read_rows(path).listing(unit)


@dataclass(frozen=True)
class _Rows:
    """The rows of a list as written: times as words, images, and each row's place for messages."""

    source: Path
    words: tuple[str, ...]
    files: tuple[Path, ...]
    places: tuple[str, ...]
    depth: "_Rows | None" = None

    def numbers(self) -> F64:
        return np.array([float(word) for word in self.words])

    def unit(self) -> str | None:
        return unit_of(self.numbers())

    def listing(self, unit: str) -> Listing:
        times_s = increasing(self.source, [in_seconds(word, unit) for word in self.words], self.places)
        return Listing(self.source, times_s, self.files)


def _read_rows(path: Path) -> _Rows:
    """Read a list; one with four columns has the depth images in `depth`."""
    rows: list[list[str]] = []
    places: list[str] = []
    for number, line in enumerate(_lines(path), start=1):
        words = _two(line)
        if not words or words[0].startswith("#") or (not rows and is_header(line.replace(",", " ").split())):
            continue
        if len(words) != 2:
            raise DatasetError(
                f"{path}:{number}: '{line.strip()[:60]}' is no line 'timestamp file' [see troubleshooting: text-files]"
            )
        associated = ASSOCIATION.fullmatch(line.strip())
        words = list(associated.groups()) if associated else words
        if rows and len(words) != len(rows[0]):
            raise DatasetError(
                f"{path}:{number}: two columns in some lines and four in others [see troubleshooting: text-files]"
            )
        for word in words[::2]:
            _require_time(path, number, word)
        if not Path(words[1]).name.startswith(MACOS_PREFIX):
            rows.append(words)
            places.append(f":{number}")
    if not rows:
        raise DatasetError(f"{path}: lists no images; is the sequence complete?")
    columns = list(zip(*rows, strict=True))
    depth = _Rows(path, columns[2], _files(path, columns[3]), tuple(places)) if len(columns) == 4 else None
    return _Rows(path, columns[0], _files(path, columns[1]), tuple(places), depth)


def _two(line: str) -> list[str]:
    """Return time and file of a line; a comma may stand between them, but none makes two of a time."""
    words = line.split(maxsplit=1)
    if len(words) == 1:
        words = words[0].split(",", maxsplit=1)
    return [words[0].rstrip(","), *words[1:]] if words else []


def _lines(path: Path) -> list[str]:
    try:
        return read_text(path).splitlines()
    except FileNotFoundError:
        hint = f"; {WITHOUT_DEPTH}" if path.name == DEPTH_LIST_NAME else ""
        raise DatasetError(
            f"{path.parent}: no {path.name} in it; is this a sequence in the TUM layout?{hint}"
        ) from None
    except (OSError, UnicodeError) as error:
        raise DatasetError(f"{path}: cannot be read as text ({error}) [see troubleshooting: text-files]") from error


def _require_time(path: Path, number: int, word: str) -> None:
    try:
        is_finite = np.isfinite(float(word))
    except ValueError:
        raise DatasetError(f"{path}:{number}: '{word[:40]}' is no timestamp") from None
    if not is_finite:
        raise DatasetError(f"{path}:{number}: the timestamp is not a finite number")


def _files(source: Path, names: Sequence[str]) -> tuple[Path, ...]:
    """Return the images that a list names, beside it; lists written on Windows may have backslashes."""
    return tuple(source.parent / name.strip().replace("\\", "/") for name in names)


def _open_associated(
    folder: Path, rows: _Rows, depth: _Rows, camera: str | None, name: str | None, fps: float | None, pairing: Pairing
) -> ImageSequence:
    """Open a sequence by a list of four columns, whose lines are the pairs."""
    log.warning(
        "%s: has four columns, as associate.py writes them; each line is a pair, and %s is not read "
        "[see troubleshooting: text-files]",
        rows.source,
        DEPTH_LIST_NAME,
    )
    places = np.arange(len(rows.files))
    if fps is None:
        rgb, _ = _in_seconds(folder, rows, rows, pairing)
    else:
        rgb, _ = _at_rate(folder, rows, rows, replace(pairing, by=BY_ORDER), fps)
    # One depth image may belong to two colour images, so its times need not increase.
    return build_sequence(
        folder, rgb, Listing(depth.source, rgb.timestamps_s, depth.files), camera, name, pairing, (places, places)
    )


def _in_seconds(folder: Path, rgb: _Rows, depth: _Rows, pairing: Pairing) -> tuple[Listing, Listing]:
    """Return both lists with times in seconds, and say so where they were not."""
    units = [required_unit(rows.source, rows.words, pairing.time_unit) for rows in (rgb, depth)]
    listings = rgb.listing(units[0]), depth.listing(units[1])
    if pairing.time_unit is None and any(unit != "s" for unit in units):
        read_as = " and ".join(dict.fromkeys(NAMES[unit] for unit in units))
        log.warning(
            "%s: times like %s are read as %s, converted to seconds; --time-unit overrides it "
            "[see troubleshooting: time-unit]",
            folder,
            (rgb if units[0] != "s" else depth).words[0],
            read_as,
        )
    return listings


def _at_rate(folder: Path, rgb: _Rows, depth: _Rows, pairing: Pairing, fps: float) -> tuple[Listing, tuple[I64, I64]]:
    """Return the colour images at times of a frame rate, and which images (K,), (K,) belong together by the lists."""
    if pairing.time_unit is None and rgb.unit() == COUNTER:
        times_s = rgb.numbers() / fps
        if depth.unit() == COUNTER and pairing.by in {None, BY_TIME}:
            # Equal numbers are one moment; where some are missing, images were lost and time went on.
            both, of_rgb, of_depth = np.intersect1d(rgb.numbers(), depth.numbers(), return_indices=True)
            if len(both) == 0:
                raise DatasetError(
                    f"{folder}: no number of {rgb.source.name} is in {depth.source.name}, so nothing belongs together; "
                    "give --pair-by order if the order tells it [see troubleshooting: pairing]"
                )
            return Listing(rgb.source, times_s, rgb.files), (of_rgb, of_depth)
        pairs = pair_images(folder, rgb.listing("s"), depth.listing("s"), pairing)
        return Listing(rgb.source, times_s, rgb.files), pairs
    if pairing.by == BY_ORDER:
        unit = pairing.time_unit or rgb.unit()
        timed, of_depth_list = rgb.listing(unit if unit in POWERS else "s"), depth.listing("s")
    else:
        timed, of_depth_list = _in_seconds(folder, rgb, depth, pairing)
    pairs = pair_images(folder, timed, of_depth_list, pairing)
    times_s = timed.timestamps_s[0] + np.arange(len(timed.files)) / fps
    return Listing(rgb.source, times_s, rgb.files), pairs
