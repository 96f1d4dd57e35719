"""The pictures of a run: its evaluation, and its maps."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from stillroom.data.dense_cloud import DenseCloud
from stillroom.data.map import submaps
from stillroom.data.trajectory import Trajectory
from stillroom.evaluation.time_matching import TimeMatching
from stillroom.evaluation.trajectory_errors import AbsoluteError, Alignment, ate
from stillroom.pipeline.ornaments import Ornaments
from stillroom.system import System
from stillroom.viz.cloud.render import CloudRendererConfig
from stillroom.viz.cloud.view import default_view
from stillroom.viz.png import write_png
from stillroom.viz.sparse_map import draw_sparse_map
from stillroom.viz.trajectory_plots import plot_error, plot_from_above, plot_over_time

SPARSE_MAP, DENSE_MAP = "sparse_map.png", "dense_map.png"
ABOVE, OVER_TIME, ERROR = "trajectory_above.png", "trajectory_over_time.png", "error.png"


def draw_plots(
    folder: Path,
    estimates: Mapping[str, Trajectory],
    groundtruth: Trajectory,
    title: str,
    matching: TimeMatching | None = None,
    ornaments: Ornaments | None = None,
    formats: Sequence[str] = (),
) -> tuple[Path, ...]:
    """Draw trajectories against the ground truth, from above and over time, and their errors.

    Args:
        folder: Where to; it is made.
        estimates: Trajectories by their name in the legend, the evaluated one first.
        groundtruth: The true poses; only the part that the first estimate covers is drawn.
        title: Shown above.
        matching: How poses find each other in time.
        ornaments: Takes note of what cannot be drawn.
        formats: In which they are drawn beside PNG: "svg", "pdf".

    Returns:
        The files that were written.

    Raises:
        TrajectoryError: One of them cannot be compared with the ground truth.
    """
    matching, ornaments = matching or TimeMatching(), ornaments or Ornaments()
    compared = {
        name: ate(*matching.match(estimate, groundtruth), matching.max_gap_s) for name, estimate in estimates.items()
    }
    judged = next(iter(compared.values()))
    title += said_scales(compared)
    aligned = {name: error.aligned for name, error in compared.items()}
    errors = {name: (error.groundtruth.timestamps_s, error.errors_m) for name, error in compared.items()}
    drawn: list[Path] = []
    for path in as_formats(folder / ABOVE, formats):
        with ornaments.drawing():
            plot_from_above(path, aligned, judged.groundtruth, title)
            drawn.append(path)
    for path in as_formats(folder / OVER_TIME, formats):
        with ornaments.drawing():
            plot_over_time(path, aligned, judged.groundtruth, title)
            drawn.append(path)
    for path in as_formats(folder / ERROR, formats):
        with ornaments.drawing():
            plot_error(path, errors, judged.still_camera_m, title)
            drawn.append(path)
    return tuple(drawn)


def said_scales(compared: Mapping[str, AbsoluteError]) -> str:
    """Return what a title adds where trajectories are up to scale: that they are aligned by Sim(3), and the scales."""
    scaled = {name: error for name, error in compared.items() if error.alignment is Alignment.SIM3}
    if not scaled:
        return ""
    if len(compared) == 1:
        return f" – up to scale, aligned by Sim(3): × {next(iter(scaled.values())).scale:.4g}"
    scales = ", ".join(f"{name} × {error.scale:.4g}" for name, error in scaled.items())
    return f" – up to scale, aligned by Sim(3): {scales}"


def as_formats(path: Path, formats: Sequence[str]) -> list[Path]:
    """Return a plot's PNG file, and the files of the same name in other formats; pages show the first one."""
    return [path, *(path.with_suffix(f".{kind}") for kind in formats if f".{kind}" != path.suffix)]


def draw_maps(
    folder: Path,
    system: System,
    cloud: DenseCloud | None,
    title: str,
    ornaments: Ornaments | None = None,
    formats: Sequence[str] = (),
) -> None:
    """Draw the main sub-map, sparse and, where there is one, dense; nothing before there is a keyframe.

    Args:
        folder: Where to; it is made.
        system: Whose map it is.
        cloud: The dense map; None where there is none.
        title: Shown above.
        ornaments: Takes note of what cannot be drawn.
        formats: In which the sparse map is drawn beside PNG: "svg", "pdf". The dense one is pixels.
    """
    ornaments = ornaments or Ornaments()
    table, points, main = system.map.keyframes, system.map.points, system.main_submap
    keyframes = table.T_world_cam[table.is_alive & (table.submap == main)]
    if len(keyframes) == 0:
        return
    ids = np.flatnonzero(points.is_alive)
    ids = ids[submaps.of_points(ids, system.map) == main]
    for path in as_formats(folder / SPARSE_MAP, formats):
        with ornaments.drawing():
            draw_sparse_map(path, points.position_m[ids], keyframes, system.trajectory(), title=title)
    if cloud is not None and len(cloud):
        with ornaments.drawing():
            view = default_view(cloud, keyframes)
            write_png(folder / DENSE_MAP, CloudRendererConfig().build().render(cloud, view))
