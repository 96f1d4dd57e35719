"""The papers' figures, drawn of our runs."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from stillroom.bench.accuracy import Accuracy
from stillroom.bench.dense_maps import WITH_REMOVAL, WITHOUT_REMOVAL
from stillroom.bench.geometry_table import GeometryTable, write_geometry_picture
from stillroom.bench.paper.portraits import Portrait, Portraits
from stillroom.bench.paper.published import Paper
from stillroom.bench.paper.runs import SequenceRuns, file_name
from stillroom.data.dense_cloud import DenseCloud
from stillroom.data.trajectory import Trajectory
from stillroom.evaluation.time_matching import TimeMatching
from stillroom.evaluation.trajectory_errors import AbsoluteError, ate
from stillroom.geometry.arrays import U8
from stillroom.geometry.camera import Camera
from stillroom.pipeline.ornaments import ending_nothing
from stillroom.pipeline.plots import as_formats
from stillroom.viz.bar_plots import plot_bars
from stillroom.viz.cloud.frame_clouds import draw_cluster_cloud, points_as_cloud
from stillroom.viz.cloud.render import STRIP, CloudRendererConfig, write_panels
from stillroom.viz.cloud.view import Viewpoint, default_view
from stillroom.viz.clusters import draw_clusters, draw_detections
from stillroom.viz.film import contact_sheet
from stillroom.viz.png import write_png
from stillroom.viz.recorder import draw_verdict
from stillroom.viz.trajectory_plots import plot_error, plot_from_above

SCALE = 2.0
"""How much larger than the image a picture of it is."""
SHEET_PX = 800
"""Width of one picture of a sheet."""
MAP_PX = (960, 640)
"""Width and height of a map beside others."""
POINT_M = 0.022
"""Edge of what a point of the sparse map is drawn as."""
SPARSE_RGB = np.array((214, 60, 48), dtype=np.uint8)
"""Of these points: red, as in the paper."""
STATISTICS = ("median", "mean", "min", "max")


@dataclass
class Figures:
    """Draws into a folder; a picture that fails is a warning.

    Attributes:
        folder: Where to.
        formats: In which plots are drawn beside PNG: "svg", "pdf". Pictures are pixels, and PNG only.
        drawn: The PNG files, each with its caption.
    """

    folder: Path
    formats: Sequence[str] = ()
    drawn: list[tuple[Path, str]] = field(default_factory=list)

    def picture(self, name: str, caption: str, draw: Callable[[], U8 | None]) -> None:
        """Write a picture (H, W, 3); nothing where there is nothing to show."""
        path = self.folder / f"{name}.png"
        with ending_nothing(f"{path.name} is left out"):
            shown = draw()
            if shown is not None:
                write_png(path, shown)
                self.drawn.append((path, caption))

    def plot(self, name: str, caption: str, draw: Callable[[Path], None]) -> None:
        """Draw a plot as PNG, and in the other formats."""
        path = self.folder / f"{name}.png"
        with ending_nothing(f"{path.name} is left out"):
            for each in as_formats(path, self.formats):
                draw(each)
            self.drawn.append((path, caption))


# OC-SLAM: frames, maps, errors over time.


def draw_portraits(figures: Figures, sequence: str, seen: Portraits) -> None:
    """Draw Figures 3, 5, 7, 9, 11 and 12 of a sequence.

    Differs from the paper: Figure 9 shows the maps of the whole sequence as the camera of the frame sees them, for a
    single frame has no map; whether a sequence is Figure 11 (static) or 12 is the reader's to say.
    """
    end, frames = file_name(sequence), seen.frames
    draws: tuple[tuple[str, str, Callable[[Portrait], U8 | None]], ...] = (
        ("3_detections", "Figure 3: boxes with their confidence", _detections),
        ("5_features", "Figure 5: static features green, dynamic ones red", _verdict),
        ("7_clusters", "Figure 7: clusters in the image and in space", lambda one: _clusters(one, seen.camera)),
    )
    for name, caption, draw in draws:
        figures.picture(f"figure_{name}_{end}", f"{caption}; {sequence}", _sheet(frames, draw))
    renderer = CloudRendererConfig(two_sided=True).build()
    figures.picture(
        f"figure_9_removal_{end}",
        f"Figure 9: colour, the dense map, and the map without what moves, as the camera sees them; {sequence}",
        lambda: _as_the_camera_sees(seen, renderer.render),
    )
    if len(seen.maps.clouds[WITH_REMOVAL]):
        caption = f"Figures 11 and 12: the sparse map, the dense one, and that without what moves; {sequence}"
        figures.plot(f"figure_11_12_maps_{end}", caption, lambda path: _draw_maps(path, seen))


def _sheet(frames: Sequence[Portrait], draw: Callable[[Portrait], U8 | None]) -> Callable[[], U8 | None]:
    def make() -> U8 | None:
        pictures = [(f"image {one.image.index}", draw(one)) for one in frames]
        columns = [(label, (picture,)) for label, picture in pictures if picture is not None]
        return contact_sheet(columns, SHEET_PX, per_row=2) if columns else None

    return make


def _detections(one: Portrait) -> U8:
    return draw_detections(one.image.rgb, one.semantics, SCALE)


def _verdict(one: Portrait) -> U8:
    return draw_verdict(
        one.image.rgb, one.keypoints_raw_px, one.is_static, one.is_matched, one.semantics, one.moving, SCALE
    )


def _clusters(one: Portrait, camera: Camera) -> U8 | None:
    clusters = one.semantics.clusters
    if clusters is None or len(clusters) == 0:
        return None
    flat = draw_clusters(one.image.rgb, clusters, one.semantics, one.moving, SCALE)
    deep = draw_cluster_cloud(one.image, camera, clusters, one.semantics, one.moving, flat.shape[1])
    return np.concatenate((flat, _fitting(deep, flat.shape[0], flat.shape[1])))


def _fitting(picture: U8, height: int, width: int) -> U8:
    return np.asarray(cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _as_the_camera_sees(seen: Portraits, render: Callable[[DenseCloud, Viewpoint], U8]) -> U8 | None:
    poses, clouds, camera = seen.maps.T_world_cam, seen.maps.clouds, seen.camera
    frames = [one for one in seen.frames if one.image.index in poses]
    if not frames or not len(clouds[WITH_REMOVAL]):
        return None
    pinhole = Camera(camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
    views = [Viewpoint(poses[one.image.index], pinhole) for one in frames]
    columns = [
        ("images " + " and ".join(str(one.image.index) for one in frames), tuple(one.image.rgb for one in frames)),
        ("everything fused", tuple(render(clouds[WITHOUT_REMOVAL], view) for view in views)),
        ("without what moves", tuple(render(clouds[WITH_REMOVAL], view) for view in views)),
    ]
    return contact_sheet(columns, SHEET_PX * 2 // 3, per_row=3)


def _draw_maps(path: Path, seen: Portraits) -> None:
    clean, everything = seen.maps.clouds[WITH_REMOVAL], seen.maps.clouds[WITHOUT_REMOVAL]
    width, height = MAP_PX
    strip = round(STRIP * height)
    poses = np.stack(list(seen.maps.T_world_cam.values()))
    view = default_view(clean, poses, width, height - strip).with_strip_below(strip)
    sparse = points_as_cloud(seen.maps.points_m, SPARSE_RGB, POINT_M)
    plain = CloudRendererConfig(gap_px=0.0, two_sided=True, supersampling=3).build()
    dense = CloudRendererConfig().build()
    panels = [plain.render(sparse, view), dense.render(everything, view), dense.render(clean, view)]
    notes = [f"{len(cloud):,} points".replace(",", "\u202f") for cloud in (sparse, everything, clean)]
    write_panels(path, panels, ("sparse map", "dense map", "without what moves"), notes)


def draw_errors(figures: Figures, paper: Paper, found: SequenceRuns) -> None:
    """Draw Figure 10 of a sequence: the error over time of every system's first run, without loop closing."""
    compared = dict(_compared(paper, found, no_loops=True))
    if not compared:
        return
    first = next(iter(compared.values()))
    errors = {name: (one.groundtruth.timestamps_s, one.errors_m) for name, one in compared.items()}
    figures.plot(
        f"figure_10_errors_{file_name(found.asked.name)}",
        f"Figure 10: error over time, loop closing off; {found.asked.name}",
        lambda path: plot_error(path, errors, first.still_camera_m, found.asked.name),
    )


