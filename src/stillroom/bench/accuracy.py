"""The accuracy of several methods over several seeds. One run proves nothing (docs/reference.md#comparing-figures)."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from stillroom.bench.trial import Trial
from stillroom.evaluation.earlier import Earlier
from stillroom.evaluation.report import percent, said_alignment
from stillroom.evaluation.timing import processor
from stillroom.evaluation.trajectory_errors import Alignment, Spread, improvement_percent

HEADER = ("method", "ATE median", "mean", "min", "max", "improvement", "tracked", "RPE m/s", "deg/s")
"""Names of the columns of `Accuracy.row`; ATE in m."""
SMOOTHNESS_HEADER = (
    "method", "jitter [mm]", "faster than 1 s [mm]", "slower [mm]", "power > 1 Hz", "online ATE", "online jitter",
    "lagged ATE", "lagged jitter", "ms a frame",
)  # fmt: skip
"""Names of the columns of `Accuracy.smoothness_row`; milliseconds are of CPU."""
NONE = "–"
ATE_KEYS = {Alignment.SE3: "ate_se3_m", Alignment.SIM3: "ate_sim3_m"}
"""The name of the ATE in JSON."""


@dataclass(frozen=True)
class EarlierSpread:
    """The figures of poses as they were known earlier, over several runs.

    Attributes:
        ate_m: ATE RMSE, SE(3), ground truth as given [m].
        jitter_m: Jitter [m]; None where one of the runs has none.
    """

    ate_m: Spread
    jitter_m: Spread | None

    @property
    def jitter_cell(self) -> str:
        """The median jitter for a table [mm]."""
        return NONE if self.jitter_m is None else f"{1e3 * self.jitter_m.median:.1f}"

    @staticmethod
    def of(runs: Sequence[Earlier | None]) -> "EarlierSpread | None":
        """Return those of some runs; None where one has none."""
        known = [run for run in runs if run is not None]
        if len(known) < len(runs) or not known:
            return None
        jitters_m = [run.jitter_m for run in known if run.jitter_m is not None]
        jitter_m = Spread.of(jitters_m) if len(jitters_m) == len(known) else None
        return EarlierSpread(Spread.of([run.ate_m for run in known]), jitter_m)


@dataclass(frozen=True)
class Accuracy:
    """The figures of one method on one sequence over several seeds.

    Attributes:
        sequence: Name of the sequence.
        method: Name of the method.
        trials: One run for each seed; at least one.
    """

    sequence: str
    method: str
    trials: tuple[Trial, ...]

    @property
    def ate_m(self) -> Spread | None:
        """ATE RMSE, ground truth as given [m]; None where one of the runs has none."""
        figures = [trial.ate_m for trial in self.trials]
        known = [figure for figure in figures if figure is not None]
        return Spread.of(known) if len(known) == len(figures) else None

    @property
    def alignment(self) -> Alignment:
        """How the trajectories were aligned for it: those of one method on one sequence are of one kind."""
        known = [trial.evaluation.alignment for trial in self.trials if trial.evaluation is not None]
        return known[0] if known else Alignment.SE3

    @property
    def coverage(self) -> Spread:
        """Share of the frames that have a pose, 0 to 1."""
        return Spread.of([trial.coverage for trial in self.trials])

    @property
    def rpe(self) -> tuple[Spread, Spread] | None:
        """RPE RMSE over 1 s, translation [m/s] and rotation [deg/s]; None where one of the runs has none."""
        known = [trial.rpe for trial in self.trials if trial.rpe is not None]
        if len(known) < len(self.trials):
            return None
        return Spread.of([figure[0] for figure in known]), Spread.of([figure[1] for figure in known])

    @property
    def smoothness_mm(self) -> tuple[Spread, Spread, Spread] | None:
        """Jitter, and the RMS of the error faster and slower than one second [mm]; None where a run has none."""
        found = [trial.smoothness for trial in self.trials]
        known = [smooth for smooth in found if smooth is not None]
        if len(known) < len(found):
            return None
        parts = [(each.jitter_m, each.fast_m, each.slow_m) for each in known]
        jitter, fast, slow = (Spread.of([1e3 * part.rmse for part in column]) for column in zip(*parts, strict=True))
        return jitter, fast, slow

    @property
    def fast_power(self) -> Spread | None:
        """Power of the motion above 1 Hz as a share of the true one's; None where a run has none."""
        known = [smooth.fast_power for trial in self.trials if (smooth := trial.smoothness) is not None]
        shares = [share for share in known if share is not None]
        return Spread.of(shares) if len(shares) == len(self.trials) else None

    @property
    def earlier(self) -> tuple[EarlierSpread | None, EarlierSpread | None]:
        """Figures of the poses as known online and a few frames later; None where a run has none."""
        known = [trial.evaluation for trial in self.trials if trial.evaluation is not None]
        whole = len(known) == len(self.trials)
        online, lagged = ([one.online for one in known], [one.lagged for one in known]) if whole else ([None], [None])
        return EarlierSpread.of(online), EarlierSpread.of(lagged)

    @property
    def still_camera_m(self) -> float | None:
        """ATE of the static-pose baseline [m], over the poses of the first run: a camera that never moved."""
        evaluation = self.trials[0].evaluation
        return None if evaluation is None else evaluation.as_given.still_camera_m

    @property
    def frame_cpu_ms(self) -> Spread:
        """What a frame cost on average [ms of CPU]."""
        return Spread.of([trial.frame_cpu_ms for trial in self.trials])

    def ate_cells(self) -> tuple[str, str, str]:
        """Return the ATE's median, least and largest for a table."""
        ate_m = self.ate_m
        if ate_m is None:
            return NONE, NONE, NONE
        return f"{ate_m.median:.4f}", f"{ate_m.min:.4f}", f"{ate_m.max:.4f}"

    def improvement_percent(self, baseline: "Accuracy") -> float | None:
        """Return how far the median ATE lies below a baseline's [%]; None where there is nothing to compare."""
        ours, theirs = self.ate_m, baseline.ate_m
        return None if ours is None or theirs is None else improvement_percent(theirs.median, ours.median)

    def row(self, baseline: "Accuracy") -> tuple[str, ...]:
        """Return the cells under `HEADER`: coverage is the worst run's, RPE the median."""
        ate_m, rpe = self.ate_m, self.rpe
        gain = None if baseline is self else self.improvement_percent(baseline)
        spread = [NONE] * 4 if ate_m is None else [f"{v:.4f}" for v in (ate_m.median, ate_m.mean, ate_m.min, ate_m.max)]
        drift = [NONE] * 2 if rpe is None else [f"{rpe[0].median:.4f}", f"{rpe[1].median:.3f}"]
        spread.append(NONE if gain is None else f"{gain:+.1f} %")
        return (self.method, *spread, percent(self.coverage.min), *drift)

    def smoothness_row(self) -> tuple[str, ...]:
        """Return the cells under `SMOOTHNESS_HEADER`: medians."""
        smooth = [NONE] * 3 if self.smoothness_mm is None else [f"{each.median:.1f}" for each in self.smoothness_mm]
        smooth.append(NONE if self.fast_power is None else f"{self.fast_power.median:.2f}")
        for known in self.earlier:
            smooth += [NONE] * 2 if known is None else [f"{known.ate_m.median:.4f}", known.jitter_cell]
        return (self.method, *smooth, f"{self.frame_cpu_ms.median:.1f}")

    def to_dict(self, baseline: "Accuracy") -> dict[str, Any]:
        """Return the figures for a JSON file."""
        ate_m, rpe = self.ate_m, self.rpe
        online, lagged = self.earlier
        return {
            "sequence": self.sequence,
            "method": self.method,
            ATE_KEYS[self.alignment]: None if ate_m is None else asdict(ate_m),
            "still_camera_m": self.still_camera_m,
            "improvement_percent": None if baseline is self else self.improvement_percent(baseline),
            "baseline": baseline.method,
            "coverage": asdict(self.coverage),
            "rpe_translation_m_s": None if rpe is None else asdict(rpe[0]),
            "jitter_fast_slow_mm": self.smoothness_mm and [asdict(each) for each in self.smoothness_mm],
            "fast_power": self.fast_power and asdict(self.fast_power),
            "online": online and asdict(online),
            "lagged": lagged and asdict(lagged),
            "frame_cpu_ms": asdict(self.frame_cpu_ms),
            "rpe_rotation_deg_s": None if rpe is None else asdict(rpe[1]),
            "runs": [trial.to_dict() for trial in self.trials],
        }


