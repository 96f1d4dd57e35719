"""The entry point for all sequences: resolves a path or name, and finds the kind of data set that recognises it."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

from stillroom.data.locations import data_folders, sequence_path
from stillroom.data.sensor import Sensor, sensor_called
from stillroom.datasets import archive
from stillroom.datasets.kind import DatasetKind, SequenceRequest
from stillroom.datasets.mono_sequence import WithoutDepth
from stillroom.datasets.pairing import Pairing
from stillroom.datasets.recording import sensor_of
from stillroom.datasets.registry import LAST, all_kinds
from stillroom.datasets.tum import RGB_LIST_NAME
from stillroom.errors import ConfigError, DatasetError
from stillroom.protocols import Dataset

SEARCH_DEPTH = 2


def open_dataset(
    path_or_name: str,
    camera: str | None = None,
    fps: float | None = None,
    pairing: Pairing | None = None,
    sensor: Sensor | str | None = None,
) -> Dataset:
    """Open a sequence.

    Args:
        path_or_name: A folder; an archive of one; the bare name of one in `STILLROOM_DATA` or in the cache;
            `synthetic:…` for a rendered one; or what an installed package recognises.
        camera: The calibration asked for, a name or a file. Where not given: the sequence's own `camera.toml`, else
            the one that goes with the name of a known data set. `camera_source` of the result says which it was.
        fps: Frames per second [1/s], for a folder whose file names or lists do not tell the time.
        pairing: How times are read and images are paired, where the sequence does not tell it by itself.
        sensor: As what kind of camera's its images are used: "rgbd", "stereo" or "monocular"; what they are where not
            given. As monocular, depth and right images are dropped.

    Raises:
        DatasetError: There is no such sequence, it cannot be opened, or it is not of the sensor asked for.
        CalibrationError: No calibration is known for it, or it does not fit the images.
        ConfigError: An option does not go with this kind of sequence, or an installed package offers what is no kind.
    """
    kinds = tuple(all_kinds().values())
    asked = SequenceRequest(path_or_name)
    kind = _recognised(asked, kinds)
    if kind is None:
        asked = _found(path_or_name)
        kind = _recognised(asked, kinds)
    if kind is None and asked.folder is None:
        asked, kind = _unpacked(asked, kinds)
    # A folder that no kind recognises is opened as a plain one, which reports what is missing.
    kind = kind or LAST
    if pairing is not None and pairing != Pairing() and not kind.takes_pairing:
        raise ConfigError(
            f"{path_or_name}: sequences of the kind '{kind.name}' know by themselves which images belong together; "
            "leave time-unit, pair-by, max-gap and depth-offset out"
        )
    wanted = None if sensor is None else sensor_called(sensor)
    return _as_of(wanted, kind.open(replace(asked, pairing=pairing or Pairing(), sensor=wanted), camera, fps))


def _as_of(wanted: Sensor | None, dataset: Dataset) -> Dataset:
    """Return a data set as the images of another kind of camera.

    Raises:
        DatasetError: They are not.
    """
    given = sensor_of(dataset)
    if wanted is None or wanted is given:
        return dataset
    if wanted is Sensor.MONOCULAR:
        return WithoutDepth(dataset)
    needed = "depth images" if wanted is Sensor.RGBD else "right images"
    raise DatasetError(
        f"{dataset.name}: its images are {given.words} and have no {needed}; leave --sensor {wanted} out"
    )


def _recognised(asked: SequenceRequest, kinds: Iterable[DatasetKind]) -> DatasetKind | None:
    return next((kind for kind in kinds if kind.recognises(asked)), None)


def _found(path_or_name: str) -> SequenceRequest:
    path = Path(path_or_name).expanduser()
    if path.exists():
        return SequenceRequest(path_or_name, path, path.resolve().name)
    if len(path.parts) > 1:
        raise DatasetError(f"{path}: no such folder or archive")
    named = sequence_path(path_or_name)
    if named is None:
        places = ", ".join(str(folder) for folder in data_folders())
        raise DatasetError(
            f"{path}: no such folder or archive here, nor in {places}; "
            "'stillroom download --help' says what can be fetched"
        )
    return SequenceRequest(path_or_name, named, named.resolve().name)


def _unpacked(asked: SequenceRequest, kinds: Iterable[DatasetKind]) -> tuple[SequenceRequest, DatasetKind]:
    """Return the shallowest folder of an archive that some kind recognises, and the kind."""
    path = asked.path
    if path is None or not archive.is_archive(path):
        raise DatasetError(f"{path}: neither a folder nor an archive ({', '.join(archive.SUFFIXES)})")
    top = archive.unpacked(path)
    for folder in _folders(top):
        # An archive without a folder of its own inside is called what its file is called.
        inside = SequenceRequest(asked.text, folder, archive.stem(path) if folder == top else folder.name)
        kind = _recognised(inside, kinds)
        if kind is not None:
            return inside, kind
    raise DatasetError(f"{path}: no {RGB_LIST_NAME} in it; is this a sequence in the TUM layout?")


def _folders(top: Path) -> Iterator[Path]:
    """Yield a folder and those in it, the shallowest first."""
    level = [top]
    for _ in range(SEARCH_DEPTH + 1):
        yield from level
        level = sorted(child for parent in level for child in parent.iterdir() if child.is_dir())
