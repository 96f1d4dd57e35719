"""The dense map as the system returns it: coloured, oriented points, and their file formats."""

import zipfile
import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from stillroom.data.pcd import write_pcd
from stillroom.data.ply import POINT, filled, write_ply
from stillroom.data.replacing import replacing
from stillroom.errors import ConfigError, MapError
from stillroom.geometry.arrays import F32, I32, U8

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

FREE = "free"
"""The array that is written where a map knows of free space."""

COMPRESSION = 1
"""zlib's fastest: coordinates hardly shrink further, and level 6 takes twice as long."""


@dataclass(frozen=True)
class DenseCloud:
    """N points of the static scene, one for each occupied voxel.

    Attributes:
        positions_m: Mean positions (N, 3) float32 [m, world].
        normals: Unit normals towards the cameras that saw them (N, 3) float32 [world].
        rgb: Mean colours (N, 3) uint8.
        weight: Number of pixels that each point averages (N,) float32.
        voxel_m: Edge of the voxels [m].
        free: Indices (M, 3) int32 of the voxels that are known to be free; voxel i reaches from i to i + 1 edges. Most
            maps do not know, and have none.
    """

    positions_m: F32
    normals: F32
    rgb: U8
    weight: F32
    voxel_m: float
    free: I32 = field(default_factory=lambda: np.zeros((0, 3), dtype=np.int32), repr=False)

    def __len__(self) -> int:
        """Number of points."""
        return len(self.positions_m)

    def write(self, path: Path | str) -> None:
        """Write the points into a file: `.ply` and `.pcd` for other programs, `.npz` without loss (`load_cloud`).

        Raises:
            ConfigError: The name ends in something else.
            StillroomError: It cannot be written.
        """
        path = Path(path)
        kind = path.suffix.lower()
        if kind == ".npz":
            self._write_npz(path)
        elif kind == ".ply":
            points = filled(POINT, self.positions_m, self.normals, self.rgb)
            points["weight"] = self.weight
            write_ply(points, path)
        elif kind == ".pcd":
            write_pcd(self.positions_m, self.normals, self.rgb, path)
        else:
            raise ConfigError(f"{path}: points are written as .ply, .pcd or .npz; 'stillroom export' makes other files")

    def _write_npz(self, path: Path) -> None:
        entries: dict[str, Any] = {"format": FORMAT, "version": VERSION, "voxel_m": float(self.voxel_m)}
        entries |= {name: np.asarray(getattr(self, name), dtype=kind) for name, (_, kind) in ARRAYS.items()}
        if len(self.free):
            entries[FREE] = np.asarray(self.free, dtype=np.int32)
        with (
            replacing(path) as file,
            zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=COMPRESSION) as archive,
        ):
            for name, value in entries.items():
                with archive.open(f"{name}.npy", "w", force_zip64=True) as entry:
                    np.lib.format.write_array(entry, np.asarray(value), allow_pickle=False)


def load_cloud(path: Path) -> DenseCloud:
    """Read a cloud that `DenseCloud.write` wrote as `.npz`, without loss.

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
            free = np.asarray(entries[FREE]) if FREE in entries else np.zeros((0, 3), dtype=np.int32)
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
        RuntimeError,  # zipfile, of what is encrypted, or of a version or compression that it does not know
    ) as error:
        raise MapError(f"{path}: damaged, or not a dense cloud; run again to make a new one") from error
    _check(path, arrays, voxel_m)
    if free.shape != (len(free), 3) or free.dtype != np.int32:
        raise MapError(f"{path}: damaged: {FREE} is {free.dtype} {free.shape}")
    return DenseCloud(**arrays, voxel_m=voxel_m, free=free)


def _check(path: Path, arrays: dict[str, Any], voxel_m: float) -> None:
    """Refuse arrays that later steps could not use.

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
