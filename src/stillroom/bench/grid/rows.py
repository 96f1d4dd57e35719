"""The rows of a grid: one line of `rows.jsonl` for each finished run, and `rows.csv` made of them."""

import csv
import json
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from io import StringIO
from pathlib import Path
from types import TracebackType
from typing import Any

from stillroom.bench.grid.axes import PlannedRun
from stillroom.bench.trial import Trial
from stillroom.data.replacing import cannot_be_written, replace_text
from stillroom.errors import ConfigError, StillroomError
from stillroom.evaluation.trajectory_errors import Alignment

ROWS, TABLE = "rows.jsonl", "rows.csv"
COST = "cost"


@dataclass(frozen=True)
class Cost:
    """What a run cost; unlike all else in a row it is another each time.

    Attributes:
        cpu_ms_a_frame: What a frame cost on average, network and mapping included, images read before [ms of CPU].
        seconds: The whole run, from opening the sequence to its figures [s of wall time].
        peak_memory_mb: The most memory that its process held [MB]; None where the system does not tell.
        attempts: How many workers it took: 2 where the first one died.
    """

    cpu_ms_a_frame: float | None = None
    seconds: float | None = None
    peak_memory_mb: float | None = None
    attempts: int = 1


@dataclass(frozen=True)
class Row:
    """The figures of one run of a grid; those of a run that failed are None.

    Attributes:
        sequence, frames, method, setting, seed: Which run; `setting` is what is varied.
        n_given, n_tracked, n_keyframes: Frames recorded, frames with a pose, and keyframes made.
        ate_m, ate_camera_m: ATE RMSE after `alignment` [m], ground truth as given, and moved to the camera where the
            given one is of another body; None without ground truth.
        rpe_m_s, rpe_deg_s: RPE RMSE over 1 s [m/s, deg/s].
        error: Why it failed, in one line; "" where it did not.
        digest: Identifies the run; see `PlannedRun`.
        version: The version of Stillroom, and a digest of its sources.
        cost: What it cost.
        alignment: How the trajectory was aligned for its errors: by Sim(3) where it is up to scale.
    """

    sequence: str
    frames: str
    method: str
    setting: str
    seed: int
    n_given: int | None
    n_tracked: int | None
    n_keyframes: int | None
    ate_m: float | None
    ate_camera_m: float | None
    rpe_m_s: float | None
    rpe_deg_s: float | None
    error: str
    digest: str
    version: str
    cost: Cost
    alignment: str = Alignment.SE3

    @staticmethod
    def of(run: PlannedRun, trial: Trial, cost: Cost) -> "Row":
        """Return the row of a run that went well."""
        at_camera = None if trial.evaluation is None else trial.evaluation.at_camera
        rpe_m_s, rpe_deg_s = trial.rpe or (None, None)
        figures = {
            "n_given": trial.n_given,
            "n_tracked": trial.n_tracked,
            "n_keyframes": trial.n_keyframes,
            "ate_m": trial.ate_m,
            "ate_camera_m": None if at_camera is None else at_camera.ate_m.rmse,
            "rpe_m_s": rpe_m_s,
            "rpe_deg_s": rpe_deg_s,
        }
        by = Alignment.SE3 if trial.evaluation is None else trial.evaluation.alignment
        return replace(_row(run, figures, "", cost), alignment=by)

    @staticmethod
    def failed(run: PlannedRun, why: str, cost: Cost) -> "Row":
        """Return the row of a run that failed."""
        return _row(run, dict.fromkeys(FIGURES), " ".join(why.split()), cost)


FIGURES = tuple(field.name for field in fields(Row))[5:12]
COLUMNS = (*(f.name for f in fields(Row) if f.name != COST), *(f"{COST}_{f.name}" for f in fields(Cost)))
"""The columns of `rows.csv`: all that is the same each time, then what a run cost."""


