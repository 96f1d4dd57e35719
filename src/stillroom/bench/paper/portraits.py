"""What the figures of OC-SLAM show: two frames with all that was found in them, and the maps of the whole sequence."""

from dataclasses import dataclass, field

import numpy as np

from stillroom.bench.dense_maps import DenseMaps, dense_maps
from stillroom.config import SlamConfig
from stillroom.data.image import Image
from stillroom.data.result import FrameResult, Tracked
from stillroom.data.semantics import Semantics
from stillroom.dense.dense_mapper import DenseMapperConfig
from stillroom.geometry.arrays import Bool, Floats
from stillroom.geometry.camera import Camera
from stillroom.pipeline import SILENT, RunProgress
from stillroom.protocols import Dataset

MOST_MOVING = 0.8
"""Where more of the keypoints move, the test has failed rather than found something."""


@dataclass(frozen=True)
class Portrait:
    """A frame, and what was found in it.

    Attributes:
        image: As taken.
        semantics: What is potentially dynamic, and the clusters.
        moving: Dynamic pixels (H, W).
        keypoints_raw_px: Keypoints (N, 2) in the image as taken [px].
        is_static, is_matched: Which of them (N,) are static, and which have a map point.
    """

    image: Image
    semantics: Semantics = field(repr=False)
    moving: Bool = field(repr=False)
    keypoints_raw_px: Floats = field(repr=False)
    is_static: Bool = field(repr=False)
    is_matched: Bool = field(repr=False)


@dataclass(frozen=True)
class Portraits:
    """What is drawn of a sequence.

    Attributes:
        camera: Its calibration.
        frames: At most one of each half, in order of time: the one in which most is found to move.
        maps: The dense maps with removal and without, and the sparse one.
    """

    camera: Camera
    frames: tuple[Portrait, ...]
    maps: DenseMaps


class Photographer:
    """Observes a run and keeps, of each half, the tracked frame in which most is found to move.

    A frame in which something is potentially dynamic is preferred to any without, keypoints that are found dynamic
    count next, then boxes.
    """

    def __init__(self, middle: float) -> None:
        """Start without a frame; images from this number on are the second half."""
        self._middle = middle
        self._best: dict[bool, tuple[tuple[bool, int, int], Portrait]] = {}

    @property
    def frames(self) -> tuple[Portrait, ...]:
        """The frames in order of time."""
        return tuple(sorted((one for _, one in self._best.values()), key=lambda one: one.image.index))

    def on_frame(self, tracked: Tracked, semantics: Semantics, result: FrameResult) -> None:
        """Keep a frame if it is the best of its half by now."""
        if tracked.T_world_cam is None:
            return
        n_moving = result.n_keypoints - result.n_static
        failed = n_moving > MOST_MOVING * result.n_keypoints
        worth = semantics.has_any, 0 if failed else n_moving, len(semantics.boxes)
        half = result.index >= self._middle
        if half not in self._best or worth > self._best[half][0]:
            frame, motion = tracked.frame, tracked.motion
            kept = Portrait(
                frame.image,
                semantics,
                motion.moving.copy(),
                frame.keypoints.raw_px.copy(),
                tracked.is_static.copy(),
                tracked.is_matched.copy(),
            )
            self._best[half] = worth, kept

    def close(self) -> None:
        """Nothing is left open."""


def portraits(dataset: Dataset, config: SlamConfig, progress: RunProgress = SILENT) -> Portraits:
    """Run a method over a sequence with its dense map, or the default one where it makes none.

    Args:
        dataset: The sequence.
        config: The method.
        progress: Called for each frame.

    Raises:
        KeyboardInterrupt: The user stopped it.
        StillroomError: Something that the run needs is wrong.
    """
    dense = config.dense if isinstance(config.dense, DenseMapperConfig) else DenseMapperConfig()
    photographer = Photographer(float(np.mean(dataset.numbers)))
    maps = dense_maps(dataset, config, dense, range(dataset.original_length), progress, (photographer,))
    return Portraits(dataset.camera, photographer.frames, maps)
