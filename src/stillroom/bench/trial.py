"""One run of a method on a sequence, for its figures only."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from stillroom.config import SlamConfig
from stillroom.data.image import Image
from stillroom.data.result import FrameSummary
from stillroom.data.semantics import Semantics
from stillroom.data.trajectory import Trajectory
from stillroom.datasets.recording import sensor_of
from stillroom.dense.no_dense_map import NoDenseMapConfig
from stillroom.evaluation.report import Evaluation, percent
from stillroom.evaluation.smoothness import Smoothness
from stillroom.evaluation.timing import FRAME, StageClock
from stillroom.pipeline import SILENT, RunOptions, RunProgress, run
from stillroom.pipeline.live import LiveFigures
from stillroom.protocols import Dataset, KeyframeSegmenter, RunObserver, Schedule, Segmenter
from stillroom.schedule import InOrder
from stillroom.semantics.detector import FrameRange, silenced
from stillroom.system import System, segmenter_of


@dataclass(frozen=True)
class FrameAverages:
    """Some tracked frames, on average.

    Attributes:
        n_frames: How many there were.
        keypoints, static, inliers: Keypoints found, judged static, and agreeing with the pose, per such frame.
    """

    n_frames: int
    keypoints: float
    static: float
    inliers: float

    @property
    def static_share(self) -> float:
        """Share of the keypoints that were judged static, 0 to 1."""
        return self.static / self.keypoints if self.keypoints else 0.0

    @staticmethod
    def over(results: Sequence[FrameSummary]) -> "FrameAverages | None":
        """Return the averages of some frames of a run; None where there are none."""
        if not results:
            return None
        counts = np.array([(result.n_keypoints, result.n_static, result.n_inliers) for result in results])
        return FrameAverages(len(results), *(float(mean) for mean in counts.mean(axis=0)))

    @staticmethod
    def over_runs(runs: Sequence["FrameAverages | None"]) -> "FrameAverages | None":
        """Return the averages of several runs, the first one's frames; None where no run has any."""
        known = [run for run in runs if run is not None]
        if not known:
            return None
        means = np.mean([(run.keypoints, run.static, run.inliers) for run in known], axis=0)
        return FrameAverages(known[0].n_frames, *(float(mean) for mean in means))


@dataclass(frozen=True)
class Trial:
    """The figures of one run.

    Attributes:
        seed: Seed of its random choices.
        n_given, n_tracked: Frames recorded, those without a depth image too, and frames with a pose.
        evaluation: Figures against the ground truth; None where there is none, or nothing to compare.
        tracked: The tracked frames; None where there was none.
        boxed: Those of them with something potentially dynamic; None where there was none.
        first_boxed: Number of the first image with something potentially dynamic; None where there was none.
        clock: Times of the stages.
        kept: Keypoints judged static in each of the frames behind `boxed`, by the frame's number.
        n_keyframes: Keyframes that were made, those culled later among them.
        live: Figures of the live schedule; None for a run in order.
        trajectory: The final poses.
        n_loops: Loops that are closed in the final map.
        n_jumps: How often a loop, one that was undone too, or a merge of sub-maps moved the map.
    """

    seed: int
    n_given: int
    n_tracked: int
    evaluation: Evaluation | None
    tracked: FrameAverages | None
    boxed: FrameAverages | None
    first_boxed: int | None
    clock: StageClock
    kept: Mapping[int, int] = field(default_factory=dict)
    n_keyframes: int = 0
    live: LiveFigures | None = None
    trajectory: Trajectory | None = field(default=None, repr=False)
    n_loops: int = 0
    n_jumps: int = 0

    @property
    def coverage(self) -> float:
        """Share of the given frames that have a pose, 0 to 1."""
        return self.n_tracked / self.n_given if self.n_given else 0.0

    @property
    def ate_m(self) -> float | None:
        """ATE RMSE after the trajectory's alignment, ground truth as given [m]."""
        return None if self.evaluation is None else self.evaluation.as_given.ate_m.rmse

    @property
    def rpe(self) -> tuple[float, float] | None:
        """RPE RMSE over 1 s: translation [m/s] and rotation [deg/s]."""
        found = None if self.evaluation is None else self.evaluation.for_rpe.rpe_1s
        return None if found is None else (found.translation_m.rmse, found.rotation_deg.rmse)

    @property
    def smoothness(self) -> Smoothness | None:
        """Jitter, and the error faster and slower than one second."""
        return None if self.evaluation is None else self.evaluation.for_rpe.smoothness

    @property
    def frame_cpu_ms(self) -> float:
        """What a whole frame cost on average, network and mapping included, images read before [ms of CPU]."""
        return next((stage.cpu_mean_ms for stage in self.clock.summary() if stage.stage == FRAME), 0.0)

    @property
    def frame_wall_ms(self) -> float:
        """The same in wall time [ms]."""
        return next((stage.wall_mean_ms for stage in self.clock.summary() if stage.stage == FRAME), 0.0)

    def line(self) -> str:
        """Return the run in one line."""
        tracked = f"{percent(self.coverage)} of {self.n_given} frames tracked"
        return f"seed {self.seed}: {tracked}" + ("" if self.ate_m is None else f", ATE {self.ate_m:.4f} m")

    def to_dict(self) -> dict[str, Any]:
        """Return the figures for a JSON file."""
        return {
            "seed": self.seed,
            "n_given": self.n_given,
            "n_tracked": self.n_tracked,
            "coverage": self.coverage,
            "frame_cpu_ms": self.frame_cpu_ms,
            "tracked_frames": None if self.tracked is None else asdict(self.tracked),
            "boxed_frames": None if self.boxed is None else asdict(self.boxed),
            "evaluation": None if self.evaluation is None else asdict(self.evaluation),
        }


