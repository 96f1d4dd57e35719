"""What a worker does: one run, whatever becomes of it, as a row."""

import logging
import os
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from math import isnan
from pathlib import Path

from stillroom.bench.grid.axes import PlannedRun, code_version
from stillroom.bench.grid.rows import Cost, Row
from stillroom.bench.trial import Trial, attempt
from stillroom.errors import NO_MEMORY, StillroomError, is_of_memory
from stillroom.evaluation.timing import PROCESS_STATUS, peak_memory_mb
from stillroom.pipeline import Source

PEAK_RESET = Path("/proc/self/clear_refs")
"""Where Linux lets a process begin to measure its peak of memory again."""
PARENT_ASKED_EVERY_S = 1.0

_SILENT = logging.NullHandler()
_one_at_a_time = threading.Lock()


def perform(run: PlannedRun, memory_gb: float | None = None) -> Row:
    """Make a run. What goes wrong in it is the row's error; in a process with several threads runs take turns.

    Args:
        run: The run.
        memory_gb: How much memory the process may hold in it [GB]; see `bounded_memory`.

    Raises:
        KeyboardInterrupt: The process was asked to end.
    """
    with _one_at_a_time:
        logging.getLogger("stillroom").addHandler(_SILENT)  # lines of several workers would be mixed
        _measure_peak_again()
        start_s = time.perf_counter()
        trial, why = None, ""
        try:
            trial = _trial(run, memory_gb)
        except StillroomError as error:
            why = str(error)
        peak_mb = peak_memory_mb()
        cost = Cost(
            cpu_ms_a_frame=None if trial is None else trial.frame_cpu_ms,
            seconds=time.perf_counter() - start_s,
            peak_memory_mb=None if isnan(peak_mb) else peak_mb,
        )
        return Row.failed(run, why, cost) if trial is None else Row.of(run, trial, cost)


def _trial(run: PlannedRun, memory_gb: float | None) -> Trial:
    ours = code_version()
    if ours != run.version:
        raise StillroomError(f"this worker has Stillroom {ours}, the grid {run.version}; install the same on all")
    try:
        with bounded_memory(memory_gb):
            dataset = Source(run.sequence, run.camera, frames=run.frames).open()
            return attempt(dataset, run.config, run.seed)
    except StillroomError:
        raise
    except Exception as error:  # a bug in one run does not end the others
        why = NO_MEMORY if is_of_memory(error) else f"{type(error).__name__}: {error}"
        raise StillroomError(why) from error


# In a worker process of this machine.


def begin_worker(parent: int) -> None:
    """Set up a worker process: Ctrl-C is its parent's to hear, and it ends when its parent does.

    Args:
        parent: Its process id.
    """
    if not hasattr(os, "setpgrp"):  # Windows, where neither is to be had
        return
    os.setpgrp()

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(PARENT_ASKED_EVERY_S)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def perform_marked(run: PlannedRun, begun: Path, memory_gb: float | None) -> Row:
    """Make a run in a worker process.

    Args:
        run: The run.
        begun: The folder in which a file with the run's digest tells that it goes on; it stays where the worker dies.
        memory_gb: How much memory the process may hold [GB].
    """
    mark = begun / run.digest
    with suppress(OSError):
        mark.touch()
    try:
        row = perform(run, memory_gb)
    except KeyboardInterrupt:  # SIGTERM, of which the run makes this: somebody wants this one process to end
        os._exit(1)
    with suppress(OSError):
        mark.unlink()
    return row


def can_bound_memory() -> bool:
    """Return whether the system can bound the memory of a process: Linux does, others accept a bound and forget it."""
    return sys.platform == "linux" and PROCESS_STATUS.exists()


@contextmanager
def bounded_memory(memory_gb: float | None) -> Iterator[None]:
    """Let no more memory be had in the block than makes this much in all [GB of 10⁹ bytes]; None for any.

    Linux bounds addresses, of which a process reserves more than it holds: counted is what is added to them from now
    on. Where no bound can be set, there is none.
    """
    if memory_gb is None or not can_bound_memory():
        yield
        return
    import resource

    size, held = (_status_bytes(name) for name in ("VmSize", "VmRSS"))
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    bound = size + max(0, int(memory_gb * 1e9) - held)
    resource.setrlimit(resource.RLIMIT_AS, (bound if hard == resource.RLIM_INFINITY else min(bound, hard), hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def _status_bytes(name: str) -> int:
    lines = PROCESS_STATUS.read_text(encoding="ascii").splitlines()
    return next(int(line.split()[1]) * 1024 for line in lines if line.startswith(f"{name}:"))


def _measure_peak_again() -> None:
    """Forget the peak of the runs before, where the system can."""
    try:
        PEAK_RESET.write_text("5", encoding="ascii")
    except OSError:
        return
