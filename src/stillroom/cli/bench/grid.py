"""`stillroom bench grid`: many runs, with one row for each."""

import re
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from stillroom.bench.grid.axes import Grid, Plan, PlannedRun, plan, read_grid
from stillroom.bench.grid.rows import ROWS, TABLE, Row, RowFile, in_order, read_rows, write_table
from stillroom.bench.grid.summary import HEADER, Forecast, duration, sentences, summaries
from stillroom.bench.grid.work import can_bound_memory
from stillroom.bench.grid.workers import check_backend, finished, n_jobs
from stillroom.bounds import check
from stillroom.cli.arguments import Settings
from stillroom.cli.bench.session import Camera, Frames
from stillroom.cli.output import STDERR, print_lines, print_table, say, show_log
from stillroom.cli.warmup import ensure_warm
from stillroom.data.replacing import replace_text
from stillroom.errors import ConfigError, StillroomError
from stillroom.pipeline.results import new_folder
from stillroom.stopping import INTERRUPTED

FILE = "grid.toml"


GridFile = Annotated[
    Path | None, typer.Argument(metavar="[FILE]", help="A grid as TOML, such as the grid.toml of an earlier one.")
]
Seeds = Annotated[str | None, typer.Option(metavar="A,B|A:B", help="Seeds, such as 0,1,2 or 0:3.")]
Vary = Annotated[
    list[str] | None,
    typer.Option(metavar="KEY=A,B", help="Run each with each value, such as tracking.min_inliers=20,30; repeatable."),
]
Folder = Annotated[
    Path | None,
    typer.Option(metavar="DIR", help="Write into this folder, and go on where it stopped. \\[default: a new one]"),
]
Jobs = Annotated[int | None, typer.Option(min=1, metavar="N", help="Worker processes. \\[default: one for each core]")]
Backend = Annotated[str | None, typer.Option(metavar="NAME", help="joblib, or dask://HOST:PORT. \\[default: joblib]")]
Memory = Annotated[float | None, typer.Option("--memory-gb", metavar="N", help="Memory that a worker may hold [GB].")]
DryRun = Annotated[
    bool, typer.Option("--dry-run", help="Only say how many runs there are, how long they take, and what memory.")
]


def grid(
    file: GridFile = None,
    sequences: Annotated[str | None, typer.Option(metavar="A,B", help="Sequences, as for run.")] = None,
    methods: Annotated[str | None, typer.Option(metavar="A,B", help="Methods, or all.")] = None,
    seeds: Seeds = None,
    settings: Settings = None,
    vary: Vary = None,
    frames: Frames = None,
    camera: Camera = None,
    out: Folder = None,
    jobs: Jobs = None,
    backend: Backend = None,
    memory_gb: Memory = None,
    dry_run: DryRun = False,
    retry: Annotated[bool, typer.Option("--retry", help="Make runs again that failed.")] = False,
) -> None:
    """Run each method on each sequence with each seed and setting, several at a time; one row for each run.

    A grid that was stopped or killed goes on where it was with the same --out, or by naming its grid.toml. A run that
    fails is a row that says why. Options replace what FILE says.
    """
    asked: dict[str, Any] = {
        "sequences": None if sequences is None else tuple(split_sequences(sequences)),
        "methods": None if methods is None else tuple(_split(methods)),
        "seeds": None if seeds is None else read_seeds(seeds),
        "set": None if settings is None else tuple(settings),
        "vary": None if vary is None else tuple(vary),
        "frames": frames,
        "camera": camera,
        "jobs": jobs,
        "backend": backend,
        "memory_gb": memory_gb,
    }
    whole = replace(Grid() if file is None else read_grid(file), **{k: v for k, v in asked.items() if v is not None})
    if not whole.sequences:
        raise ConfigError("the grid has no sequence; write it like --sequences A,B")
    check(whole)
    check_backend(whole)
    show_log()
    planned = plan(whole)
    if out is None and file is not None and (file.parent / ROWS).exists():
        out = file.parent
    if dry_run:
        print_lines(_forecast(whole, planned, [] if out is None else read_rows(out / ROWS)[0], retry))
        return
    _run(whole, planned, _folder(out), retry)


# From options to a grid.


def split_sequences(text: str) -> list[str]:
    """Split names at commas; what follows as `key=value` belongs to the sequence before it, as in synthetic:…."""
    return [name.strip() for name in re.split(r",(?!\s*\w+=)", text) if name.strip()]


def read_seeds(text: str) -> tuple[int, ...]:
    """Read `0,1,2`, or `0:3` for the same.

    Raises:
        ConfigError: It is neither.
    """
    try:
        first, colon, end = text.partition(":")
        return tuple(range(int(first or "0"), int(end)) if colon else map(int, _split(text)))
    except ValueError:
        raise ConfigError(f"--seeds {text}: no list of seeds; write it like 0,1,2 or 0:3") from None


def _split(text: str) -> list[str]:
    return [part.strip() for part in text.split(",") if part.strip()]


def _folder(out: Path | None) -> Path:
    if out is None:
        return new_folder(Path("results"), "bench-grid", latest=False)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StillroomError(f"{out}: cannot be made a folder ({error.strerror}); name another --out") from error
    return out


# Running it.


def _left(planned: Plan, rows: Sequence[Row], retry: bool) -> list[PlannedRun]:
    """Return the runs that have no row yet; with `retry`, those that failed too."""
    done = {row.digest for row in in_order(planned.runs, rows) if not (retry and row.error)}
    return list({run.digest: run for run in planned.runs if run.digest not in done}.values())


