"""Who runs a grid: worker processes of this machine through joblib, or a Dask cluster."""

import dataclasses
import logging
import os
import shutil
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from stillroom.bench.grid.axes import DASK, JOBLIB, Grid, PlannedRun
from stillroom.bench.grid.rows import Cost, Row
from stillroom.bench.grid.work import begin_worker, perform, perform_marked
from stillroom.errors import ConfigError, MissingExtraError, StillroomError

DIED = "its worker died twice, killed or crashed; as the system kills for want of memory, fewer jobs may help"
BEGUN = ".running"
CONNECT_WITHIN_S = 10.0


def n_jobs(grid: Grid) -> int:
    """Return how many worker processes run a grid: as many as asked for, else one on each core that may be used."""
    if grid.jobs:
        return grid.jobs
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def check_backend(grid: Grid) -> None:
    """Refuse a backend that there is not, or that does not go with other options.

    Raises:
        ConfigError: It is so.
    """
    if grid.scheduler is None:
        if grid.backend != JOBLIB:
            raise ConfigError(f"backend is '{grid.backend}'; it must be {JOBLIB}, or {DASK}HOST:PORT")
        return
    if ":" not in grid.scheduler:
        raise ConfigError(f"backend is '{grid.backend}'; write it like {DASK}192.168.1.5:8786")
    if grid.jobs or grid.memory_gb is not None:
        raise ConfigError("with Dask, jobs and memory are the cluster's: leave them out, and see 'dask worker --help'")


def finished(runs: Sequence[PlannedRun], grid: Grid, folder: Path) -> Generator[Row, None, None]:
    """Make runs, and yield the row of each when it is finished; a generator that is closed ends its workers.

    A run whose worker dies is tried once more, and is then a row that says so.

    Args:
        runs: The runs.
        grid: How they are run.
        folder: Where notes may be kept of what is running.

    Raises:
        MissingExtraError: Dask is asked for, and not installed.
        StillroomError: Workers do not start, or the cluster does not answer.
    """
    return _on_cluster(runs, grid.scheduler) if grid.scheduler is not None else _here(runs, grid, folder / BEGUN)


# On this machine.


def _here(runs: Sequence[PlannedRun], grid: Grid, begun: Path) -> Generator[Row, None, None]:
    """Make runs in processes of this machine.

    When one of them dies, joblib gives up all that goes on. Which of the runs that went on is to blame nobody can tell,
    so each is tried again alone; the rest goes on side by side.
    """
    waiting = {run.digest: run for run in runs}
    _empty(begun)
    try:
        n_before = -1
        while waiting:
            for row in _side_by_side(list(waiting.values()), n_jobs(grid), grid.memory_gb, begun):
                del waiting[row.digest]
                yield row
            suspects = [waiting[mark.name] for mark in sorted(begun.iterdir()) if mark.name in waiting]
            if not suspects and len(waiting) == n_before:
                raise StillroomError("worker processes end before they begin a run; is there enough memory?")
            n_before = len(waiting)
            for suspect in suspects:
                _empty(begun)
                alone = list(_side_by_side([suspect], 1, grid.memory_gb, begun))
                row = alone[0] if alone else Row.failed(suspect, DIED, Cost())
                del waiting[suspect.digest]
                yield dataclasses.replace(row, cost=dataclasses.replace(row.cost, attempts=2))
            _empty(begun)
    finally:
        _end_workers()
        shutil.rmtree(begun, ignore_errors=True)


def _side_by_side(
    runs: Sequence[PlannedRun], n: int, memory_gb: float | None, begun: Path
) -> Generator[Row, None, None]:
    """Make runs in `n` processes; when one of these dies, end early."""
    from joblib import Parallel, delayed
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    # With n_jobs=1 joblib would run them in this process. Two of which one is given nothing keep it safe.
    width = {"n_jobs": n} if n > 1 else {"n_jobs": 2, "pre_dispatch": 1}
    parallel = Parallel(
        return_as="generator_unordered",
        backend="loky",
        batch_size=1,
        initializer=begin_worker,
        initargs=(os.getpid(),),
        **width,
    )
    try:
        yield from parallel(delayed(perform_marked)(run, begun, memory_gb) for run in runs)
    except TerminatedWorkerError:
        return


def _end_workers() -> None:
    """End the processes that joblib keeps for a next call, and the memory that they hold."""
    from joblib.externals.loky import get_reusable_executor

    get_reusable_executor().shutdown(wait=True, kill_workers=True)


def _empty(folder: Path) -> None:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)


# On a cluster.


def _on_cluster(runs: Sequence[PlannedRun], address: str) -> Generator[Row, None, None]:
    """Make runs on the workers of a Dask cluster. Its scheduler decides which worker gets which."""
    distributed = _distributed()
    try:
        client = distributed.Client(f"tcp://{address}", timeout=CONNECT_WITHIN_S)
    except (OSError, ValueError) as error:
        raise StillroomError(
            f"{DASK}{address}: no scheduler answers there ({error}); start one with 'dask scheduler'"
        ) from error
    with client, _silent_client():
        futures = {client.submit(perform, run, pure=False): run for run in runs}
        again: set[str] = set()
        try:
            arriving = distributed.as_completed(list(futures))
            for future in arriving:
                run = futures.pop(future)
                if future.status == "error" and _died(future) and run.digest not in again:
                    again.add(run.digest)
                    once_more = client.submit(perform, run, pure=False)
                    futures[once_more] = run
                    arriving.add(once_more)
                    continue
                row = _row_of(future, run, address)
                attempts = 2 if run.digest in again else 1
                yield dataclasses.replace(row, cost=dataclasses.replace(row.cost, attempts=attempts))
        finally:
            client.cancel(list(futures))


@contextmanager
def _silent_client() -> Iterator[None]:
    """Keep Dask from logging in many lines that the scheduler is gone, which is said here in one."""
    logger = logging.getLogger("distributed.client")
    before = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(before)


def _row_of(future: Any, run: PlannedRun, address: str) -> Row:
    if future.status == "finished":
        row: Row = future.result()
        return row
    if future.status != "error":
        raise StillroomError(f"{DASK}{address}: the scheduler is gone; begin again to go on where the grid was")
    error = future.exception()
    return Row.failed(run, DIED if _died(future) else f"{type(error).__name__}: {error}", Cost())


def _died(future: Any) -> bool:
    return isinstance(future.exception(), _distributed().KilledWorker)


def _distributed() -> Any:
    try:
        import distributed
    except ImportError as error:
        raise MissingExtraError("distributed", "cluster") from error
    return distributed
