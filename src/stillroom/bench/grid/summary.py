"""What the rows of a grid come to: a table for each sequence, and what the runs that are left will take."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby
from statistics import fmean

from stillroom.bench.accuracy import NONE
from stillroom.bench.grid.axes import PlannedRun
from stillroom.bench.grid.rows import Row
from stillroom.evaluation.report import percent
from stillroom.evaluation.trajectory_errors import Alignment, Spread

HEADER = ("method", "setting", "runs", "ATE median", "min", "max", "tracked", "ms a frame")
"""Names of the columns of `Summary.row`; ATE in m, milliseconds of CPU."""


@dataclass(frozen=True)
class Summary:
    """The runs of one sequence, method and setting, which differ in their seeds.

    Attributes:
        sequence, method, setting: Which.
        n_planned: How many runs the grid has of it.
        rows: Those that are finished, failed ones among them.
    """

    sequence: str
    method: str
    setting: str
    n_planned: int
    rows: tuple[Row, ...]

    @property
    def sound(self) -> list[Row]:
        """The runs that did not fail."""
        return [row for row in self.rows if not row.error]

    @property
    def ate_m(self) -> Spread | None:
        """ATE RMSE, ground truth as given [m]; None where a run that did not fail has none."""
        figures = [row.ate_m for row in self.sound]
        known = [figure for figure in figures if figure is not None]
        return Spread.of(known) if known and len(known) == len(figures) else None

    def row(self) -> tuple[str, ...]:
        """Return the cells under `HEADER`: coverage is the worst run's, the time the median's."""
        ate_m = self.ate_m
        ate = [NONE] * 3 if ate_m is None else [f"{value:.4f}" for value in (ate_m.median, ate_m.min, ate_m.max)]
        coverage = [row.n_tracked / row.n_given for row in self.sound if row.n_given and row.n_tracked is not None]
        cost_ms = [row.cost.cpu_ms_a_frame for row in self.sound if row.cost.cpu_ms_a_frame is not None]
        n_sound = len(self.sound)
        return (
            self.method,
            self.setting,
            str(n_sound) if n_sound == self.n_planned else f"{n_sound} of {self.n_planned}",
            *ate,
            percent(min(coverage)) if coverage else NONE,
            f"{Spread.of(cost_ms).median:.1f}" if cost_ms else NONE,
        )


def summaries(runs: Iterable[PlannedRun], rows: Iterable[Row]) -> list[Summary]:
    """Return the summaries of a grid in its order."""
    by_digest = {row.digest: row for row in rows}
    found = []
    for (sequence, method, setting), group in groupby(runs, lambda run: (run.sequence, run.method, run.setting)):
        planned = list(group)
        done = tuple(by_digest[run.digest] for run in planned if run.digest in by_digest)
        found.append(Summary(sequence, method, setting, len(planned), done))
    return found


def sentences(rows: Sequence[Row]) -> list[str]:
    """Return notes on how to read the tables, and on the runs that failed."""
    aligned = " or ".join(dict.fromkeys(row.alignment for row in rows)) or Alignment.SE3
    lines = [
        f"ATE: RMSE [m] after {aligned} alignment, ground truth as given; tracked: the worst run's share of the "
        "frames; ms a frame: CPU time, network and mapping included, without the dense map, median of the runs' means; "
        "runs that failed count in none of these"
    ]
    failed = [row for row in rows if row.error]
    reasons = list(dict.fromkeys(row.error for row in failed))
    if failed:
        lines.append(f"{len(failed)} of {len(rows)} runs failed:")
    for reason in reasons:
        lines.append(f"  {sum(row.error == reason for row in failed)} × {reason}")
    return lines


# What is left to do.


@dataclass(frozen=True)
class Forecast:
    """What the runs that are left will take, from the rows that there are of the same methods.

    Attributes:
        seconds: Wall time [s] of all runs that something is known of, one after the other.
        memory_mb: The most that one worker will hold [MB]; None where nothing is known.
        unknown: Methods of which no run is finished, or whose sequences cannot be opened here.
    """

    seconds: float
    memory_mb: float | None
    unknown: tuple[str, ...]

    @staticmethod
    def of(left: Sequence[PlannedRun], rows: Iterable[Row]) -> "Forecast":
        """Return the forecast of some runs: for each, the mean time of a frame of its method, times its frames."""
        pace_s: dict[str, list[float]] = {}
        memory_mb: dict[str, float] = {}
        for row in rows:
            if row.error or not row.n_given:
                continue
            if row.cost.seconds is not None:
                pace_s.setdefault(row.method, []).append(row.cost.seconds / row.n_given)
            if row.cost.peak_memory_mb is not None:
                memory_mb[row.method] = max(memory_mb.get(row.method, 0.0), row.cost.peak_memory_mb)
        known = [run for run in left if run.method in pace_s and run.n_frames]
        others = [run.method for run in left if not (run.method in pace_s and run.n_frames)]
        return Forecast(
            seconds=sum(fmean(pace_s[run.method]) * run.n_frames for run in known),
            memory_mb=max((memory_mb[run.method] for run in left if run.method in memory_mb), default=None),
            unknown=tuple(dict.fromkeys(others)),
        )


def duration(seconds: float) -> str:
    """Return a time in words, to two digits or so."""
    if seconds < 100.0:
        return f"{seconds:.0f} s"
    if seconds < 100.0 * 60.0:
        return f"{seconds / 60.0:.0f} min"
    return f"{seconds / 3600.0:.1f} h"
