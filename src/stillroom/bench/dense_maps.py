"""The dense map of a run, made twice in one pass: with and without removing dynamic points."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from stillroom.bounds import in_pixels_of
from stillroom.config import SlamConfig
from stillroom.data.dense_cloud import DenseCloud
from stillroom.data.map import submaps
from stillroom.data.result import FrameResult, Tracked
from stillroom.data.semantics import Semantics
from stillroom.dense.dense_mapper import DenseMapper, DenseMapperConfig
from stillroom.dense.no_dense_map import NoDenseMapConfig
from stillroom.errors import FrameError, TrajectoryError
from stillroom.evaluation.ghost_truth import TrueScene, ghosts_by_truth
from stillroom.evaluation.ghost_views import DepthView
from stillroom.evaluation.ghosts import (
    CompletenessFigure,
    FreeSpaceConfig,
    Gatherer,
    GhostFigure,
    SurfaceFigure,
    completeness,
    empty_room,
    ghosts_in_free_space,
    seen_again,
)
from stillroom.evaluation.report import percent
from stillroom.geometry import se3
from stillroom.geometry.align import align_poses
from stillroom.geometry.arrays import F64, Floats
from stillroom.pipeline import SILENT, RunProgress
from stillroom.protocols import Dataset, Parts, RenderedDataset, RunObserver
from stillroom.session.slam import Slam
from stillroom.system import System

HEADER = ("dense map", "points", "ghosts", "suspects", "complete", "error median", "astray")
"""Names of the columns of `MapFigures.row`."""
NONE = "–"
TRUTH_EVERY = 2
TRUTH_REACH_M = 5.0
"""Surfaces further from the camera do not count; the map need not hold them."""
WITH_REMOVAL, WITHOUT_REMOVAL = "with removal", "without"
REFERENCE_VIEWS, MAPPED_VIEWS = 40, 80
"""Number of images that are compared in each stretch, evenly spread."""


@dataclass(frozen=True)
class DenseMaps:
    """The dense maps of a run.

    Attributes:
        clouds: The maps by how dynamic points were treated, `WITH_REMOVAL` and `WITHOUT_REMOVAL`.
        T_world_cam: The final pose (4, 4) of each tracked image, by its number.
        n_given: Images that the run was given.
        points_m: The points of the sparse map (P, 3) [m, world], those of the main sub-map.
    """

    clouds: dict[str, DenseCloud]
    T_world_cam: dict[int, F64] = field(repr=False)
    n_given: int
    points_m: F64 = field(default_factory=lambda: np.zeros((0, 3)), repr=False)


def dense_maps(
    dataset: Dataset,
    config: SlamConfig,
    dense: DenseMapperConfig,
    mapped: range,
    progress: RunProgress = SILENT,
    observers: Sequence[RunObserver] = (),
) -> DenseMaps:
    """Run a method over a sequence and map some of its images.

    Both maps are of the same keyframes with the same poses, and get the same mask of dynamic pixels.

    Args:
        dataset: The sequence; all of it is tracked.
        config: The method.
        dense: The dense map.
        mapped: Numbers of the images that the maps are made of, and carved with; no other ever touches them.
        progress: Called for each frame.
        observers: Called with each frame too.

    Raises:
        KeyboardInterrupt: The user stopped it: half a map has no figures to compare.
        StillroomError: Something that the run needs is wrong; a single image that cannot be read is not.
    """
    mapping = _Twins(mapped)
    slam = Slam(replace(config, dense=NoDenseMapConfig()), dataset.camera, observers=[mapping, *observers])
    system = slam.system
    for name, removal in ((WITH_REMOVAL, True), (WITHOUT_REMOVAL, False)):
        one = replace(dense, carving=replace(dense.carving, removal=removal))
        mapping.mappers[name] = in_pixels_of(one, dataset.camera.pixel_scale).build(Parts(dataset.camera, system.map))
    with slam:
        progress.start(len(dataset))
        try:
            _track_all(dataset, slam, progress)
        finally:
            progress.finish()
    for mapper in mapping.mappers.values():
        mapper.refresh()
    clouds = {name: mapper.cloud() for name, mapper in mapping.mappers.items()}
    return DenseMaps(clouds, _final_poses(system), len(dataset), _sparse_points(system))


class _Twins:
    """Hands each mapped frame to both mappers, as the system does with its own."""

    def __init__(self, mapped: range) -> None:
        self._mapped = mapped
        self.mappers: dict[str, DenseMapper] = {}

    def on_frame(self, tracked: Tracked, semantics: Semantics, result: FrameResult) -> None:
        if result.index not in self._mapped or tracked.T_world_cam is None:
            return
        image, moving = tracked.frame.image, tracked.motion.moving
        for mapper in self.mappers.values():
            if result.is_keyframe:
                mapper.integrate(result.reference_keyframe, image, moving)
            else:
                mapper.carve(image, tracked.T_world_cam, moving)


def _track_all(dataset: Dataset, slam: Slam, progress: RunProgress) -> None:
    for place in range(len(dataset)):
        try:
            result = slam.process(dataset.load(place))
        except FrameError:
            progress.frame(None)
            continue
        progress.frame(result)


def _final_poses(system: System) -> dict[int, F64]:
    return {
        result.index: system.map.keyframe_pose(result.reference_keyframe) @ result.T_reference_cam
        for result in system.results
        if result.T_reference_cam is not None
    }


def _sparse_points(system: System) -> F64:
    ids = np.flatnonzero(system.map.points.is_alive)
    in_main = submaps.of_points(ids, system.map) == system.main_submap
    return np.asarray(system.map.points.position_m[ids[in_main]], dtype=np.float64)


# The figures of one dense map.


@dataclass(frozen=True)
class MapFigures:
    """The figures of one map.

    Attributes:
        name: How dynamic points were treated.
        ghosts: What is left of moving objects.
        complete: How much of the room it covers.
        surface: Surface error of the other points; None on real data.
    """

    name: str
    ghosts: GhostFigure
    complete: CompletenessFigure
    surface: SurfaceFigure | None = None

    def row(self) -> tuple[str, ...]:
        """Return the cells under `HEADER`."""
        ghosts, error, astray = self.ghosts, NONE, NONE
        suspects = ghosts.n_suspects / ghosts.n_points if ghosts.n_points else 0.0
        if self.surface is not None:
            astray = percent(self.surface.n_astray / ghosts.n_points if ghosts.n_points else 0.0)
            error = NONE if self.surface.error_m is None else f"{self.surface.error_m.median * 1e3:.1f} mm"
        shares = f"{ghosts.share * 100:.2f} %", percent(suspects), percent(self.complete.share)
        return (self.name, str(ghosts.n_points), *shares, error, astray)

    def to_dict(self) -> dict[str, Any]:
        """Return the figures for a JSON file."""
        surface = None if self.surface is None else self.surface.to_dict()
        figures = {"ghosts": self.ghosts.to_dict(), "completeness": self.complete.to_dict(), "surface": surface}
        return {"map": self.name} | figures


# Two ways to evaluate a dense map: against the renderer's truth, and against earlier images of the empty room.


class RealJudge:
    """Compares maps with what earlier images of the same sequence saw of the empty room."""

    def __init__(self, dataset: Dataset, poses: dict[int, F64], reference: range, mapped: range) -> None:
        """Load the images to compare with.

        Args:
            dataset: The sequence.
            poses: `T_world_cam` (4, 4) of its images by number, of the run that made the maps.
            reference: Numbers of the images of the empty room.
            mapped: Numbers of those that the maps are made of.

        Raises:
            TrajectoryError: None of either could be tracked.
        """
        self._camera, self._config = dataset.camera, FreeSpaceConfig()
        self._reference = _views(dataset, poses, reference, REFERENCE_VIEWS)
        room = empty_room(self._reference, self._camera, self._config)
        later = _views(dataset, poses, mapped, MAPPED_VIEWS)
        self._surface_m = seen_again(room, later, self._camera, self._config)

    def judge(self, name: str, points_m: Floats) -> MapFigures:
        """Return the figures of a map (N, 3) [m, world]."""
        ghosts = ghosts_in_free_space(points_m, self._reference, self._camera, self._config)
        return MapFigures(name, ghosts, completeness(points_m, self._surface_m))

    def control(self) -> GhostFigure:
        """Compare the later half of the empty room's images with the earlier: the error of the measure itself."""
        half = len(self._reference) // 2
        gatherer = Gatherer(self._camera)
        for view in self._reference[half:]:
            gatherer.add(view.depth_m, view.T_world_cam, reach_m=self._config.reach_m)
        return ghosts_in_free_space(gatherer.points(), self._reference[:half], self._camera, self._config)

    def sentences(self) -> list[str]:
        """Return notes on how to read the rows."""
        config, control = self._config, self.control()
        return [
            f"ghosts: points that at least {config.min_rays} of {len(self._reference)} images of the empty room look "
            f"past by more than {config.tolerance_m * 100:.0f} cm and {config.tolerance_share * 100:.0f} % of the "
            "depth, and on which fewer than three see a surface; suspects: those that they look past, surface or not",
            f"complete: of the {len(self._surface_m)} places of the empty room's surface that the mapped images see "
            "again, those with a point of the map within 5 cm",
            f"the empty room itself, its later images compared with its earlier ones, has {control.share * 100:.2f} % "
            f"ghosts and {percent(control.n_suspects / max(1, control.n_points))} suspects",
        ]


