"""`stillroom map check`."""

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from stillroom.errors import ConfigError, MapError, StillroomError

# `stillroom map check`.


MapPath = Annotated[Path, typer.Argument(metavar="MAP", help="A map file, such as room.stillmap.")]
MOST_SHOWN = 20


def check(path: MapPath) -> None:
    """Check the consistency of a map file.

    Every observation's keyframe, point and keypoint must exist, every pose must be rigid, every number finite.

        stillroom map check room.stillmap
    """
    from stillroom.cli.output import print_error, print_lines
    from stillroom.storage.check import check_map

    problems = check_map(path)
    if not problems:
        print_lines([f"{path}: whole"])
        return
    print_lines(problems[:MOST_SHOWN])
    if len(problems) > MOST_SHOWN:
        print_lines([f"… and {len(problems) - MOST_SHOWN} more"])
    print_error(f"{path}: is damaged in {len(problems)} place{'s' if len(problems) > 1 else ''}")
    raise typer.Exit(1)


# `stillroom map export`.


if TYPE_CHECKING:
    from stillroom.storage.schema import StoredMap

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
            "\\[default: trajectory, and colmap where the map keeps images]",
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Write here. \\[default: a folder named like the map]")
    ] = None,
) -> None:
    """Export a map file for other programs.

    Poses of frames and keyframes as .tum; the sparse map as COLMAP's text model with its images, undistorted. COLMAP's
    model and dense formats need the images of keyframes, which a map keeps where it was made with
    --set storage.images=true.

        stillroom map export room.stillmap
        stillroom map export room.stillmap --format ply,mesh --out for_the_viewer
    """
    from stillroom.cli.output import print_lines, show_log
    from stillroom.storage.map_export import no_images
    from stillroom.storage.reader import count_images, load_map

    show_log()
    names = _chosen(name.strip() for part in format_ or (TRAJECTORY,) for name in part.split(","))
    stored, has_images = load_map(path), count_images(path) > 0
    if ALL in names:
        names = [TRAJECTORY, *((COLMAP, *_dense_formats()) if has_images else ())]
    elif format_ is None and has_images:
        names = [TRAJECTORY, COLMAP]
    if COLMAP in names and not has_images:
        raise MapError(f"{path}: {no_images('a COLMAP model', stored.world.sensor)}")
    folder = _made(out or path.with_suffix(""))
    for name in names:
        if name in (TRAJECTORY, COLMAP):
            print_lines(_write_sparse(name, path, stored, folder))
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


def _write_sparse(name: str, path: Path, stored: "StoredMap", folder: Path) -> list[str]:
    from stillroom.storage.map_export import write_colmap, write_trajectories
    from stillroom.storage.reader import keyframe_images

    if name == TRAJECTORY:
        return [f"{path}: {n} poses" for path, n in write_trajectories(stored, folder)]
    model = write_colmap(stored, keyframe_images(path), folder)
    names = ", ".join(path.name for path in model.files)
    without = f"; {model.n_without_image} keyframes without an image left out" if model.n_without_image else ""
    return [
        f"{folder}: {names}: {model.n_images} images, {model.n_points} points{without}",
        f"{model.images}: their images, undistorted",
    ]


def _write_dense(names: tuple[str, ...], path: Path, stored: "StoredMap", folder: Path) -> list[str]:
    from stillroom.dense.export.formats import FORMATS, ExportConfig
    from stillroom.session.map_file import dense_cloud

    cloud = dense_cloud(path, stored)
    return [f"{w.path}: {w.content}" for name in names for w in FORMATS[name](cloud, folder, ExportConfig())]


# `stillroom map info`.


if TYPE_CHECKING:
    from stillroom.storage.schema import StoredMap


def info(path: MapPath) -> None:
    """Show what a map file holds: the runs that made it, keyframes, points, camera.

    stillroom map info room.stillmap
    """
    from stillroom.cli.output import print_lines, print_table
    from stillroom.data.map import submaps
    from stillroom.storage.opening import inspect
    from stillroom.storage.reader import count_images, load_map

    version = inspect(path).version
    stored, n_images = load_map(path), count_images(path)
    world, camera = stored.world, stored.camera
    n_alive, n_all = len(world.alive_keyframes()), len(world.keyframes)
    n_points, n_seen = int(world.points.is_alive.sum()), int((world.keypoints.point >= 0).sum())
    megabytes = path.stat().st_size * 1e-6
    n_submaps = len(submaps.unjoined(world))
    print_lines(
        [
            f"{path}: map format {version}, {megabytes:.1f} MB, of {world.sensor.words} images"
            + ("" if world.sensor.is_metric else "; lengths are up to a factor"),
            f"{n_alive} keyframes ({n_all - n_alive} more were culled), {n_points} points seen {n_seen} times; "
            f"{n_submaps} sub-map{'' if n_submaps == 1 else 's'}, {len(world.loop_edges)} loops closed",
            f"camera: {camera.width}×{camera.height}, fx {camera.fx:g}, fy {camera.fy:g}, cx {camera.cx:g}, "
            f"cy {camera.cy:g}; {world.scales.count} pyramid levels of {world.scales.factor:g}",
            f"images of {n_images} keyframes, for dense maps" if n_images else "no images of keyframes",
        ]
    )
    header = "run", "sequence", "method", "started", "Stillroom", "keyframes", "frames", "images"
    print_table(header, _rows(stored), n_words=5)


def _rows(stored: "StoredMap") -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    alive = stored.world.alive_keyframes()
    edges = [session.first_keyframe for session in stored.sessions]
    ends = [*edges[1:], len(stored.world.keyframes)]
    for number, (session, first, end) in enumerate(zip(stored.sessions, edges, ends, strict=True)):
        frames = [frame.image_index for frame in stored.frames if frame.session == number]
        span = f"{min(frames)} to {max(frames)}" if frames else "none"
        n_keyframes = int(((alive >= first) & (alive < end)).sum())
        words = str(number), session.sequence, session.method, session.started, session.stillroom
        rows.append((*words, str(n_keyframes), str(len(frames)), span))
    return rows


# `stillroom map`: show, check and export a map file.


HELP = "Show what a map file holds, check it, and export it for other programs."

app = typer.Typer(no_args_is_help=True, help=HELP)
for command in (info, check, export):
    app.command()(command)