# PSPNet-SLAM: geometry, trajectories, bars.


def draw_geometry(figures: Figures, sequence: str, table: GeometryTable, camera: Camera) -> None:
    """Draw Figures 5 and 6: compensation, and the ants' path, in an image in which much moves."""
    if table.shown is None:
        return
    path = figures.folder / f"figure_5_6_geometry_{file_name(sequence)}.png"
    with ending_nothing(f"{path.name} is left out"):
        write_geometry_picture(path, table.shown, camera)
        figures.drawn.append((path, f"Figures 5 and 6: compensation and the ants' path; {sequence}"))


def draw_paths(figures: Figures, paper: Paper, found: SequenceRuns) -> None:
    """Draw Figures 7 and 8 of a sequence: the first run of every system, and the truth, from above."""
    compared = dict(_compared(paper, found))
    if not compared:
        return
    truth = max((one.groundtruth for one in compared.values()), key=len)
    figures.plot(
        f"figure_7_8_trajectories_{file_name(found.asked.name)}",
        f"Figures 7 and 8: trajectories from above; {found.asked.name}",
        lambda path: plot_from_above(
            path, {name: one.aligned for name, one in compared.items()}, truth, found.asked.name
        ),
    )


def draw_bars(figures: Figures, paper: Paper, found: Sequence[SequenceRuns]) -> None:
    """Draw Figure 9: median, mean, least and largest RMSE of each system over its runs, for each sequence."""
    panels = {}
    for one in found:
        spreads = {
            system: runs.accuracy.ate_m
            for system in paper.systems
            if (runs := one.of(system)) is not None and runs.accuracy is not None
        }
        known = {system: spread for system, spread in spreads.items() if spread is not None}
        if known:
            panels[one.asked.name] = {
                system: [getattr(spread, name) for name in STATISTICS] for system, spread in known.items()
            }
    if panels:
        figures.plot(
            "figure_9_bars",
            "Figure 9: median, mean, least and largest RMSE of the ATE over the runs",
            lambda path: plot_bars(path, panels, STATISTICS, "RMSE [m]"),
        )


def _compared(paper: Paper, found: SequenceRuns, no_loops: bool = False) -> Iterator[tuple[str, AbsoluteError]]:
    """Yield the error of each system's first run; with `no_loops`, of that without loop closing."""
    for system in paper.systems:
        runs = found.of(system)
        if runs is None or found.truth is None:
            continue
        trajectory = _comparable((runs.without_loops if no_loops else runs).accuracy)
        if trajectory is not None:
            estimate, truth = TimeMatching().match(trajectory, found.truth)
            yield system, ate(estimate, truth)


def _comparable(accuracy: Accuracy | None) -> Trajectory | None:
    """Return the first run's trajectory; None where it has no errors."""
    first = None if accuracy is None else accuracy.trials[0]
    return None if first is None or first.evaluation is None else first.trajectory
