"""The TUM RGB-D benchmark's layout: `rgb.txt` and `depth.txt` list times and images (Sturm et al., IROS 2012)."""

import logging
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stillroom.datasets.image_sequence import ImageSequence, build_sequence
from stillroom.datasets.listing import Listing, increasing
from stillroom.datasets.pairing import BY_ORDER, BY_TIME, Pairing, pair_images
from stillroom.datasets.time_units import COUNTER, NAMES, POWERS, in_seconds, required_unit, unit_of
from stillroom.errors import ConfigError, DatasetError
from stillroom.geometry.arrays import F64, I64

RGB_LIST_NAME, DEPTH_LIST_NAME = "rgb.txt", "depth.txt"
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
    rgb_rows, depth_rows = _read_rows(folder / RGB_LIST_NAME), _read_rows(folder / DEPTH_LIST_NAME)
    if fps is None:
        rgb, depth = _in_seconds(folder, rgb_rows, depth_rows, pairing)
        return build_sequence(folder, rgb, depth, camera, name, pairing)
    rgb, pairs = _at_rate(folder, rgb_rows, depth_rows, pairing, fps)
    return build_sequence(folder, rgb, depth_rows.listing("s"), camera, name, pairing, pairs)


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

    def numbers(self) -> F64:
        return np.array([float(word) for word in self.words])

    def unit(self) -> str | None:
        return unit_of(self.numbers())

    def listing(self, unit: str) -> Listing:
        times_s = increasing(self.source, [in_seconds(word, unit) for word in self.words], self.places)
        return Listing(self.source, times_s, self.files)


def _read_rows(path: Path) -> _Rows:
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except FileNotFoundError:
        raise DatasetError(f"{path.parent}: no {path.name} in it; is this a sequence in the TUM layout?") from None
    except (OSError, UnicodeDecodeError) as error:
        raise DatasetError(f"{path}: cannot be read as text ({error})") from error
    stamps: list[str] = []
    files: list[Path] = []
    places: list[str] = []
    for number, line in enumerate(lines, start=1):
        words = line.split(maxsplit=1)
        if not words or words[0].startswith("#"):
            continue
        if len(words) != 2:
            raise DatasetError(f"{path}:{number}: '{line.strip()[:60]}' is no line 'timestamp file'")
        try:
            is_finite = np.isfinite(float(words[0]))
        except ValueError:
            raise DatasetError(f"{path}:{number}: '{words[0][:40]}' is no timestamp") from None
        if not is_finite:
            raise DatasetError(f"{path}:{number}: the timestamp is not a finite number")
        stamps.append(words[0])
        files.append(path.parent / words[1].strip())
        places.append(f":{number}")
    if not files:
        raise DatasetError(f"{path}: lists no images; is the sequence complete?")
    return _Rows(path, tuple(stamps), tuple(files), tuple(places))


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