def _run(grid: Grid, planned: Plan, folder: Path, retry: bool) -> None:
    is_stopped = False
    with RowFile(folder / ROWS) as file:
        replace_text(folder / FILE, grid.to_toml())
        left = _left(planned, file.rows, retry)
        for line in _beginning(grid, planned, file, left):
            say(line)
        try:
            if grid.scheduler is None and left:
                ensure_warm(STDERR, planned.is_rendered)
            with _bar(left) as bar, closing(finished(left, grid, folder)) as rows:
                for row in rows:
                    file.append(row)
                    bar.row(row)
        except KeyboardInterrupt:
            is_stopped = True
        finally:
            rows_of_grid = in_order(planned.runs, file.rows)
            write_table(folder / TABLE, rows_of_grid)
        _print_summary(planned, rows_of_grid)
    print_lines([f"rows: {folder / TABLE}, {folder / ROWS}"])
    if is_stopped:
        say(f"stopped; 'stillroom bench grid {folder / FILE}' goes on")
        raise typer.Exit(INTERRUPTED)


def _beginning(grid: Grid, planned: Plan, file: RowFile, left: Sequence[PlannedRun]) -> Iterator[str]:
    n, digests = len(planned.runs), {run.digest for run in planned.runs}
    if file.n_torn:
        yield f"{ROWS}: its last line was not written to its end and is dropped; that run is made again"
    if len(left) < n:
        yield f"{n - len(left)} of {n} runs are done; {len(left)} are left"
    n_others = len({row.digest for row in file.rows} - digests)
    if n_others:
        yield f"{n_others} runs in {ROWS} are of another grid, input or version; they stay there, and out of {TABLE}"
    if grid.memory_gb is not None and not can_bound_memory():
        yield "this system bounds the memory of no process: --memory-gb does nothing here; give fewer --jobs"


def _print_summary(planned: Plan, rows: Sequence[Row]) -> None:
    found = summaries(planned.runs, rows)
    varies = any(one.setting for one in found)
    kept = [place for place, name in enumerate(HEADER) if varies or name != "setting"]
    for sequence in dict.fromkeys(one.sequence for one in found):
        print_lines(["", sequence])
        body = [one.row() for one in found if one.sequence == sequence]
        cells = [tuple(row[place] for place in kept) for row in (HEADER, *body)]
        print_table(cells[0], cells[1:], n_words=2 if varies else 1)
    print_lines(sentences(rows))


def _forecast(grid: Grid, planned: Plan, rows: Sequence[Row], retry: bool) -> list[str]:
    left = _left(planned, rows, retry)
    failed = sum(bool(row.error) for row in in_order(planned.runs, rows))
    n = len(planned.runs)
    lines = [f"{n} runs, {n - len(left)} done, {len(left)} to do" + (f"; {failed} failed" if failed else "")]
    if not left:
        return lines
    ahead = Forecast.of(left, rows)
    workers = 1 if grid.scheduler is not None else min(n_jobs(grid), len(left))
    with_them = f"with {workers} worker{'s' if workers > 1 else ''}"
    if ahead.unknown:
        reason = "no run is finished, or a sequence cannot be opened here"
        lines.append(f"time unknown for {', '.join(ahead.unknown)}: {reason}")
    if ahead.seconds:
        rest = "the others" if ahead.unknown else "all"
        lines.append(f"{rest}: about {duration(ahead.seconds / workers)} {with_them}")
    if ahead.memory_mb is None:
        lines.append("memory unknown")
    else:
        total = "" if workers == 1 else f", {ahead.memory_mb * workers:.0f} MB {with_them}"
        lines.append(f"memory: up to {ahead.memory_mb:.0f} MB a worker{total}")
    return lines


# Progress.


class GridBar:
    """Shows how many runs are finished and the time left; for each run a line."""

    def __init__(self, bars: Progress, left: Sequence[PlannedRun]) -> None:
        """Begin; the time left is counted in frames, as sequences differ in length."""
        self._bars = bars
        self._left = {run.digest: run for run in left}
        self._n, self._n_frames, self._frames_done = len(left), sum(run.n_frames for run in left), 0
        self._start_s = time.perf_counter()
        self._task = bars.add_task("runs", total=len(left))

    def row(self, row: Row) -> None:
        """Print a finished run in one line."""
        run = self._left.pop(row.digest)
        self._frames_done += run.n_frames
        n_done, ahead = self._n - len(self._left), self._time_left()
        self._bars.update(self._task, completed=n_done, description=f"runs{ahead}")
        ate = "" if row.ate_m is None else f", ATE {row.ate_m:.4f} m"
        came = f"failed: {row.error}" if row.error else f"{row.n_tracked} of {row.n_given} frames tracked{ate}"
        say(f"{n_done}/{self._n}  {run.name}: {came}{ahead}")

    def _time_left(self) -> str:
        if not self._left or not self._frames_done:
            return ""
        elapsed_s = time.perf_counter() - self._start_s
        left_s = elapsed_s * (self._n_frames - self._frames_done) / self._frames_done
        return f"; about {duration(left_s)} left"


@contextmanager
def _bar(left: Sequence[PlannedRun]) -> Iterator[GridBar]:
    columns: Any = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=STDERR, transient=True, disable=not STDERR.is_terminal) as bars:
        yield GridBar(bars, left)
