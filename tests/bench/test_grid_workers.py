"""Workers that die, fail, or want too much memory: each of it is a row, and the grid goes on."""

import sys
from pathlib import Path
from typing import Any

import grid_workers
import numpy as np
import pytest
from grid_workers import DIES_ALWAYS, DIES_ONCE, IS_ASKED_TO_END, planned, row_of, tries

from stillroom.bench.grid import work, workers
from stillroom.bench.grid.axes import Grid, plan
from stillroom.bench.grid.rows import Cost, Row
from stillroom.bench.grid.work import bounded_memory, can_bound_memory, perform
from stillroom.bench.grid.workers import DIED, check_backend, finished
from stillroom.errors import NO_MEMORY, ConfigError, StillroomError
from stillroom.version import __version__

RETRIED = Cost(attempts=2)


def made(monkeypatch: pytest.MonkeyPatch, folder: Path, seeds: list[int], jobs: int) -> dict[int, Row]:
    """Return the rows of runs that are made in worker processes, by their seeds."""
    monkeypatch.setattr(workers, "perform_marked", grid_workers.perform_marked)
    rows = list(finished([planned(seed) for seed in seeds], Grid(jobs=jobs), folder))
    assert sorted(row.seed for row in rows) == sorted(seeds)
    assert not (folder / workers.BEGUN).exists()
    return {row.seed: row for row in rows}


@pytest.mark.skipif(sys.platform == "win32", reason="Windows sends no SIGKILL")
def test_a_worker_that_dies_is_retried_once_then_is_a_row(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    rows = made(monkeypatch, tmp_path, [0, DIES_ALWAYS, DIES_ONCE, 4], jobs=1)
    assert tries(tmp_path) == [0, DIES_ALWAYS, DIES_ALWAYS, DIES_ONCE, DIES_ONCE, 4]
    assert rows[0] == row_of(planned(0))
    assert rows[4] == row_of(planned(4))
    assert rows[DIES_ONCE] == row_of(planned(DIES_ONCE), cost=RETRIED)
    assert rows[DIES_ALWAYS] == row_of(planned(DIES_ALWAYS), DIED, RETRIED)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows sends no SIGKILL")
def test_runs_beside_one_that_dies_are_not_blamed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    seeds = [10, DIES_ALWAYS, *range(11, 17)]
    rows = made(monkeypatch, tmp_path, seeds, jobs=2)
    assert [seed for seed in seeds if rows[seed].error] == [DIES_ALWAYS]
    assert tries(tmp_path).count(DIES_ALWAYS) == 2


@pytest.mark.skipif(sys.platform == "win32", reason="Windows sends no SIGTERM")
def test_a_worker_that_is_asked_to_end_stops_no_grid(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A run makes an interruption of SIGTERM, which programs that watch the memory send; the user pressed nothing."""
    rows = made(monkeypatch, tmp_path, [IS_ASKED_TO_END, 0], jobs=1)
    assert rows[IS_ASKED_TO_END] == row_of(planned(IS_ASKED_TO_END), cost=RETRIED)


def failing(monkeypatch: pytest.MonkeyPatch, error: BaseException) -> Row:
    def attempt(*arguments: Any) -> Any:
        raise error

    monkeypatch.setattr(work, "attempt", attempt)
    (run,) = plan(Grid(("synthetic:walking,frames=9,cache=off",), ("orb-slam2",))).runs
    return perform(run)


def test_what_goes_wrong_in_a_run_is_its_row(monkeypatch: pytest.MonkeyPatch) -> None:
    assert failing(monkeypatch, StillroomError("no such thing")).error == "no such thing"
    assert failing(monkeypatch, ZeroDivisionError("a\nbug")).error == "ZeroDivisionError: a bug"
    assert failing(monkeypatch, MemoryError()).error == NO_MEMORY
    with pytest.raises(KeyboardInterrupt):
        failing(monkeypatch, KeyboardInterrupt())


def test_a_worker_of_another_version_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(work, "code_version", lambda: "0.0.7 abc")
    (run,) = plan(Grid(("synthetic:walking,frames=9,cache=off",), ("orb-slam2",))).runs
    assert perform(run).error.startswith(f"this worker has Stillroom 0.0.7 abc, the grid {__version__} ")


def test_memory_beyond_the_bound_is_refused_and_the_bound_is_lifted() -> None:
    if not can_bound_memory():
        pytest.skip("only Linux bounds the memory of a process")
    n_bytes = 1_500_000_000
    with bounded_memory(0.3), pytest.raises(MemoryError):
        np.zeros(n_bytes, dtype=np.uint8)
    with bounded_memory(None):
        assert len(np.zeros(n_bytes, dtype=np.uint8)) == n_bytes


def test_a_scheduler_that_is_gone_ends_the_grid_in_one_line() -> None:
    """Nothing is wrong with the runs: they are made when the grid goes on."""

    class Future:
        status = "cancelled"

    with pytest.raises(StillroomError, match="the scheduler is gone; begin again to go on"):
        workers._row_of(Future(), planned(0), "here:8786")


@pytest.mark.parametrize(
    ("grid", "says"),
    [
        (Grid(backend="ray"), "it must be joblib, or dask://HOST:PORT"),
        (Grid(backend="dask://somewhere"), "write it like dask://"),
        (Grid(backend="dask://here:8786", jobs=2), "the cluster's"),
        (Grid(backend="dask://here:8786", memory_gb=2.0), "the cluster's"),
    ],
)
def test_a_backend_that_does_not_fit_is_one_line(grid: Grid, says: str) -> None:
    with pytest.raises(ConfigError) as caught:
        check_backend(grid)
    assert says in str(caught.value)
