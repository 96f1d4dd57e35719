"""All sockets (interfaces) of the package on one page. A contribution is one file that implements one of them.

===================  ===========================================================  =======================
socket               question it answers                                          package
===================  ===========================================================  =======================
`Dataset`            what did the camera see, and when?                           `datasets`
`CameraStream`       what does the camera see now?                                `cameras`
`Segmenter`          what is potentially dynamic in this image?                   `semantics`
`Clusterer`          which clusters has the depth cloud of this image?            `semantics`
`KeypointSieve`      which keypoints may tracking use? (sieve 1)                  `dynamics`
`QuickTracking`      where is the camera, roughly? (low-cost tracking)            `tracking`
`MatchSieve`         which keypoints and pixels are dynamic? (sieve 2)            `dynamics`
`DenseMapping`       what does the room look like without what moves? (sieve 3)   `dense`
`FeatureExtractor`   where are the corners, and what do they look like?           `features`
`MapKeeping`         what is kept of the map beyond the run, as it grows?         `storage`
`Schedule`           when, and on which thread, does a piece of work run?         `schedule.py`
`RunObserver`        what is done with each tracked frame, such as pictures?      `viz`, `cli`
===================  ===========================================================  =======================

A *sieve* removes dynamic data, in the field's words: dynamic-feature rejection. Sieve 1 works on keypoints before
tracking, sieve 2 on matches while tracking, sieve 3 on depth before the dense map. The sockets are structural: nothing
inherits from them. `stillroom.testing` holds the contract of each.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from types import TracebackType
from typing import ParamSpec, Protocol, Self, TypeVar, runtime_checkable

from stillroom.data.dense_cloud import DenseCloud
from stillroom.data.frame import Frame
from stillroom.data.image import Image
from stillroom.data.map import Map
from stillroom.data.motion import Motion
from stillroom.data.question import Pending as Pending
from stillroom.data.question import Question
from stillroom.data.result import FrameResult, FrameSummary, Tracked
from stillroom.data.semantics import Semantics
from stillroom.data.sensor import Sensor
from stillroom.data.trajectory import Trajectory
from stillroom.geometry.arrays import F32, F64, I64, U8, Bool
from stillroom.geometry.camera import Camera
from stillroom.schedule import InOrder, Worker

P = ParamSpec("P")
T = TypeVar("T")


class Origin(Protocol):
    """Where the images of a run come from: a data set, or a camera."""

    @property
    def name(self) -> str:
        """Short name, used for the results folder."""

    @property
    def sensor(self) -> Sensor:
        """What kind of camera takes the images; all of them are of that kind."""

    @property
    def camera(self) -> Camera:
        """The calibration of its images; that of a camera is known once it is entered."""

    @property
    def camera_source(self) -> str:
        """One line that says where the calibration comes from; shown at the start of a run."""

    @property
    def groundtruth(self) -> Trajectory | None:
        """True poses as they are given, where there are any."""

    @property
    def groundtruth_at_camera(self) -> Trajectory | None:
        """The same moved to the camera, where they are those of another body that rides on it; None otherwise."""


class Dataset(Origin, Protocol):
    """A recorded (or rendered) RGB-D sequence with random access: `load` in any order, repeatedly.

    `datasets.recording.Recording` has defaults for all but the first four and `load`.
    """

    @property
    def timestamps_s(self) -> F64:
        """Times of the colour images (N,) [s], strictly increasing."""

    @property
    def numbers(self) -> I64:
        """Numbers (N,) of the images in the original sequence, increasing; those of `Image.index`.

        They are the places 0 … N − 1 unless this is a part of another sequence.
        """

    @property
    def original_length(self) -> int:
        """Number of images of the original sequence, of which this may be a part."""

    @property
    def is_reversed(self) -> bool:
        """Whether the original is played backwards: `numbers` and times count from its end."""

    def __len__(self) -> int:
        """Number of images."""

    def __iter__(self) -> Iterator[Image]:
        """Yield the images in order; those that cannot be used are left out with a warning each."""

    def load(self, index: int) -> Image:
        """Return image `index`.

        Raises:
            IndexError: There is no such image; −1 is none either.
            FrameError: This one image cannot be used; the run continues without it.
        """


class CameraStream(Origin, Protocol):
    """A camera that delivers images while it takes them; entered before the first image, and left after the last."""

    @property
    def comes_in_time(self) -> bool:
        """Whether `next` waits until an image is taken; a recording that is played has its images at once."""

    def __enter__(self) -> Self:
        """Start the camera.

        Raises:
            CameraError: There is none, or it does not start.
        """

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Stop the camera; no thread of it is left."""

    def next(self) -> Image | None:
        """Wait for the next image; None after the last one. `Image.index` counts the images that were taken.

        Raises:
            FrameError: This one image cannot be used; the next one may.
            CameraError: The camera is gone, or has sent nothing for too long.
        """