def _row(run: PlannedRun, figures: Mapping[str, Any], error: str, cost: Cost) -> Row:
    return Row(
        sequence=run.sequence,
        frames=run.frames or "",
        method=run.method,
        setting=run.setting,
        seed=run.seed,
        error=error,
        digest=run.digest,
        version=run.version,
        cost=cost,
        **figures,
    )


# The rows on disk.


def read_rows(path: Path) -> tuple[list[Row], int]:
    """Return the rows of a `rows.jsonl`, none where it is not there, and how many bytes of it are whole lines.

    A last line without its end is what a kill or a power cut leaves of a row that was being written; it is left out.

    Raises:
        StillroomError: The file cannot be read, or a whole line of it is no row.
    """
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        return [], 0
    except OSError as error:
        raise StillroomError(f"{path}: cannot be read ({error.strerror})") from error
    n_whole = content.rfind(b"\n") + 1
    rows = []
    for number, line in enumerate(content[:n_whole].splitlines(), start=1):
        try:
            values = json.loads(line)
            rows.append(Row(**values | {COST: Cost(**values[COST])}))
        except (ValueError, TypeError, KeyError) as error:
            raise StillroomError(
                f"{path}:{number}: is no row of a grid; remove the line, or name a new --out"
            ) from error
    return rows, n_whole


class RowFile:
    """The `rows.jsonl` of a grid, open for appending by one grid at a time.

    Attributes:
        rows: All rows in it, in the order in which they came.
        n_torn: Bytes of a row that was not written to its end, which was cut off.
    """

    def __init__(self, path: Path) -> None:
        """Name the file; it is opened when it is entered."""
        self._path = path
        self._file = -1
        self.rows: list[Row] = []
        self.n_torn = 0

    def __enter__(self) -> "RowFile":
        """Open it, and cut off a torn last line.

        Raises:
            ConfigError: Another grid writes into it.
            StillroomError: It cannot be read or written, or a line of it is no row.
        """
        try:
            self._file = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_BINARY", 0), 0o666)
        except OSError as error:
            raise cannot_be_written(self._path, error) from error
        try:
            self._lock()
            self.rows, n_whole = read_rows(self._path)
            self.n_torn = os.fstat(self._file).st_size - n_whole
            if self.n_torn:
                os.ftruncate(self._file, n_whole)
        except BaseException:
            os.close(self._file)
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Close it."""
        os.close(self._file)

    def append(self, row: Row) -> None:
        """Add a row; it is on the disk when this returns, and where it cannot be, no part of it is.

        Raises:
            StillroomError: It cannot be written.
        """
        line = (json.dumps(asdict(row), ensure_ascii=False, allow_nan=False) + "\n").encode()
        size = os.fstat(self._file).st_size
        try:
            n_written = os.write(self._file, line)
            if n_written < len(line):  # the next write says why
                os.write(self._file, line[n_written:])
            os.fsync(self._file)
        except OSError as error:
            os.ftruncate(self._file, size)
            raise cannot_be_written(self._path, error) from error
        self.rows.append(row)

    def _lock(self) -> None:
        """Keep other grids out until this process closes the file or ends; Windows has no such lock."""
        try:
            import fcntl
        except ImportError:
            return
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ConfigError(f"{self._path}: another grid writes into it; name another --out") from None


def in_order(runs: Sequence[PlannedRun], rows: Iterable[Row]) -> list[Row]:
    """Return the rows of a grid's runs in the grid's order; of several rows of one run, the last.

    Another grid may have come to the same run by another setting, such as by what is the default here.
    """
    newest = {row.digest: row for row in rows}
    return [replace(newest[run.digest], setting=run.setting) for run in runs if run.digest in newest]


def write_table(path: Path, rows: Iterable[Row]) -> None:
    """Write rows as CSV under `COLUMNS`; None is an empty cell.

    Raises:
        StillroomError: It cannot be written; what was there is there still.
    """
    text = StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for row in rows:
        values = asdict(row)
        cost = values.pop(COST)
        writer.writerow(["" if value is None else value for value in (*values.values(), *cost.values())])
    replace_text(path, text.getvalue())
