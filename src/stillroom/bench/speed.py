"""The time per frame, in milliseconds and in units that are comparable across machines.

One unit is one `cv2.ORB_create(1000).detectAndCompute` on the same frames in the same process. It is taken every few
frames between the frames of the run, so that both see the same load of the machine.
"""

import time
from dataclasses import asdict, dataclass
from typing import Any

import cv2
import numpy as np

from stillroom.bench.trial import attempt
from stillroom.config import SlamConfig
from stillroom.data.image import Image
from stillroom.data.trajectory import Trajectory
from stillroom.datasets.recording import DatasetView
from stillroom.evaluation.report import percent
from stillroom.evaluation.timing import FRAME, StageTime, peak_memory_mb, processor
from stillroom.pipeline import SILENT, RunProgress
from stillroom.pipeline.playback import LOADING
from stillroom.protocols import Dataset

HEADER = ("stage [ms]", "in frames", "wall median", "p95", "CPU median", "p95", "mean", "units", "units each")
"""Names of the columns of `Speed.rows`. Mean and units are of CPU time and over all frames.

Units each are over the frames in which the stage ran, such as the keyframes.
"""
UNIT_EVERY = 10


@dataclass(frozen=True)
class Speed:
    """The run time of a method on a sequence.

    Attributes:
        method: Its name.
        n_frames: Frames that were given to the method.
        coverage: Share of them that have a pose, 0 to 1; frames without one cost less.
        unit_cpu_ms, unit_wall_ms: One unit, in CPU time of its thread and in wall time [ms].
        stages: What each stage cost, the most costly first; `frame` is all but reading the images.
        peak_memory_mb: The most memory that the process has held up to the end of the run [MB].
    """

    method: str
    n_frames: int
    coverage: float
    unit_cpu_ms: float
    unit_wall_ms: float
    stages: tuple[StageTime, ...]
    peak_memory_mb: float

    @property
    def frame(self) -> StageTime:
        """What a whole frame costs."""
        return next(stage for stage in self.stages if stage.stage == FRAME)

    @property
    def units(self) -> float:
        """Mean cost of a frame over all frames, network and mapping included, images read before [units of CPU]."""
        return self.frame.cpu_mean_ms / self.unit_cpu_ms

    @property
    def units_by_wall(self) -> float:
        """The same in wall time."""
        return self.frame.wall_mean_ms / self.unit_wall_ms

    def units_each(self, stage: StageTime) -> float:
        """Return the mean cost of a stage over the frames in which it ran [units of CPU]."""
        return stage.cpu_mean_ms * self.n_frames / stage.n_frames / self.unit_cpu_ms

    def rows(self) -> list[tuple[str, ...]]:
        """Return one row of cells under `HEADER` for each stage."""
        return [
            (
                stage.stage,
                str(stage.n_frames),
                *(
                    f"{value:.1f}"
                    for value in (stage.wall_median_ms, stage.wall_p95_ms, stage.cpu_median_ms, stage.cpu_p95_ms)
                ),
                f"{stage.cpu_mean_ms:.1f}",
                f"{stage.cpu_mean_ms / self.unit_cpu_ms:.2f}",
                f"{self.units_each(stage):.2f}",
            )
            for stage in self.stages
        ]

    def sentences(self) -> list[str]:
        """Return notes on how to read the rows."""
        return [
            f"{self.method}: {self.frame.wall_mean_ms:.1f} ms a frame on average, "
            f"{1000.0 / self.frame.wall_mean_ms:.1f} frames/s, one thread of: {processor()}",
            f"that is {self.units:.2f} units a frame ({self.units_by_wall:.2f} in wall "
            f"time), over {self.n_frames} frames, {percent(self.coverage)} of them tracked; one unit is "
            f"{self.unit_cpu_ms:.1f} ms of CPU time here ({self.unit_wall_ms:.1f} ms of wall time)",
            f"peak memory of the process so far {self.peak_memory_mb:.0f} MB",
        ]

    def to_dict(self) -> dict[str, Any]:
        """Return the figures for a JSON file."""
        return asdict(self) | {"units": self.units, "units_by_wall": self.units_by_wall}


def speed(dataset: "UnitMeter", name: str, config: SlamConfig, progress: RunProgress = SILENT) -> Speed:
    """Run a method over a sequence and time it. Kernels should be compiled.

    Args:
        dataset: The sequence, with the meter in it.
        name: Name of the method in the result.
        config: The method.
        progress: Called for each frame.

    Raises:
        KeyboardInterrupt: The user stopped it.
        StillroomError: Something that the run needs is wrong.
    """
    dataset.forget()
    trial = attempt(dataset, config, config.seed, progress)
    return Speed(
        method=name,
        n_frames=trial.clock.n_frames,
        coverage=trial.coverage,
        unit_cpu_ms=float(np.mean(dataset.cpu_ms)),
        unit_wall_ms=float(np.mean(dataset.wall_ms)),
        # Reading an image is not part of the cost, and holds the meter's own time.
        stages=tuple(stage for stage in trial.clock.summary() if stage.stage != LOADING),
        peak_memory_mb=peak_memory_mb(),
    )


class UnitMeter(DatasetView):
    """A sequence that measures the unit on every few of the images that it delivers."""

    def __init__(self, inner: Dataset, every: int = UNIT_EVERY) -> None:
        super().__init__(inner)
        self._every = every
        self._n_loaded = 0
        self._orb = cv2.ORB.create(1000)
        self.cpu_ms: list[float] = []
        self.wall_ms: list[float] = []

    def forget(self) -> None:
        """Start again."""
        self._n_loaded = 0
        self.cpu_ms, self.wall_ms = [], []

    @property
    def groundtruth(self) -> Trajectory | None:
        """None: only speed is measured, and the evaluation would take time."""
        return None

    @property
    def groundtruth_at_camera(self) -> Trajectory | None:
        """None, for the same reason."""
        return None

    def load(self, index: int) -> Image:
        """Return an image of the sequence.

        Raises:
            FrameError: It cannot be used.
        """
        image = self._inner.load(index)
        if self._n_loaded % self._every == 0:
            self._measure(image)
        self._n_loaded += 1
        return image

    def _measure(self, image: Image) -> None:
        gray = cv2.cvtColor(image.rgb, cv2.COLOR_RGB2GRAY)  # not image.gray: the run shall make its own
        if not self.cpu_ms:
            self._orb.detectAndCompute(gray, None)  # the first call allocates
        cpu_ns, wall_ns = time.thread_time_ns(), time.perf_counter_ns()
        self._orb.detectAndCompute(gray, None)
        self.cpu_ms.append((time.thread_time_ns() - cpu_ns) * 1e-6)
        self.wall_ms.append((time.perf_counter_ns() - wall_ns) * 1e-6)