class TruthJudge:
    """Compares maps of a rendered sequence with the renderer's truth."""

    def __init__(self, room: RenderedDataset, poses: dict[int, F64], mapped: range) -> None:
        """Render the truth.

        Args:
            room: The sequence.
            poses: `T_world_cam` (4, 4) of its images by number, of the run that made the maps.
            mapped: Numbers of the images that the maps are made of.

        Raises:
            TrajectoryError: None of them could be tracked.
        """
        self._scene = true_scene(room, mapped)
        numbers = [number for number in poses if number in mapped]
        if not numbers:
            raise TrajectoryError(f"{room.name}: none of the images to map was tracked; there is no map to evaluate")
        true_poses = np.stack([room.pose(number) for number in numbers])
        self._T_true_map = align_poses(np.stack([poses[number] for number in numbers]), true_poses)

    def judge(self, name: str, points_m: Floats) -> MapFigures:
        """Return the figures of a map (N, 3) [m, the run's world]."""
        points = se3.transform(self._T_true_map, np.asarray(points_m, dtype=np.float64))
        ghosts, surface = ghosts_by_truth(points, self._scene)
        return MapFigures(name, ghosts, completeness(points, self._scene.seen_m), surface)

    def sentences(self) -> list[str]:
        """Return notes on how to read the rows."""
        return [
            "ghosts: points further than 5 cm from the true static surface, where something was that moved; suspects: "
            "further than that anywhere; astray: where nothing moved; error: of all points but ghosts; an object that "
            "people moved is static where it was left",
            f"complete: of the {len(self._scene.seen_m)} places of the static surface that the camera sees within "
            f"{TRUTH_REACH_M:.0f} m, those with a point of the map within 5 cm",
        ]


