"""`stillroom export`: the dense map of a run, for other programs."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from stillroom.errors import MapError, StillroomError

if TYPE_CHECKING:
    from stillroom.data.dense_cloud import DenseCloud
    from stillroom.dense.export.formats import ExportConfig, WrittenFile

DEFAULT_FOLDER = Path("results/latest")
UNITS = ("bytes", "KB", "MB", "GB")


def export(
    folder: Annotated[
        Path | None, typer.Argument(metavar="RESULTS", help="Results of a run. \\[default: results/latest]")
    ] = None,
    format_: Annotated[
        list[str] | None,
        typer.Option(
            "--format",
            "-f",
            metavar="NAME,…",
            help="ply, pcd, mesh, occupancy, octomap, or all; repeatable. \\[default: all]",
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Write here. \\[default: the folder of the run]")
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Such as occupancy.resolution_m=0.1; repeatable."),
    ] = None,
) -> None:
    """Export the dense map of a run for other programs.

    Points as cloud.ply and cloud.pcd, a mesh as mesh.ply, a floor plan for robots as map.pgm and map.yaml, an octree as
    map.bt. 'export pspnet' and 'export yolo' make ONNX files of networks.

        stillroom export results/latest
        stillroom export results/latest --format mesh,occupancy --out for_the_robot
    """
    from stillroom.cli.output import show_log
    from stillroom.config import with_overrides
    from stillroom.data.dense_cloud import NAME, load_cloud
    from stillroom.dense.export.formats import ALL, ExportConfig, chosen_formats
    from stillroom.pipeline.results import results_folder

    show_log()
    names = chosen_formats(name for part in format_ or [ALL] for name in part.split(","))
    config = with_overrides(ExportConfig(), settings or ())
    config.occupancy.build()  # now: contradicting values are reported before anything is written
    results = results_folder(folder or DEFAULT_FOLDER)
    if not (results / NAME).exists():
        shown = folder or DEFAULT_FOLDER
        raise MapError(
            f"{shown}: this run has no dense map; run with --method oc-slam or --set dense.kind=voxels; "
            "pairs of images need --set stereo.dense=sgbm too, and those of a single camera make none"
        )
    cloud = load_cloud(results / NAME)
    if len(cloud) == 0:
        raise MapError(f"{results / NAME}: the dense map is empty; there is nothing to export")
    if not _write_each(cloud, names, _made(out) if out is not None else results, config):
        raise typer.Exit(1)


def _write_each(cloud: "DenseCloud", names: tuple[str, ...], place: Path, config: "ExportConfig") -> bool:
    """Write every format, even if others fail; return whether all succeeded."""
    from stillroom.cli.output import print_error, print_lines
    from stillroom.dense.export.formats import FORMATS

    all_well = True
    for name in names:
        try:
            written = FORMATS[name](cloud, place, config)
        except StillroomError as error:
            print_error(f"{name}: {error}")
            all_well = False
        else:
            print_lines(map(_sentence, written))
    return all_well


def _made(folder: Path) -> Path:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StillroomError(f"{folder}: cannot be made ({error.strerror}); choose another folder") from error
    return folder


def _sentence(written: "WrittenFile") -> str:
    path = written.path
    shown = path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path
    return f"{shown}: {written.content}, {_size(path.stat().st_size)}"


def _size(n_bytes: int) -> str:
    power = min(len(UNITS) - 1, max(0, (len(str(n_bytes)) - 1) // 3))
    return f"{n_bytes} bytes" if power == 0 else f"{n_bytes / 1000**power:.1f} {UNITS[power]}"