def all_keypoints(config: SlamConfig) -> SlamConfig:
    """Return a config that extracts keypoints from every image: what is counted of each image is then of the same sort.

    Flow between keyframes follows some of them only.
    """
    return replace(config, tracking=replace(config.tracking, between_keyframes="orb"))


def poses_only(config: SlamConfig) -> SlamConfig:
    """Return a config without its dense map, which changes no pose."""
    return replace(config, dense=NoDenseMapConfig())


def attempt(
    dataset: Dataset,
    config: SlamConfig,
    seed: int,
    progress: RunProgress = SILENT,
    withheld: tuple[FrameRange, ...] = (),
    observe: Callable[[System], RunObserver] | None = None,
    schedule: Schedule | None = None,
    speed: float = 0.0,
) -> Trial:
    """Run a method over a sequence from a seed, and write nothing.

    Args:
        dataset: The sequence.
        config: The method.
        seed: Seed of its random choices.
        progress: Called for each frame.
        withheld: Ranges of image numbers in which the method gets no detections; propagated boxes are withheld too.
        observe: Makes an observer of the system that is run.
        schedule: When work runs; in order by default.
        speed: How fast images are played under a live schedule; 0: one after the other.

    Raises:
        KeyboardInterrupt: The user stopped it: half a run has no figures to compare.
        StillroomError: Something that the run needs is wrong.
    """
    schedule = schedule or InOrder()
    segmenter = segmenter_of(config, dataset.camera, schedule, sensor_of(dataset))
    noting = noting_of(silenced(segmenter, withheld) if withheld else segmenter)
    options = RunOptions(root=None, pictures=0, segmenter=noting, observe=observe, schedule=schedule, speed=speed)
    outcome = run(dataset, replace(config, seed=seed), options, progress)
    if outcome.interrupted:
        raise KeyboardInterrupt
    # Lost frames do not count: nothing was rejected there because nothing was tracked.
    tracked = [result for result in outcome.system.results if result.T_world_cam is not None]
    boxed = [result for result in tracked if result.index in noting.occupied]
    return Trial(
        seed=seed,
        n_given=outcome.n_recorded,
        n_tracked=outcome.n_tracked,
        evaluation=outcome.evaluation,
        tracked=FrameAverages.over(tracked),
        boxed=FrameAverages.over(boxed),
        first_boxed=min(noting.occupied, default=None),
        clock=outcome.clock,
        kept={result.index: result.n_static for result in boxed},
        n_keyframes=sum(result.is_keyframe for result in outcome.system.results),
        live=outcome.live,
        trajectory=outcome.system.trajectory(),
        n_loops=len(outcome.system.map.loop_edges),
        n_jumps=len(outcome.system.map.jumps),
    )


def noting_of(segmenter: Segmenter) -> "NotingSegmenter":
    """Return a segmenter that records what another finds; of keyframes alone, if that sees only these."""
    if isinstance(segmenter, KeyframeSegmenter):
        return NotingKeyframeSegmenter(segmenter)
    return NotingSegmenter(segmenter)


class NotingSegmenter:
    """Returns another segmenter's result and records in which images something is potentially dynamic."""

    def __init__(self, inner: Segmenter) -> None:
        self._inner = inner
        self.occupied: set[int] = set()

    def __call__(self, image: Image) -> Semantics:
        """Return the other's result."""
        semantics = self._inner(image)
        if semantics.has_any:
            self.occupied.add(image.index)
        return semantics


class NotingKeyframeSegmenter(NotingSegmenter):
    """The same of a network that sees keyframes only."""

    def __init__(self, inner: KeyframeSegmenter) -> None:
        super().__init__(inner)
        self._see = inner.see

    def see(self, image: Image) -> Semantics:
        """Return what the other finds in a keyframe."""
        semantics = self._see(image)
        if semantics.has_any:
            self.occupied.add(image.index)
        return semantics
