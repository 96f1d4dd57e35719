"""Runs of a grid whose workers die, for worker processes to import: what a run does is decided by its seed."""

import os
import signal
from collections.abc import Callable
from pathlib import Path

from stillroom.bench.grid import work
from stillroom.bench.grid.axes import PlannedRun
from stillroom.bench.grid.rows import Cost, Row

DIES_ALWAYS, DIES_ONCE, IS_ASKED_TO_END = 1, 2, 3


def planned(seed: int, method: str = "orb-slam2", n_frames: int = 10, sequence: str = "room") -> PlannedRun:
    return PlannedRun(sequence, None, None, method, (), (), seed, f"{method}-{sequence}-{seed}", "1", n_frames)


def row_of(run: PlannedRun, error: str = "", cost: Cost | None = None) -> Row:
    figures = (None,) * 7 if error else (run.n_frames, run.n_frames - 1, 2, 0.01 * (run.seed + 1), None, None, None)
    return Row(
        run.sequence, "", run.method, run.setting, run.seed, *figures, error, run.digest, run.version, cost or Cost()
    )


def tries(folder: Path) -> list[int]:
    """Return the seeds of all runs that were begun, in their order."""
    file = folder / "tries"
    return [int(line) for line in file.read_text(encoding="utf-8").splitlines()] if file.exists() else []


def _dying(folder: Path) -> Callable[[PlannedRun], Row]:
    def perform(run: PlannedRun, memory_gb: float | None = None) -> Row:
        before = tries(folder)
        with (folder / "tries").open("a", encoding="utf-8") as file:
            file.write(f"{run.seed}\n")
        if run.seed == DIES_ALWAYS or (run.seed == DIES_ONCE and run.seed not in before):
            os.kill(os.getpid(), signal.SIGKILL)
        if run.seed == IS_ASKED_TO_END and run.seed not in before:
            raise KeyboardInterrupt  # as a run does that got SIGTERM
        return row_of(run)

    return perform


def perform_marked(run: PlannedRun, begun: Path, memory_gb: float | None) -> Row:
    """Do what the worker of a grid does, with such a run."""
    work.perform = _dying(begun.parent)
    return work.perform_marked(run, begun, memory_gb)


def perform(run: PlannedRun) -> Row:
    """Do what the worker of a cluster does: the sequence is the folder in which tries are counted."""
    return _dying(Path(run.sequence))(run)
