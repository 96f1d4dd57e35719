"""Two ways to judge a dense map: by the renderer's truth, and by what earlier images saw of the empty room."""

import numpy as np

from stillroom.benchmark.map_figures import MapFigures
from stillroom.errors import FrameError, TrajectoryError
from stillroom.evaluation.ghosts import (
    DepthView,
    FreeSpaceConfig,
    Gatherer,
    GhostFigure,
    TrueScene,
    completeness,
    empty_room,
    ghosts_by_truth,
    ghosts_in_free_space,
    seen_again,
)
from stillroom.evaluation.report import percent
from stillroom.geometry import se3
from stillroom.geometry.align import align_poses
from stillroom.geometry.arrays import F64, Floats
from stillroom.protocols import Dataset, RenderedDataset

REFERENCE_VIEWS, MAPPED_VIEWS = 40, 80
"""So many images of each stretch are asked, evenly spread."""
TRUTH_EVERY = 2
TRUTH_REACH_M = 5.0
"""Surfaces further from the camera are not asked for; the map need not hold them."""


class RealJudge:
    """Holds maps against what earlier images of the same sequence saw of the empty room."""

    def __init__(self, dataset: Dataset, poses: dict[int, F64], reference: range, mapped: range) -> None:
        """Load the images that are asked.

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
        """Hold the later half of the empty room's images against the earlier: what the measure itself gets wrong."""
        half = len(self._reference) // 2
        gatherer = Gatherer(self._camera)
        for view in self._reference[half:]:
            gatherer.add(view.depth_m, view.T_world_cam, reach_m=self._config.reach_m)
        return ghosts_in_free_space(gatherer.points(), self._reference[:half], self._camera, self._config)

    def sentences(self) -> list[str]:
        """Return what the rows must be read with."""
        config, control = self._config, self.control()
        return [
            f"ghosts: points that at least {config.min_rays} of {len(self._reference)} images of the empty room look "
            f"past by more than {config.tolerance_m * 100:.0f} cm and {config.tolerance_share * 100:.0f} % of the "
            "depth, and on which fewer than three see a surface; suspects: those that they look past, surface or not",
            f"complete: of the {len(self._surface_m)} places of the empty room's surface that the mapped images see "
            "again, those with a point of the map within 5 cm",
            f"the empty room itself, its later images held against its earlier ones, has {control.share * 100:.2f} % "
            f"ghosts and {percent(control.n_suspects / max(1, control.n_points))} suspects",
        ]


class TruthJudge:
    """Holds maps of a rendered sequence against the renderer's truth."""

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
            raise TrajectoryError(f"{room.name}: none of the images to map was tracked; there is no map to judge")
        true_poses = np.stack([room.pose(number) for number in numbers])
        self._T_true_map = align_poses(np.stack([poses[number] for number in numbers]), true_poses)

    def judge(self, name: str, points_m: Floats) -> MapFigures:
        """Return the figures of a map (N, 3) [m, the run's world]."""
        points = se3.transform(self._T_true_map, np.asarray(points_m, dtype=np.float64))
        ghosts, surface = ghosts_by_truth(points, self._scene)
        return MapFigures(name, ghosts, completeness(points, self._scene.seen_m), surface)

    def sentences(self) -> list[str]:
        """Return what the rows must be read with."""
        return [
            "ghosts: points further than 5 cm from the true static surface, where something was that moved; suspects: "
            "further than that anywhere; astray: where nothing moved; error: of all points but ghosts; a thing that "
            "somebody moved is static where he left it",
            f"complete: of the {len(self._scene.seen_m)} places of the static surface that the camera sees within "
            f"{TRUTH_REACH_M:.0f} m, those with a point of the map within 5 cm",
        ]


def true_scene(room: RenderedDataset, mapped: range) -> TrueScene:
    """Gather what the renderer knows of the static surface and of what moved before it, over some of the images."""
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
            f"{dataset.name}: none of the images {stretch.start}:{stretch.stop} was tracked; there is nothing to judge"
        )
    places = np.unique(np.linspace(0, len(tracked) - 1, min(most, len(tracked))).astype(np.int64))
    views = []
    for number in (tracked[place] for place in places):
        try:
            views.append(DepthView(dataset.load(number).depth_m, poses[number]))
        except FrameError:
            continue
    return views