class SceneTruth(Protocol):
    """The ground truth of a rendered frame: its exact pose (4, 4) and depth (H, W) [m], and object labels."""

    @property
    def T_world_cam(self) -> F64:
        """Exact pose (4, 4)."""

    @property
    def depth_m(self) -> F32:
        """Exact depth (H, W) float32 [m] at the pixel centres."""

    @property
    def instance(self) -> U8:
        """The object that each pixel shows (H, W) uint8: 0 for what never moves."""

    @property
    def moving(self) -> Bool:
        """Pixels of all that moves at that moment (H, W)."""


class SceneRemains(Protocol):
    """The part of a rendered scene that is static in the end."""

    @property
    def patches_m(self) -> F64:
        """The static surface: corner and two edges of parallelograms and triangles (Q, 9) [m, world]."""

    @property
    def is_triangle(self) -> Bool:
        """Which of them are triangles (Q,)."""

    def stays(self, instance: U8, time_s: float) -> Bool:
        """Return which pixels (H, W) of an image taken at a moment [s] show the static part."""


@runtime_checkable
class KnownScene(Protocol):
    """A data set that was rendered, and whose scene is known; see `datasets.recording.rendered`."""

    def truth(self, index: int) -> SceneTruth:
        """Return the ground truth of frame `index`."""

    def remains(self, last: int = -1) -> SceneRemains:
        """Return what is static in the end, when frame `last` is the last."""

    def pose(self, index: int) -> F64:
        """Return the exact `T_world_cam` (4, 4) of frame `index`."""

    def handled(self, instance: U8) -> Bool:
        """Return which pixels (H, W) show objects that people move, given the object of each."""

    def without_people(self) -> Dataset | None:
        """Return the same sequence without people; None where people move the scene itself."""


class RenderedDataset(KnownScene, Dataset, Protocol):
    """Both in one."""


class Segmenter(Protocol):
    """Finds what is potentially dynamic. May keep state over time: it is called once for each image, in order."""

    def __call__(self, image: Image) -> Semantics:
        """Return boxes or a mask of what is potentially dynamic in the image."""


@runtime_checkable
class KeyframeSegmenter(Segmenter, Protocol):
    """A segmenter whose network sees keyframes only: which images those are is known after they were tracked.

    Its result for other images is what it carries to them, or nothing. The first image is seen at once.
    """

    def see(self, image: Image) -> Semantics:
        """Return what the network finds in an image that becomes a keyframe.

        `__call__` had the image before; on a live schedule it may have had the next one too.
        """


class Clusterer(Protocol):
    """Clusters the depth cloud of an image. Called once for each image, in order."""

    def __call__(self, image: Image, semantics: Pending[Semantics]) -> Semantics:
        """Return the semantics with the clusters added; wait for the input semantics only where needed."""


