"""The dense map of a run, made twice at once: with and without the removal of what moves."""

from dataclasses import dataclass, field, replace

import cv2

from stillroom.config import SlamConfig
from stillroom.data.cloud.dense_cloud import DenseCloud
from stillroom.data.result import FrameResult, Tracked
from stillroom.data.semantics import Semantics
from stillroom.dense.dense_mapper import DenseMapper, DenseMapperConfig
from stillroom.dense.nothing import NoDenseMapConfig
from stillroom.errors import FrameError
from stillroom.geometry.arrays import F64
from stillroom.pipeline import SILENT, Progress
from stillroom.protocols import Dataset, Parts
from stillroom.system import Slam, build

WITH_REMOVAL, WITHOUT_REMOVAL = "with removal", "without"


@dataclass(frozen=True)
class DenseMaps:
    """What a run leaves behind.

    Attributes:
        clouds: The maps by what was done about moving things, `WITH_REMOVAL` and `WITHOUT_REMOVAL`.
        T_world_cam: The final pose (4, 4) of each tracked image, by its number.
        n_given: Images that the run was given.
    """

    clouds: dict[str, DenseCloud]
    T_world_cam: dict[int, F64] = field(repr=False)
    n_given: int


def dense_maps(
    dataset: Dataset, config: SlamConfig, dense: DenseMapperConfig, mapped: range, progress: Progress = SILENT
) -> DenseMaps:
    """Run a method over a sequence and map some of its images.

    Both maps are of the same keyframes with the same poses, and are told of the same moving pixels.

    Args:
        dataset: The sequence; all of it is tracked.
        config: The method.
        dense: The dense map.
        mapped: Numbers of the images that the maps are made of, and carved with; no other ever touches them.
        progress: Told of each frame.

    Raises:
        KeyboardInterrupt: The user stopped it: half a map has no figures to compare.
        StillroomError: Something that the run needs is wrong; a single image that cannot be read is not.
    """
    cv2.setNumThreads(1)
    cv2.setRNGSeed(config.seed % 2**31)
    mapping = _Twins(mapped)
    slam = build(replace(config, dense=NoDenseMapConfig()), dataset.camera, observer=mapping)
    for name, removal in ((WITH_REMOVAL, True), (WITHOUT_REMOVAL, False)):
        one = replace(dense, carving=replace(dense.carving, removal=removal))
        mapping.mappers[name] = one.build(Parts(dataset.camera, slam.map))
    progress.start(len(dataset))
    try:
        _track_all(dataset, slam, progress)
    finally:
        progress.finish()
        slam.close()
    for mapper in mapping.mappers.values():
        mapper.refresh()
    clouds = {name: mapper.cloud() for name, mapper in mapping.mappers.items()}
    return DenseMaps(clouds, _final_poses(slam), len(dataset))


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


def _track_all(dataset: Dataset, slam: Slam, progress: Progress) -> None:
    for place in range(len(dataset)):
        try:
            image = dataset.load(place)
        except FrameError:
            progress.frame(None)
            continue
        progress.frame(slam.process(image))


def _final_poses(slam: Slam) -> dict[int, F64]:
    return {
        result.index: slam.map.keyframe_pose(result.reference_keyframe) @ result.T_reference_cam
        for result in slam.results
        if result.T_reference_cam is not None
    }
