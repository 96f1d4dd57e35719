"""`stillroom map export`."""

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from stillroom.cli.map.check import MapPath
from stillroom.errors import ConfigError, StillroomError

if TYPE_CHECKING:
    from stillroom.storage.stored import StoredMap

TRAJECTORY, COLMAP, ALL = "trajectory", "colmap", "all"


def export(
    path: MapPath,
    format_: Annotated[
        list[str] | None,
        typer.Option(
            "--format",
            "-f",
            metavar="NAME,…",
            help="trajectory, colmap, or of the dense map ply, pcd, mesh, occupancy, octomap; or all; repeatable. "
            "\\[default: trajectory,colmap]",
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Write here. \\[default: a folder named like the map]")
    ] = None,
) -> None:
    """Turn a map file into files for other programs.

    Poses of frames and keyframes as .tum, the sparse map as COLMAP's text model. Dense formats are made from the images
    of keyframes, which a map keeps where it was made with --set storage.images=true.

        stillroom map export room.stillmap
        stillroom map export room.stillmap --format ply,mesh --out for_the_viewer
    """
    from stillroom.cli.output.console import show_log
    from stillroom.cli.output.tables import print_lines
    from stillroom.storage.reader import count_images, load_map

    show_log()
    names = _chosen(name.strip() for part in format_ or [f"{TRAJECTORY},{COLMAP}"] for name in part.split(","))
    stored = load_map(path)
    if ALL in names:
        names = [TRAJECTORY, COLMAP, *(_dense_formats() if count_images(path) else ())]
    folder = _made(out or path.with_suffix(""))
    for name in names:
        if name in (TRAJECTORY, COLMAP):
            print_lines(_write_sparse(name, stored, folder))
    dense = tuple(name for name in names if name not in (TRAJECTORY, COLMAP))
    if dense:
        print_lines(_write_dense(dense, path, stored, folder))


def _dense_formats() -> tuple[str, ...]:
    from stillroom.dense.export.formats import FORMATS

    return tuple(FORMATS)


def _chosen(names: Iterable[str]) -> list[str]:
    known = TRAJECTORY, COLMAP, *_dense_formats(), ALL
    chosen = list(dict.fromkeys(names))
    for name in chosen:
        if name not in known:
            raise ConfigError(f"--format {name}: no such format; known: {', '.join(known)}")
    return chosen


def _made(folder: Path) -> Path:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StillroomError(f"{folder}: cannot be made ({error.strerror}); choose another with --out") from error
    return folder


def _write_sparse(name: str, stored: "StoredMap", folder: Path) -> list[str]:
    from stillroom.storage.export.colmap import write_colmap
    from stillroom.storage.export.trajectory import write_trajectories

    if name == TRAJECTORY:
        return [f"{path}: {n} poses" for path, n in write_trajectories(stored, folder)]
    model = write_colmap(stored, folder)
    names = ", ".join(path.name for path in model.files)
    return [f"{folder}: {names}: {model.n_images} images, {model.n_points} points"]


def _write_dense(names: tuple[str, ...], path: Path, stored: "StoredMap", folder: Path) -> list[str]:
    from stillroom.dense.export.formats import FORMATS, ExportConfig
    from stillroom.pipeline.maps.dense import dense_cloud

    cloud = dense_cloud(path, stored)
    return [f"{w.path}: {w.content}" for name in names for w in FORMATS[name](cloud, folder, ExportConfig())]
