"""The runs behind a paper's tables: each system on each sequence, what was not run and why, and their trajectories."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from stillroom.bench.accuracy import Accuracy
from stillroom.bench.paper.published import Paper
from stillroom.bench.paper.sequences import Asked
from stillroom.config import SlamConfig
from stillroom.data.replacing import cannot_be_written
from stillroom.data.trajectory import Trajectory
from stillroom.errors import StillroomError
from stillroom.evaluation.trajectory_errors import Spread, Statistics

Measure = Callable[[str, SlamConfig], Accuracy]
"""Runs a config under a name, once for each seed."""


@dataclass(frozen=True)
class SystemRuns:
    """One system on one sequence.

    Attributes:
        system: The preset.
        accuracy: Its runs; None where it was not run.
        why_not: Why it was not, in one line.
        other: The same with loop closing the other way; None where that was not asked for, or not run.
        is_same: Whether `other` is the same runs: none closed a loop, or merged maps.
        has_loops: Whether the preset closes loops.
    """

    system: str
    accuracy: Accuracy | None
    why_not: str = ""
    other: Accuracy | None = None
    is_same: bool = False
    has_loops: bool = True

    @property
    def statistics(self) -> tuple[Spread, Spread, Spread] | None:
        """RMSE, mean and median of the errors of a run's poses over the runs [m]; None where a run has none."""
        return None if self.accuracy is None else errors_of(self.accuracy)

    @property
    def without_loops(self) -> "SystemRuns":
        """The same without loop closing; as it is where that was not asked for."""
        if not self.has_loops or (self.other is None and not self.why_not):
            return self
        return replace(self, accuracy=self.other, other=self.accuracy, has_loops=False)

    def to_dict(self, sequence: str, baseline: "SystemRuns | None") -> dict[str, Any]:
        """Return the figures for a JSON file."""
        if self.accuracy is None:
            other = {} if self.other is None else {"with_loops_the_other_way": self.other.to_dict(self.other)}
            return {"sequence": sequence, "method": self.system, "not_run": self.why_not} | other
        base = baseline.accuracy if baseline is not None and baseline.accuracy is not None else self.accuracy
        figures = self.accuracy.to_dict(base) | {"sequence": sequence}
        figures["loops_closed"] = [trial.n_loops for trial in self.accuracy.trials]
        figures["frame_wall_ms"] = [trial.frame_wall_ms for trial in self.accuracy.trials]
        also = None if self.other is None else self.other.to_dict(base)
        return figures | {"loops_enabled": self.has_loops, "with_loops_the_other_way": also}


@dataclass(frozen=True)
class SequenceRuns:
    """Everything that was run on one sequence.

    Attributes:
        asked: The sequence.
        systems: By preset, in the order of the rows.
        truth: The true poses as the data set gives them; None where it has none, or was not there.
        why_not: Why nothing was run, in one line.
    """

    asked: Asked
    systems: Mapping[str, SystemRuns] = field(default_factory=dict)
    truth: Trajectory | None = None
    why_not: str = ""

    def of(self, system: str) -> SystemRuns | None:
        """Return a system's runs; None where it was not even tried."""
        return self.systems.get(system)


def errors_of(accuracy: Accuracy) -> tuple[Spread, Spread, Spread] | None:
    """Return RMSE, mean and median of the ATE over the runs [m]; None where a run has no errors."""
    found: list[Statistics] = []
    for trial in accuracy.trials:
        if trial.evaluation is None:
            return None
        found.append(trial.evaluation.as_given.ate_m)
    rmse, mean, median = (Spread.of([getattr(one, name) for one in found]) for name in ("rmse", "mean", "median"))
    return rmse, mean, median


def run_system(name: str, config: SlamConfig, measure: Measure, both_loops: bool) -> SystemRuns:
    """Run a system; where something that it needs is absent, say so.

    With `both_loops` its runs with loop closing come first: where none of them closed a loop or merged maps, nothing
    can differ without, and they are not made again.

    Args:
        name: The preset.
        config: Its configuration.
        measure: Runs it.
        both_loops: Whether it is run with loop closing the other way too.

    Raises:
        KeyboardInterrupt: The user stopped it.
    """
    own = config.loops.enabled
    looped = replace(config, loops=replace(config.loops, enabled=True))
    first, why_not = _tried(f"{name}, with loops" if both_loops else name, looped if both_loops else config, measure)
    if first is None or not both_loops:
        return SystemRuns(name, first, why_not, has_loops=own)
    is_same = all(trial.n_jumps == 0 for trial in first.trials)
    without: Accuracy | None = first
    if not is_same:
        unlooped = replace(config, loops=replace(config.loops, enabled=False))
        without, why_not = _tried(f"{name}, without loops", unlooped, measure)
    chosen, other = (first, without) if own else (without, first)
    named = [None if each is None else replace(each, method=name) for each in (chosen, other)]
    return SystemRuns(name, named[0], why_not, named[1], is_same, own)


def _tried(name: str, config: SlamConfig, measure: Measure) -> tuple[Accuracy | None, str]:
    """Return the runs of a config, or why there are none."""
    try:
        return measure(name, config), ""
    except StillroomError as error:
        return None, f"{name}: not run: {error}"


def write_trajectories(folder: Path, found: SequenceRuns) -> list[Path]:
    """Write the trajectory of each run, and the ground truth, as TUM files into `<sequence>/`.

    Raises:
        StillroomError: One cannot be written.
    """
    place, written = folder / file_name(found.asked.name), []
    files: dict[str, Trajectory] = {} if found.truth is None else {"groundtruth.tum": found.truth}
    for system, runs in found.systems.items():
        for trial in () if runs.accuracy is None else runs.accuracy.trials:
            if trial.trajectory is not None and len(trial.trajectory):
                files[f"{system}_seed{trial.seed}.tum"] = trial.trajectory
    try:
        place.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise cannot_be_written(place, error) from error
    for name, trajectory in files.items():
        trajectory.write_tum(place / name)
        written.append(place / name)
    return written


def file_name(sequence: str) -> str:
    """Return a sequence's name as part of the name of a file."""
    return "".join(letter if letter.isalnum() or letter in "._-" else "-" for letter in sequence).strip("-")


def why_not(paper: Paper, found: Sequence[SequenceRuns]) -> list[str]:
    """Return a line for all that was not run."""
    lines = [one.why_not for one in found if one.why_not]
    for one in found:
        reasons = (runs.why_not for name in paper.systems if (runs := one.of(name)) is not None)
        lines += [f"{one.asked.name}: {reason}" for reason in reasons if reason]
    return lines