class Schedule(Protocol):
    """Decides when submitted work runs. A stage never knows which schedule it runs on."""

    def submit(self, worker: Worker, work: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Pending[T]:
        """Run the work now or later; the work of one worker keeps its order."""

    def offer(self, worker: Worker, work: Callable[P, object], /, *args: P.args, **kwargs: P.kwargs) -> None:
        """Do the same with work that may be left out, where the worker has not kept up."""

    def keeps_up(self, worker: Worker) -> bool:
        """Return whether a worker keeps up with what is submitted."""

    def close(self) -> None:
        """Finish what was submitted."""


class FeatureExtractor(Protocol):
    """Finds keypoints."""

    def extract(self, image: Image) -> Frame:
        """Return the frame of the image; a black image may give zero keypoints."""


class KeypointSieve(Protocol):
    """Sieve 1: chooses the keypoints for tracking, before tracking."""

    def __call__(self, frame: Frame, semantics: Pending[Semantics]) -> Frame:
        """Return the frame with its `is_static` set."""


class MatchSieve(Protocol):
    """Sieve 2: classifies while tracking what is dynamic.

    It is called through `dynamics.asking`, which manages its life cycle: it is not called while relocalizing, and its
    result is ignored where too few matches would be left. One with a memory is a `RememberingSieve` as well.
    """

    def judge(self, question: Question) -> Motion:
        """Classify the whole image: every keypoint, matched or not, and every pixel."""


@runtime_checkable
class RememberingSieve(MatchSieve, Protocol):
    """A match sieve with a memory of earlier frames."""

    def remember(self, frame: Frame, T_cam_world: F64, keyframe: int) -> None:
        """Add a frame to the memory; called once a frame, after tracking. Lost frames are left out.

        Args:
            frame: The frame; `judge` was called for it before.
            T_cam_world: Its pose (4, 4).
            keyframe: Its id in the map where it became a keyframe; else −1.
        """

    def corrected(self, T_new_old: F64) -> None:
        """Move stored poses by a motion (4, 4) of the world's coordinates: the map was corrected, as by a loop."""


@runtime_checkable
class KeyframeSieve(MatchSieve, Protocol):
    """A match sieve that takes up in its own way what a `KeyframeSegmenter` finds in a keyframe."""

    def take_up(self, tracked: Tracked, found: Semantics) -> Motion:
        """Classify a frame again that becomes a keyframe, before its points are made; `judge` was called for it.

        Args:
            tracked: The frame, its pose, points, and classification so far.
            found: What the network finds in it.
        """


class QuickTracking(Protocol):
    """Low-cost tracking: finds a pose before the other stages, and calls sieve 2 at it (`Stage.LOW_COST`)."""

    def localize(self, frame: Frame, last: Tracked, T_cam_world: F64, semantics: Pending[Semantics], world: Map) -> F64:
        """Return a pose (4, 4) for tracking to start from.

        Args:
            frame: The present frame, after sieve 1.
            last: The last frame, its pose and points as known now.
            T_cam_world: The motion model's guess (4, 4).
            semantics: What is potentially dynamic.
            world: The map.
        """


class Clock(Protocol):
    """Times stages within a part."""

    def timed(self, name: str, function: Callable[P, T], /) -> Callable[P, T]:
        """Return the function, timed under a name."""


class NoClock:
    """Times nothing."""

    def timed(self, name: str, function: Callable[P, T], /) -> Callable[P, T]:
        """Return the function."""
        return function


@dataclass(frozen=True)
class Parts:
    """The context in which a part of a system is built; every `build` of a config takes it.

    Attributes:
        camera: The calibration of the images.
        world: The map, which may contain earlier runs. A segmenter is built before the map of a run is
            opened and finds an empty one here.
        seed: Seed of all random choices.
        clock: Times stages within the part.
        schedule: Runs what a part does not wait for.
        sensor: What kind of camera takes the images.
    """

    camera: Camera
    world: Map
    seed: int = 0
    clock: Clock = field(default_factory=NoClock)
    schedule: Schedule = field(default_factory=InOrder)
    sensor: Sensor = Sensor.RGBD


class DenseMapping(Protocol):
    """Makes a dense map; sieve 3: what is dynamic is not fused, and what has moved is removed again."""

    def integrate(self, keyframe: int, image: Image, excluded: Bool | None = None) -> None:
        """Fuse a new keyframe.

        Args:
            keyframe: Its id in the map, which knows where it is.
            image: Its image.
            excluded: Dynamic pixels (H, W).
        """

    def carve(self, image: Image, T_world_cam: F64, excluded: Bool | None = None) -> None:
        """Carve free space with a frame that is no keyframe.

        Args:
            image: Its image.
            T_world_cam: Its pose (4, 4).
            excluded: Dynamic pixels (H, W).
        """

    def refresh(self) -> None:
        """Update the dense map to the corrected poses of the keyframes."""

    def cloud(self) -> DenseCloud | None:
        """Return the map as known now; None where none is made."""


class MapKeeping(Protocol):
    """Stores the map beyond the run."""

    def keep(self, keyframe: int, image: Image, moving: Bool) -> None:
        """Write a keyframe, once the map around it is refined, and all that it changed.

        Args:
            keyframe: Its id in the map.
            image: Its image.
            moving: Dynamic pixels (H, W).
        """

    def note(self, result: FrameSummary) -> None:
        """Record the pose of a frame; called for every frame."""


class RunObserver(Protocol):
    """An observer of a run: a viewer, a progress line, a recorder of pictures. Never changes what it gets."""

    def on_frame(self, tracked: Tracked, semantics: Semantics, result: FrameResult) -> None:
        """Process a frame: all that tracking knows of it, and its result."""
