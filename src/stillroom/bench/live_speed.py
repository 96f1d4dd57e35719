"""The speed of a method under the live schedule: as fast as it goes, and at a camera's rate."""

import threading
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from statistics import median
from typing import Any

import cv2
import numpy as np

from stillroom.bench.trial import attempt
from stillroom.config import SlamConfig
from stillroom.data.image import Image
from stillroom.datasets.recording import DatasetView
from stillroom.errors import FrameError
from stillroom.evaluation.timing import processor, unit_ms
from stillroom.geometry.arrays import U8
from stillroom.pipeline import SILENT, RunProgress
from stillroom.protocols import Dataset
from stillroom.schedule import LiveSchedule

CAMERA_HZ = 30.0
UNITS_A_PERIOD = 4.7
"""A 30 Hz camera's period on a machine whose unit is 7.1 ms; a slower machine is given as many units."""
UNIT_IMAGES = 140
"""About a second: on a virtual machine the clock may double from one second to the next."""
UNIT_EVERY_S = 0.5
"""While a run goes on: a hundredth of one core."""

HEADER = (
    "pace", "seed", "ms a frame", "frames/s", "units", "dropped", "tracked",
    "due to pose: median", "p95 [units]", "ATE [m]", "keyframes", "network saw",
)  # fmt: skip
"""Names of the columns of `LiveSpeed.row`. A frame's time is wall time until every queue is empty, over the frames."""


