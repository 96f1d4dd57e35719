"""Time per stage and frame, and the unit that run times are given in."""

import csv
import platform
import sys
import threading
import time
from array import array
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

import cv2
import numpy as np

from stillroom.data.replacing import replace_text
from stillroom.geometry.arrays import U8

P = ParamSpec("P")
T = TypeVar("T")

FRAME = "frame"
"""The stage of a whole frame: callers of `process` wrap it in this."""

PROCESSOR_INFO = Path("/proc/cpuinfo")
PROCESS_STATUS = Path("/proc/self/status")
"""Where Linux reports the memory of a process."""


@dataclass
class _Cost:
    """Time of one stage in one frame, summed over its calls."""

    wall_ns: int = 0
    cpu_ns: int = 0


class _Column:
    """Times of one stage: the frames in which it ran, and its wall and CPU time there [ns]; 24 bytes for each."""

    def __init__(self) -> None:
        self.row, self.wall_ns, self.cpu_ns = array("q"), array("q"), array("q")

    def add(self, row: int, cost: _Cost) -> None:
        """Add a cost to a frame, the last one or one after it."""
        if self.row and self.row[-1] == row:
            self.wall_ns[-1] += cost.wall_ns
            self.cpu_ns[-1] += cost.cpu_ns
            return
        self.row.append(row)
        self.wall_ns.append(cost.wall_ns)
        self.cpu_ns.append(cost.cpu_ns)


@dataclass(frozen=True)
class StageTime:
    """Time of a stage.

    Attributes:
        stage: Its name.
        n_frames: Frames in which it ran.
        wall_median_ms, wall_p95_ms: Over the frames in which it ran [ms], in wall time.
        wall_mean_ms: Over all frames [ms]: a stage that runs now and then counts with its share.
        cpu_median_ms, cpu_p95_ms, cpu_mean_ms: The same in CPU time of the stage's own thread, which other
            programs on the machine disturb less.
    """

    stage: str
    n_frames: int
    wall_median_ms: float
    wall_p95_ms: float
    wall_mean_ms: float
    cpu_median_ms: float
    cpu_p95_ms: float
    cpu_mean_ms: float


