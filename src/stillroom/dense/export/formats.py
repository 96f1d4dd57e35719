"""Every format that a dense map is exported to, by name."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path

from stillroom.data.dense_cloud import DenseCloud
from stillroom.dense.export.mesh import MeshConfig
from stillroom.dense.export.occupancy import OccupancyConfig
from stillroom.dense.export.octomap import write_octomap
from stillroom.errors import ConfigError

ALL = "all"


@dataclass(frozen=True)
class ExportConfig:
    """How a dense map is exported.

    Attributes:
        mesh: The mesh.
        occupancy: The floor plan.
    """

    mesh: MeshConfig = field(default_factory=MeshConfig)
    occupancy: OccupancyConfig = field(default_factory=OccupancyConfig)


@dataclass(frozen=True)
class WrittenFile:
    """A file that was written.

    Attributes:
        path: Where it is.
        content: What is in it, in words.
    """

    path: Path
    content: str


Write = Callable[[DenseCloud, Path, ExportConfig], list[WrittenFile]]
"""Writes a cloud into a folder, and says what."""


def _ply(cloud: DenseCloud, folder: Path, config: ExportConfig) -> list[WrittenFile]:
    cloud.write(folder / "cloud.ply")
    return [WrittenFile(folder / "cloud.ply", f"{len(cloud)} points")]


def _pcd(cloud: DenseCloud, folder: Path, config: ExportConfig) -> list[WrittenFile]:
    cloud.write(folder / "cloud.pcd")
    return [WrittenFile(folder / "cloud.pcd", f"{len(cloud)} points")]


def _mesh(cloud: DenseCloud, folder: Path, config: ExportConfig) -> list[WrittenFile]:
    mesh = config.mesh.build()(cloud)
    mesh.write_ply(folder / "mesh.ply")
    return [WrittenFile(folder / "mesh.ply", f"{len(mesh.triangles)} triangles, {len(mesh.positions_m)} vertices")]


def _occupancy(cloud: DenseCloud, folder: Path, config: ExportConfig) -> list[WrittenFile]:
    plan = config.occupancy.build()(cloud)
    picture, description, frame = plan.write(folder)
    height, width = plan.cells.shape
    return [
        WrittenFile(picture, f"{width} × {height} cells of {plan.resolution_m:g} m"),
        WrittenFile(
            description, f"{plan.floor.area_m2:.1f} m² of floor, {plan.floor.tilt_deg:.0f}° off the first camera"
        ),
        WrittenFile(frame, "T_map_world"),
    ]


def _octomap(cloud: DenseCloud, folder: Path, config: ExportConfig) -> list[WrittenFile]:
    n_voxels = write_octomap(cloud, folder / "map.bt")
    free = f", {len(cloud.free)} free ones" if len(cloud.free) else ""
    return [WrittenFile(folder / "map.bt", f"{n_voxels} voxels of {cloud.voxel_m:g} m{free}")]


FORMATS: dict[str, Write] = {"ply": _ply, "pcd": _pcd, "mesh": _mesh, "occupancy": _occupancy, "octomap": _octomap}


def chosen_formats(names: Iterable[str]) -> tuple[str, ...]:
    """Return the chosen formats, each once and in their order; `all` means all.

    Raises:
        ConfigError: There is no such format; the message names the nearest.
    """
    asked = {name.strip().lower() for name in names}
    for name in sorted(asked - {ALL, *FORMATS}):
        guess = get_close_matches(name, [*FORMATS, ALL], n=1, cutoff=0.0)[0]
        raise ConfigError(f"unknown format '{name}'; did you mean '{guess}'? There are {', '.join(FORMATS)} and {ALL}")
    return tuple(name for name in FORMATS if name in asked or ALL in asked)