class InMemory(DatasetView):
    """A sequence whose images are read before: a camera has no disk to read from."""

    def __init__(self, inner: Dataset) -> None:
        """Read all images."""
        super().__init__(inner)
        self._images: list[Image | FrameError] = []
        for place in range(len(inner)):
            try:
                self._images.append(inner.load(place))
            except FrameError as error:
                self._images.append(error)

    def load(self, index: int) -> Image:
        """Return an image; what was computed of it in an earlier run is not there any more.

        Raises:
            IndexError: There is no such image.
            FrameError: It cannot be used.
        """
        if not 0 <= index < len(self._images):
            raise IndexError(index)
        image = self._images[index]
        if isinstance(image, FrameError):
            raise image
        return image.at(image.index, image.timestamp_s)

    @property
    def rate_hz(self) -> float:
        """Images a second at which the sequence was recorded, on average."""
        times_s = self.timestamps_s
        return (len(times_s) - 1) / float(times_s[-1] - times_s[0])

    def grays(self) -> list[U8]:
        """Return images from all over (H, W) uint8, of which the unit is measured."""
        images = [image for image in self._images if isinstance(image, Image)]
        chosen = images[:: max(1, len(images) // UNIT_IMAGES)]
        return [np.asarray(cv2.cvtColor(image.rgb, cv2.COLOR_RGB2GRAY), dtype=np.uint8) for image in chosen]


class UnitMeanwhile:
    """Measures the unit while a live run goes on, so that both see the same machine; a context.

    One `cv2.ORB_create(1000).detectAndCompute` every half second, on a thread of its own and in CPU time of it, as
    `bench.speed.UnitMeter` does between the frames of a run in order.
    """

    def __init__(self, grays: Sequence[U8]) -> None:
        """Take images (H, W) uint8."""
        self._grays, self._cpu_ms = grays, list[float]()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._measure, name="stillroom-unit")

    def __enter__(self) -> "UnitMeanwhile":
        """Begin."""
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """End."""
        self._ended.set()
        self._thread.join()

    @property
    def mean_ms(self) -> float:
        """The unit [ms]."""
        return float(np.mean(self._cpu_ms))

    def _measure(self) -> None:
        orb = cv2.ORB.create(1000)
        orb.detectAndCompute(self._grays[0], None)  # the first call allocates
        while True:
            start_ns = time.thread_time_ns()
            orb.detectAndCompute(self._grays[len(self._cpu_ms) % len(self._grays)], None)
            self._cpu_ms.append((time.thread_time_ns() - start_ns) * 1e-6)
            if self._ended.wait(UNIT_EVERY_S):
                return


@dataclass(frozen=True)
class LiveSpeed:
    """One live run.

    Attributes:
        method: Its name.
        seed: Its seed.
        rate_hz: Images a second that were played; 0: as fast as it goes.
        unit_ms: One unit, measured while the run went on [ms].
        n_frames: Images of the sequence.
        n_dropped, n_tracked: Images that were dropped, and that have a pose.
        wall_ms: Wall time until every queue was empty, over the frames [ms].
        delay_ms: Median and 95th percentile of the time from when an image was due to its pose [ms].
        ate_m: ATE of the final trajectory [m]; None without ground truth.
        n_keyframes: Keyframes made.
        n_seen: Images that the detector or network saw.
        loads: Share of the wall time for which each worker was busy.
    """

    method: str
    seed: int
    rate_hz: float
    unit_ms: float
    n_frames: int
    n_dropped: int
    n_tracked: int
    wall_ms: float
    delay_ms: tuple[float, float]
    ate_m: float | None
    n_keyframes: int
    n_seen: int
    loads: dict[str, float]

    @property
    def units(self) -> float:
        """Wall time of a frame [units]."""
        return self.wall_ms / self.unit_ms

    def row(self) -> tuple[str, ...]:
        """Return the cells under `HEADER`."""
        has_pace = self.rate_hz > 0
        return (
            f"{self.rate_hz:.1f} Hz" if has_pace else "no pace",
            str(self.seed),
            f"{self.wall_ms:.1f}",
            f"{1000.0 / self.wall_ms:.1f}",
            f"{self.units:.2f}",
            f"{self.n_dropped} ({100.0 * self.n_dropped / self.n_frames:.1f} %)",
            f"{self.n_tracked}/{self.n_frames - self.n_dropped}",
            *(f"{delay / self.unit_ms:.2f}" if has_pace else "–" for delay in self.delay_ms),
            "–" if self.ate_m is None else f"{self.ate_m:.4f}",
            str(self.n_keyframes),
            str(self.n_seen),
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the figures for a JSON file."""
        return asdict(self) | {"units": self.units}


def camera_rate_hz(unit_ms: float) -> float:
    """Return the rate of a camera [1/s]: 30 Hz, or one image in `UNITS_A_PERIOD` units where that is longer."""
    return min(CAMERA_HZ, 1000.0 / (UNITS_A_PERIOD * unit_ms))


def live_speed(
    dataset: InMemory, name: str, config: SlamConfig, paced: bool, progress: RunProgress = SILENT
) -> LiveSpeed:
    """Run a method live over a sequence. Kernels should be loaded, and nothing else should run.

    Args:
        dataset: The sequence.
        name: Name of the method in the result.
        config: The method, with its seed.
        paced: Whether images come at a camera's rate, by the unit as it is just before the run; or as fast as it goes.
        progress: Called for each frame.

    Raises:
        KeyboardInterrupt: The user stopped it.
        StillroomError: Something that the run needs is wrong.
    """
    grays, schedule = dataset.grays(), LiveSchedule()
    rate_hz = camera_rate_hz(unit_ms(grays)) if paced else 0.0
    with UnitMeanwhile(grays) as unit:
        trial = attempt(dataset, config, config.seed, progress, schedule=schedule, speed=rate_hz / dataset.rate_hz)
    assert trial.live is not None
    live = trial.live
    return LiveSpeed(
        method=name,
        seed=config.seed,
        rate_hz=rate_hz,
        unit_ms=unit.mean_ms,
        n_frames=trial.n_given,
        n_dropped=len(live.dropped),
        n_tracked=trial.n_tracked,
        wall_ms=live.wall_s / trial.n_given * 1e3,
        delay_ms=live.delay_ms,
        ate_m=trial.ate_m,
        n_keyframes=trial.n_keyframes,
        n_seen=live.n_seen,
        loads={worker.value: share for worker, share in live.shares().items()},
    )


def sentences(runs: Sequence[LiveSpeed]) -> list[str]:
    """Return several runs of a method at one pace in words."""
    first, slowest, fastest = runs[0], min(run.rate_hz for run in runs), max(run.rate_hz for run in runs)
    rates = f"{slowest:.1f}" if fastest - slowest < 0.1 else f"{slowest:.1f} to {fastest:.1f}"
    pace = f"at a camera's rate, {rates} Hz" if fastest > 0 else "as fast as it goes"
    known = [run.ate_m for run in runs if run.ate_m is not None]
    wall_ms, dropped = median(run.wall_ms for run in runs), [100.0 * run.n_dropped / run.n_frames for run in runs]
    text = (
        f"{first.method}, live, {pace}, median of {len(runs)} runs: {wall_ms:.1f} ms a frame, "
        f"{1000.0 / wall_ms:.1f} frames/s, {median(run.units for run in runs):.2f} units; "
        f"{median(dropped):.1f} % dropped, at most {max(dropped):.1f} %"
    )
    if fastest > 0:
        middle, late = (median(run.delay_ms[k] / run.unit_ms for run in runs) for k in range(2))
        text += f"; due to pose {middle:.2f} units, 95th percentile {late:.2f}"
    if known:
        text += f"; ATE {median(known):.4f} m, at worst {max(known):.4f} m"
    workers = list(dict.fromkeys(worker for run in runs for worker in run.loads))
    busy = ", ".join(f"{w} {100.0 * float(np.mean([run.loads.get(w, 0.0) for run in runs])):.0f} %" for w in workers)
    return [text, f"workers busy: {busy}; two cores or more of: {processor()}"]
