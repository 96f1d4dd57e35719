"""One door to all sequences: decides what kind a path or name is, and opens it."""

from pathlib import Path

from stillroom.data.locations import data_folders, sequence_path
from stillroom.datasets import archive
from stillroom.datasets.bonn import NAME_PREFIX as BONN_PREFIX
from stillroom.datasets.bonn import open_bonn
from stillroom.datasets.folder import open_folder
from stillroom.datasets.tum import RGB_LIST_NAME
from stillroom.errors import ConfigError, DatasetError
from stillroom.protocols import Dataset

SYNTHETIC = "synthetic"
SEARCH_DEPTH = 2


def open_dataset(path_or_name: str, camera: str | None = None, fps: float | None = None) -> Dataset:
    """Open a sequence.

    Args:
        path_or_name: A folder; an archive of one; the bare name of one in `STILLROOM_DATA` or in the cache; or
            `synthetic:…` for a rendered one.
        camera: The calibration asked for, a name or a file. Where not given: the sequence's own `camera.toml`, else
            the one that goes with the name of a known data set. `camera_source` of the result says which it was.
        fps: Frames per second [1/s], for a plain folder whose file names do not tell the time.

    Raises:
        DatasetError: There is no such sequence, or it cannot be opened.
        CalibrationError: No calibration is known for it, or it does not fit the images.
        TrajectoryError: Its ground truth cannot be read.
        ConfigError: An option does not go with this kind of sequence.
    """
    if path_or_name.split(":", 1)[0] == SYNTHETIC:
        return _open_synthetic(path_or_name, camera, fps)
    path = _find(path_or_name)
    if path.is_dir():
        folder = path
        name = folder.resolve().name
    elif archive.is_archive(path):
        top = archive.unpacked(path)
        folder = _sequence_in(top, path)
        # An archive without a folder of its own inside is called what its file is called.
        name = archive.stem(path) if folder == top else folder.name
    else:
        raise DatasetError(f"{path}: neither a folder nor an archive ({', '.join(archive.SUFFIXES)})")
    if name.startswith(BONN_PREFIX) and (folder / RGB_LIST_NAME).exists() and fps is None:
        return open_bonn(folder, camera, name)
    return open_folder(folder, camera, name, fps)


def _open_synthetic(name: str, camera: str | None, fps: float | None) -> Dataset:
    if camera is not None or fps is not None:
        raise ConfigError(f"{name}: a rendered sequence brings its own camera and times; leave camera and fps out")
    from stillroom.datasets.synthetic import open_synthetic

    return open_synthetic(name)


def _find(path_or_name: str) -> Path:
    path = Path(path_or_name).expanduser()
    if path.exists():
        return path
    if len(path.parts) > 1:
        raise DatasetError(f"{path}: no such folder or archive")
    named = sequence_path(path_or_name)
    if named is None:
        places = ", ".join(str(folder) for folder in data_folders())
        raise DatasetError(
            f"{path}: no such folder or archive here, nor in {places}; "
            "'stillroom download --help' says what can be fetched"
        )
    return named


def _sequence_in(folder: Path, source: Path) -> Path:
    """Return the shallowest folder that holds `rgb.txt` or `rgb/`."""
    level = [folder]
    for _ in range(SEARCH_DEPTH + 1):
        for candidate in level:
            if (candidate / RGB_LIST_NAME).is_file() or (candidate / "rgb").is_dir():
                return candidate
        level = sorted(child for parent in level for child in parent.iterdir() if child.is_dir())
    raise DatasetError(f"{source}: no {RGB_LIST_NAME} in it; is this a sequence in the TUM layout?")