class StageClock:
    """Records wall and thread CPU time per stage and frame.

    Stages may nest, each counts all that runs inside it, and may run on any thread; a call counts for the frame in
    which it ends.
    """

    def __init__(
        self, wall_ns: Callable[[], int] = time.perf_counter_ns, cpu_ns: Callable[[], int] = time.thread_time_ns
    ) -> None:
        """Take the clocks.

        Args:
            wall_ns: Wall time [ns].
            cpu_ns: CPU time of the calling thread [ns].
        """
        self._wall_ns, self._cpu_ns = wall_ns, cpu_ns
        self._indices = array("q")
        self._columns: dict[str, _Column] = {}
        self._present: dict[str, _Cost] = {}
        self._lock = threading.Lock()

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time the block under a name."""
        since_ns = self._wall_ns(), self._cpu_ns()
        try:
            yield
        finally:
            self._add(name, *since_ns)

    def timed(self, name: str, function: Callable[P, T]) -> Callable[P, T]:
        """Return the function, timed under a name."""

        def timed_function(*args: P.args, **kwargs: P.kwargs) -> T:
            # As in a stage, but without the context of one: a frame has a dozen of them.
            since_ns = self._wall_ns(), self._cpu_ns()
            try:
                return function(*args, **kwargs)
            finally:
                self._add(name, *since_ns)

        return timed_function

    def _add(self, name: str, since_wall_ns: int, since_cpu_ns: int) -> None:
        """Add the time since then to a stage of the present frame."""
        cpu_ns, wall_ns = self._cpu_ns() - since_cpu_ns, self._wall_ns() - since_wall_ns
        with self._lock:
            cost = self._present.get(name)
            if cost is None:
                cost = self._present[name] = _Cost()
            cost.wall_ns += wall_ns
            cost.cpu_ns += cpu_ns

    def next_frame(self, index: int | None = None) -> None:
        """End the present frame's row.

        Args:
            index: The frame's place in its sequence; counted from 0 where not given.
        """
        with self._lock:
            self._indices.append(len(self._indices) if index is None else index)
            self._keep_present()

    def conclude(self) -> None:
        """Assign the time after the last frame to the last frame."""
        with self._lock:
            if self._indices:
                self._keep_present()
            self._present = {}

    def _keep_present(self) -> None:
        """Add the present costs to the last frame."""
        for name, cost in self._present.items():
            self._columns.setdefault(name, _Column()).add(len(self._indices) - 1, cost)
        self._present = {}

    @property
    def n_frames(self) -> int:
        """Number of frames ended."""
        return len(self._indices)

    def newest_ms(self) -> dict[str, float]:
        """Return the wall time [ms] of each stage that ran in the frame that ended last; none before the first."""
        with self._lock:
            last = len(self._indices) - 1
            ended = {name: column for name, column in self._columns.items() if column.row[-1] == last}
            return {name: column.wall_ns[-1] * 1e-6 for name, column in ended.items()}

    def summary(self) -> list[StageTime]:
        """Return the time of each stage, the most expensive first."""
        summaries = [self._summary(name, column) for name, column in self._columns.items()]
        return sorted(summaries, key=lambda summary: -summary.cpu_mean_ms)

    def write_csv(self, path: Path) -> None:
        """Write a line for each frame, and for each stage its wall and CPU time [ms]; empty where it did not run.

        Raises:
            StillroomError: The file cannot be written; what was there is there still.
        """
        text = StringIO(newline="")
        writer = csv.writer(text)
        writer.writerow(["frame", *(f"{name}_{kind}_ms" for name in self._columns for kind in ("wall", "cpu"))])
        rows = [[str(index), *[""] * (2 * len(self._columns))] for index in self._indices]
        for place, column in enumerate(self._columns.values()):
            for row, wall_ns, cpu_ns in zip(column.row, column.wall_ns, column.cpu_ns, strict=True):
                rows[row][2 * place + 1 : 2 * place + 3] = _ms(wall_ns), _ms(cpu_ns)
        writer.writerows(rows)
        replace_text(path, text.getvalue())

    def _summary(self, name: str, column: _Column) -> StageTime:
        wall_ms, cpu_ms = np.array(column.wall_ns) * 1e-6, np.array(column.cpu_ns) * 1e-6
        return StageTime(
            stage=name,
            n_frames=len(column.row),
            wall_median_ms=float(np.median(wall_ms)),
            wall_p95_ms=float(np.percentile(wall_ms, 95)),
            wall_mean_ms=float(wall_ms.sum() / len(self._indices)),
            cpu_median_ms=float(np.median(cpu_ms)),
            cpu_p95_ms=float(np.percentile(cpu_ms, 95)),
            cpu_mean_ms=float(cpu_ms.sum() / len(self._indices)),
        )


def _ms(ns: int) -> str:
    return f"{ns * 1e-6:.4f}"


def unit_ms(images: Sequence[U8], cpu_ns: Callable[[], int] = time.thread_time_ns) -> float:
    """Return the mean CPU time [ms] of one `cv2.ORB_create(1000).detectAndCompute` on the images, on one thread.

    Figures in this unit are comparable across machines; take it in the same process and on the same frames as the
    figures.

    Args:
        images: At least one gray image (H, W) uint8.
        cpu_ns: CPU time of the calling thread [ns].
    """
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        orb = cv2.ORB.create(1000)
        orb.detectAndCompute(images[0], None)  # the first call allocates
        start_ns = cpu_ns()
        for image in images:
            orb.detectAndCompute(image, None)
        return (cpu_ns() - start_ns) * 1e-6 / len(images)
    finally:
        cv2.setNumThreads(threads)


def processor() -> str:
    """Return the name of the processor, as the system has it."""
    if PROCESSOR_INFO.exists():
        for line in PROCESSOR_INFO.read_text(encoding="utf-8", errors="replace").splitlines():
            name, _, value = line.partition(":")
            if name.strip() == "model name":
                return " ".join(value.split())
    return platform.processor() or platform.machine()


def peak_memory_mb() -> float:
    """Return the most memory that this program has held so far [MB of 10⁶ bytes]; NaN where it is not available."""
    if PROCESS_STATUS.exists():
        # The process's own: `ru_maxrss` is inherited from the parent process, which may have used far more.
        for line in PROCESS_STATUS.read_text(encoding="ascii").splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024e-6
    try:
        import resource
    except ImportError:  # not a Unix
        return float("nan")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak * (1.0 if sys.platform == "darwin" else 1024.0) * 1e-6


# Time the parts of a system from outside.


class _Timed:
    """A proxy of a part: some of its methods are timed, all else is forwarded."""

    def __init__(self, part: object, clock: StageClock, stages: dict[str, str]) -> None:
        self._part = part
        for method, stage in stages.items():
            setattr(self, method, clock.timed(stage, getattr(part, method)))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._part, name)


def timed_part(part: T, clock: StageClock, **stages: str) -> T:
    """Return the part with some methods timed: `timed_part(mapper, clock, refine="mapping")`.

    Calls from outside are timed, not those that the part makes to itself.
    """
    return cast(T, _Timed(part, clock, stages))
