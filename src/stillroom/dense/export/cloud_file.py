"""`dense_cloud.npz`: the dense map of a run as it lies in the results folder, without loss."""

import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from stillroom.data.clouds import DenseCloud
from stillroom.dense.export.replacing import replacing
from stillroom.errors import MapError

NAME = "dense_cloud.npz"
FORMAT = "stillroom dense cloud"
VERSION = 1
ARRAYS = {
    "positions_m": ((3,), np.float32),
    "normals": ((3,), np.float32),
    "rgb": ((3,), np.uint8),
    "weight": ((), np.float32),
}
"""The arrays of a cloud: shape of one point's part, and type."""

COMPRESSION = 1
"""zlib's fastest: coordinates hardly shrink further, and level 6 takes twice as long."""


def save_cloud(cloud: DenseCloud, path: Path) -> None:
    """Write a cloud; `numpy.load` reads it too.

    Raises:
        StillroomError: It cannot be written.
    """
    entries: dict[str, Any] = {"format": FORMAT, "version": VERSION, "voxel_m": float(cloud.voxel_m)}
    entries |= {name: np.asarray(getattr(cloud, name), dtype=kind) for name, (_, kind) in ARRAYS.items()}
    with (
        replacing(path) as file,
        zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=COMPRESSION) as archive,
    ):
        for name, value in entries.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as entry:
                np.lib.format.write_array(entry, np.asarray(value), allow_pickle=False)


def load_cloud(path: Path) -> DenseCloud:
    """Read a cloud that `save_cloud` wrote.

    Raises:
        MapError: It is missing, damaged, of another program, or of a later version.
    """
    try:
        with np.load(path, allow_pickle=False) as entries:
            if "format" not in entries or str(entries["format"]) != FORMAT:
                raise MapError(f"{path}: not a dense cloud of Stillroom")
            version = int(entries["version"])
            if version > VERSION:
                raise MapError(
                    f"{path}: written by a later Stillroom (version {version} of the file); update Stillroom"
                )
            arrays = {name: np.asarray(entries[name]) for name in ARRAYS}
            voxel_m = float(entries["voxel_m"])
    except FileNotFoundError:
        raise MapError(f"{path}: no such file") from None
    except (
        OSError,
        EOFError,
        KeyError,
        ValueError,
        TypeError,
        AttributeError,
        zipfile.BadZipFile,
        zlib.error,
    ) as error:
        raise MapError(f"{path}: damaged, or not a dense cloud; run again to make a new one") from error
    _check(path, arrays, voxel_m)
    return DenseCloud(**arrays, voxel_m=voxel_m)


def _check(path: Path, arrays: dict[str, Any], voxel_m: float) -> None:
    """Refuse what later steps could not bear.

    Raises:
        MapError: Naming the array.
    """
    n_points = len(arrays["positions_m"]) if arrays["positions_m"].ndim else 0
    for name, (shape, kind) in ARRAYS.items():
        if arrays[name].shape != (n_points, *shape) or arrays[name].dtype != kind:
            raise MapError(f"{path}: damaged: {name} is {arrays[name].dtype} {arrays[name].shape}")
        if not np.isfinite(arrays[name]).all():
            raise MapError(f"{path}: damaged: {name} holds numbers that are not finite")
    if not (np.isfinite(voxel_m) and voxel_m > 0):
        raise MapError(f"{path}: damaged: voxels of {voxel_m} m")
