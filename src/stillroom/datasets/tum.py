"""The TUM RGB-D benchmark's layout: `rgb.txt` and `depth.txt` list times and images (Sturm et al., IROS 2012)."""

from pathlib import Path

from stillroom.datasets.image_sequence import ImageSequence, Listing, build_sequence, increasing
from stillroom.errors import DatasetError

RGB_LIST_NAME, DEPTH_LIST_NAME = "rgb.txt", "depth.txt"


def open_tum(folder: Path, camera: str | None = None, name: str | None = None) -> ImageSequence:
    """Open a folder with `rgb.txt`, `depth.txt` and, where there is one, `groundtruth.txt`.

    Args:
        folder: The sequence.
        camera: The calibration asked for, a name or a file; the sequence's own where not given.
        name: Name of the sequence; the folder's where not given.

    Raises:
        DatasetError: The folder or a list is missing, empty or malformed, or no frame can be used.
        CalibrationError: No calibration is known, or it does not fit the images.
        TrajectoryError: The ground truth cannot be read.
    """
    if not folder.is_dir():
        raise DatasetError(f"{folder}: no such folder")
    rgb, depth = read_list(folder / RGB_LIST_NAME), read_list(folder / DEPTH_LIST_NAME)
    return build_sequence(folder, rgb, depth, camera, name)


def read_list(path: Path) -> Listing:
    """Read a list of `timestamp file` lines; lines that start with # are comments.

    Raises:
        DatasetError: The list is missing, no text or empty; a line is malformed; times repeat or go back.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except FileNotFoundError:
        raise DatasetError(f"{path.parent}: no {path.name} in it; is this a sequence in the TUM layout?") from None
    except (OSError, UnicodeDecodeError) as error:
        raise DatasetError(f"{path}: cannot be read as text ({error})") from error
    times: list[float] = []
    files: list[Path] = []
    places: list[str] = []
    for number, line in enumerate(lines, start=1):
        words = line.split(maxsplit=1)
        if not words or words[0].startswith("#"):
            continue
        if len(words) != 2:
            raise DatasetError(f"{path}:{number}: '{line.strip()[:60]}' is no line 'timestamp file'")
        try:
            times.append(float(words[0]))
        except ValueError:
            raise DatasetError(f"{path}:{number}: '{words[0][:40]}' is no timestamp in seconds") from None
        files.append(path.parent / words[1].strip())
        places.append(f":{number}")
    if not files:
        raise DatasetError(f"{path}: lists no images; is the sequence complete?")
    return Listing(path, increasing(path, times, places), tuple(files))