def true_scene(room: RenderedDataset, mapped: range) -> TrueScene:
    """Collect the true static surface, and what moved in front of it, over some of the images."""
    remains = room.remains(mapped[-1])
    static, movers = Gatherer(room.camera), Gatherer(room.camera)
    for index in mapped[::TRUTH_EVERY]:
        truth = room.truth(index)
        stays = remains.stays(truth.instance, float(room.timestamps_s[index]))
        static.add(truth.depth_m, truth.T_world_cam, stays, TRUTH_REACH_M)
        movers.add(truth.depth_m, truth.T_world_cam, ~stays)
    return TrueScene(remains.patches_m, remains.is_triangle, static.points(), movers.points())


def _views(dataset: Dataset, poses: dict[int, F64], stretch: range, most: int) -> list[DepthView]:
    """Load depth images of a stretch that have poses, evenly spread; those that cannot be read are left out."""
    tracked = [number for number in stretch if number in poses]
    if not tracked:
        raise TrajectoryError(
            f"{dataset.name}: none of the images {stretch.start}:{stretch.stop} was tracked; nothing to compare with"
        )
    places = np.unique(np.linspace(0, len(tracked) - 1, min(most, len(tracked))).astype(np.int64))
    views = []
    for number in (tracked[place] for place in places):
        try:
            views.append(DepthView(dataset.load(number).depth_m, poses[number]))
        except FrameError:
            continue
    return views