def aligned_by(table: Sequence[Accuracy]) -> str:
    """Return by what the trajectories of some rows were aligned, in words."""
    return said_alignment(trial.evaluation for row in table for trial in row.trials)


def sentences(table: Sequence[Accuracy], dense: bool = False) -> list[str]:
    """Return, for one sequence, notes on how to read the rows; `dense`: whether dense maps were made."""
    still = next((row.still_camera_m for row in table if row.still_camera_m is not None), None)
    n = len(table[0].trials)
    lines = [
        f"ATE: RMSE [m] after {aligned_by(table)} alignment, ground truth as given, over {n} run{'s' if n > 1 else ''} "
        f"with seeds 0 to {n - 1}; tracked: the worst run's share of {table[0].trials[0].n_given} frames; "
        "RPE over 1 s: median; jitter: RMS of the second difference of the position error from frame to frame, "
        "fast and slow: of the error faster and slower than one second, medians; power above 1 Hz: of the estimated "
        "motion, as a share of the true one's; online, lagged: poses as known when their images were processed, and a "
        "few frames later, of methods with a trajectory prior; "
        f"ms a frame: CPU time, network and mapping included, {'with' if dense else 'without'} the dense map, median "
        f"of the runs' means, one thread of: {processor()}"
    ]
    if still is None:
        return [*lines, "without ground truth, or without enough poses, there is nothing to measure against"]
    return [*lines, f"static-pose baseline (a camera that never moved): ATE {still:.4f} m"]
