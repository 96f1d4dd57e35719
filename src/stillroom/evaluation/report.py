"""All figures of one trajectory together."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

from stillroom.data.trajectory import Trajectory
from stillroom.errors import TrajectoryError
from stillroom.evaluation.earlier import Earlier, earlier
from stillroom.evaluation.smoothness import Smoothness, smoothness
from stillroom.evaluation.time_matching import TimeMatching, estimate_offset_s
from stillroom.evaluation.trajectory_errors import (
    Alignment,
    RelativeError,
    SparseTruthError,
    Statistics,
    ate,
    improvement_percent,
    rpe,
    rpe_frames,
)

AS_GIVEN = "as given"
AT_CAMERA = "moved to the camera"
HEADER = ("error", "ground truth", "rmse", "mean", "median", "std", "min", "max")
"""Names of the columns of `rows`."""


@dataclass(frozen=True)
class Comparison:
    """An estimate compared with one ground truth.

    Attributes:
        groundtruth: Which ground truth, in words that follow "ground truth".
        n_compared: Poses compared.
        ate_se3_m, ate_sim3_m: Absolute errors after rigid alignment, and after one that may scale [m].
        scale: The scale that Sim(3) alignment found.
        still_camera_m: ATE RMSE of the static-pose baseline (a camera that never moved), over the same poses [m]; the
            same by either alignment.
        rpe_1s: Drift over 1 s [m/s, deg/s], TUM's rule; None for a trajectory too short for it.
        rpe_30_frames: Drift over 30 poses [m, deg], evo's rule; None for a trajectory too short for it.
        rpe_refused: Why there are no relative errors, where it is not for want of poses; empty otherwise.
        smoothness: Jitter, and the error faster and slower than one second; None where too few poses follow each other.
        alignment: How the estimate was aligned: by Sim(3) where it is up to scale. Relative errors and smoothness are
            then those of the scaled estimate.
    """

    groundtruth: str
    n_compared: int
    ate_se3_m: Statistics
    ate_sim3_m: Statistics
    scale: float
    still_camera_m: float
    rpe_1s: RelativeError | None
    rpe_30_frames: RelativeError | None
    rpe_refused: str = ""
    smoothness: Smoothness | None = None
    alignment: Alignment = Alignment.SE3

    @property
    def ate_m(self) -> Statistics:
        """Absolute errors after the estimate's own alignment [m]: the ATE that tables quote."""
        return self.ate_by(self.alignment)

    def ate_by(self, alignment: Alignment) -> Statistics:
        """Return the absolute errors after an alignment [m]."""
        return self.ate_se3_m if alignment is Alignment.SE3 else self.ate_sim3_m


@dataclass(frozen=True)
class Improvement:
    """How far RMSEs lie below a baseline's, (1 − β/α)·100 [%]; None where there is nothing to compare.

    Where either trajectory is up to scale, the ATE of both is that after Sim(3).
    """

    baseline: str
    ate_percent: float | None
    rpe_translation_percent: float | None
    rpe_rotation_percent: float | None


@dataclass(frozen=True)
class Evaluation:
    """All figures of one trajectory.

    Attributes:
        n_tracked: Frames with a pose.
        n_given: Frames that were recorded: those that the run was given, and colour images that have no depth image.
            None where only a trajectory file is known.
        as_given: Figures against the ground truth as the data set gives it; this is the ATE that tables quote.
        at_camera: Figures against the ground truth moved to the camera, where the given one is of another body
            (Bonn: a marker). Relative errors there mean something only with this one
            (docs/reference.md#bonn-ground-truth).
        improvement: Against a baseline run, where one was named.
        offset_s: What was added to the estimate's times [s].
        interpolated: Whether the ground truth was interpolated at the estimate's times.
        online: Figures of the poses as known when their images were processed, of methods with a trajectory prior.
        lagged: The same of the poses as settled a few frames later.
    """

    n_tracked: int
    n_given: int | None
    as_given: Comparison
    at_camera: Comparison | None = None
    improvement: Improvement | None = None
    offset_s: float = 0.0
    interpolated: bool = False
    online: Earlier | None = None
    lagged: Earlier | None = None

    @property
    def coverage(self) -> float | None:
        """Share of the given frames that have a pose, 0 to 1; None where the number given is not known."""
        return self.n_tracked / self.n_given if self.n_given else None

    @property
    def alignment(self) -> Alignment:
        """How the estimate was aligned."""
        return self.as_given.alignment

    @property
    def for_rpe(self) -> Comparison:
        """The comparison whose relative errors are meaningful."""
        return self.at_camera or self.as_given

    def against(self, baseline: "Evaluation", name: str) -> "Evaluation":
        """Return the same figures with their improvement over a named baseline."""
        by = Alignment.SE3 if self.alignment is baseline.alignment is Alignment.SE3 else Alignment.SIM3
        ate_percent = improvement_percent(baseline.as_given.ate_by(by).rmse, self.as_given.ate_by(by).rmse)
        ours, theirs = self.for_rpe.rpe_1s, baseline.for_rpe.rpe_1s
        if ours is None or theirs is None:
            return replace(self, improvement=Improvement(name, ate_percent, None, None))
        improvement = Improvement(
            baseline=name,
            ate_percent=ate_percent,
            rpe_translation_percent=improvement_percent(theirs.translation_m.rmse, ours.translation_m.rmse),
            rpe_rotation_percent=improvement_percent(theirs.rotation_deg.rmse, ours.rotation_deg.rmse),
        )
        return replace(self, improvement=improvement)


def evaluate(
    estimate: Trajectory,
    groundtruth: Trajectory,
    *,
    groundtruth_camera: Trajectory | None = None,
    n_given: int | None = None,
    matching: TimeMatching | None = None,
    online: Trajectory | None = None,
    lagged: Trajectory | None = None,
) -> Evaluation:
    """Compute all figures of a trajectory that the literature reports.

    Args:
        estimate: Poses of the camera, one for each tracked frame.
        groundtruth: True poses as the data set gives them.
        groundtruth_camera: True poses of the camera itself, where those given are of another body.
        n_given: Frames that were recorded.
        matching: How poses find each other in time; as TUM's tools do it where not given.
        online, lagged: Poses as known when their images were processed, and a few frames later, where they matter.

    Raises:
        TrajectoryError: They cannot be compared.
    """
    matching = matching or TimeMatching()
    if matching.offset_s is None:
        matching = replace(matching, offset_s=estimate_offset_s(estimate, groundtruth))
    at_camera = None
    if groundtruth_camera is not None:
        at_camera = compare(estimate, groundtruth_camera, AT_CAMERA, matching)
    return Evaluation(
        n_tracked=len(estimate),
        n_given=n_given,
        as_given=compare(estimate, groundtruth, AS_GIVEN, matching),
        at_camera=at_camera,
        offset_s=matching.offset_s or 0.0,
        interpolated=matching.interpolate,
        online=_earlier(online, groundtruth, groundtruth_camera, matching),
        lagged=_earlier(lagged, groundtruth, groundtruth_camera, matching),
    )


def compare(
    estimate: Trajectory, groundtruth: Trajectory, name: str, matching: TimeMatching | None = None
) -> Comparison:
    """Compare an estimate with one ground truth, which has a name.

    Raises:
        TrajectoryError: They cannot be compared.
    """
    matching = matching or TimeMatching()
    max_gap_s = matching.max_gap_s
    given = groundtruth
    estimate, groundtruth = matching.match(estimate, groundtruth)
    absolute = ate(estimate, groundtruth, max_gap_s)
    over_1s, refused = _measured(lambda: rpe(estimate, groundtruth, max_gap_s=max_gap_s))
    over_30_frames, _ = _measured(lambda: rpe_frames(estimate, groundtruth, 30, max_gap_s))
    return Comparison(
        groundtruth=name,
        n_compared=absolute.n_compared,
        ate_se3_m=absolute.se3_m,
        ate_sim3_m=absolute.sim3_m,
        scale=absolute.scale,
        still_camera_m=absolute.still_camera_m,
        rpe_1s=over_1s,
        rpe_30_frames=over_30_frames,
        rpe_refused=refused,
        smoothness=_smoothness(estimate, given),
        alignment=absolute.alignment,
    )


def _earlier(
    estimate: Trajectory | None, groundtruth: Trajectory, at_camera: Trajectory | None, matching: TimeMatching
) -> Earlier | None:
    if estimate is None:
        return None
    try:
        return earlier(estimate, groundtruth, at_camera, matching)
    except TrajectoryError:  # too few poses were in the main sub-map then; the final ones are worth having
        return None


def _smoothness(estimate: Trajectory, groundtruth: Trajectory) -> Smoothness | None:
    try:
        return smoothness(estimate, groundtruth)
    except TrajectoryError:  # the trajectory is too short, or too few of its poses have truth around them
        return None


def _measured(measure: Callable[[], RelativeError]) -> tuple[RelativeError | None, str]:
    """Return what is measured; None where it cannot be, as an ATE alone is worth having, and why if that is news."""
    try:
        return measure(), ""
    except SparseTruthError as error:
        return None, str(error)
    except TrajectoryError:  # the trajectory is too short
        return None, ""


# An evaluation as text.


def rows(evaluation: Evaluation) -> list[tuple[str, ...]]:
    """Return one row of text for each kind of error, its cells as in `HEADER`; the unit stands in the first."""
    comparisons = (evaluation.as_given, evaluation.at_camera)
    table = [row for comparison in comparisons if comparison is not None for row in _rows(comparison)]
    return [*table, *_smoothness_rows(evaluation.for_rpe.groundtruth, evaluation.for_rpe.smoothness)]


def values(evaluation: Evaluation) -> list[tuple[float | None, ...]]:
    """Return the numbers of `rows`, exactly: those in the columns from "rmse" on; None where there is none."""
    comparisons = [given for given in (evaluation.as_given, evaluation.at_camera) if given is not None]
    errors: list[Statistics | None] = []
    for given in comparisons:
        errors += [given.ate_by(alignment) for alignment in _alignments(given)]
        for relative in (given.rpe_1s, given.rpe_30_frames):
            errors += [None, None] if relative is None else [relative.translation_m, relative.rotation_deg]
    smooth = evaluation.for_rpe.smoothness
    errors += [] if smooth is None else [smooth.slow_m, smooth.fast_m, smooth.jitter_m, smooth.jitter_deg]
    return [(None,) * 6 if s is None else (s.rmse, s.mean, s.median, s.std, s.min, s.max) for s in errors]


def lines(evaluation: Evaluation) -> list[str]:
    """Return notes on the rows, a sentence a line: coverage, pairs, convention, static-pose baseline."""
    sentences = [_coverage(evaluation)]
    for comparison in (evaluation.as_given, evaluation.at_camera):
        if comparison is not None:
            sentences.append(
                f"{comparison.n_compared} poses compared with the ground truth {comparison.groundtruth}; static-pose "
                f"baseline (a camera that never moved): ATE {comparison.still_camera_m:.4f} m "
                f"({comparison.alignment}, RMSE)"
            )
    if evaluation.alignment is Alignment.SIM3:
        sentences.append(
            "the trajectory is up to scale: it was aligned by Sim(3), and RPE and smoothness are of the scaled one"
        )
    if evaluation.offset_s:
        sentences.append(f"{evaluation.offset_s:+.4f} s were added to the estimate's times")
    if evaluation.interpolated:
        sentences.append("the ground truth was interpolated (SE(3)) at the estimate's times")
    if evaluation.for_rpe.rpe_refused:
        sentences.append(f"no RPE: {evaluation.for_rpe.rpe_refused}")
    if evaluation.at_camera is not None:
        sentences.append(
            f"RPE means something only against the ground truth {evaluation.at_camera.groundtruth}: the given poses "
            "are those of another body"
        )
    for when, known in (("when its image was processed", evaluation.online), ("a few frames later", evaluation.lagged)):
        if known is not None:
            jitter = "" if known.jitter_m is None else f", jitter {known.jitter_m:.4f} m"
            sentences.append(f"each pose as it was known {when}: ATE {known.ate_m:.4f} m{jitter}")
    smooth = evaluation.for_rpe.smoothness
    if smooth is not None and smooth.fast_power is not None:
        sentences.append(f"power of the motion above 1 Hz: {smooth.fast_power:.2f} of the true one's")
    if evaluation.improvement is not None:
        sentences.append(_improvement(evaluation.improvement))
    return sentences


def as_text(evaluation: Evaluation) -> str:
    """Return rows, aligned in columns, and sentences as one text without colour."""
    table = [HEADER, *rows(evaluation)]
    widths = [max(len(row[column]) for row in table) for column in range(len(HEADER))]
    text = []
    for row in table:
        words = [cell.ljust(width) for cell, width in zip(row[:2], widths[:2], strict=True)]
        numbers = [cell.rjust(width) for cell, width in zip(row[2:], widths[2:], strict=True)]
        text.append("  ".join([*words, *numbers]))
    return "\n".join([*text, "", *lines(evaluation)]) + "\n"


def percent(share: float | None) -> str:
    """Return a share of 1 as per cent, never rounded up to 100 %; '–' for None."""
    if share is None:
        return "–"
    text = f"{share * 100:.1f} %"
    return "99.9 %" if share < 1 and text == "100.0 %" else text


def _rows(comparison: Comparison) -> list[tuple[str, ...]]:
    truth, scaled = comparison.groundtruth, f", scale {comparison.scale:.4f}"
    return [
        *(
            _row(f"ATE [m], {by}" + scaled * (by is Alignment.SIM3), truth, comparison.ate_by(by), 4)
            for by in _alignments(comparison)
        ),
        *_relative_rows("over 1 s", ("m/s", "deg/s"), truth, comparison.rpe_1s),
        *_relative_rows("over 30 frames", ("m", "deg"), truth, comparison.rpe_30_frames),
    ]


def _alignments(comparison: Comparison) -> tuple[Alignment, ...]:
    """Return the alignments whose errors mean something."""
    return tuple(Alignment) if comparison.alignment is Alignment.SE3 else (Alignment.SIM3,)


def said_alignment(evaluations: Iterable[Evaluation | None]) -> str:
    """Return by what the trajectories of one table were aligned, in words."""
    used = {evaluation.alignment for evaluation in evaluations if evaluation is not None}
    if len(used) > 1:
        return f"{Alignment.SE3}, of trajectories that are up to scale {Alignment.SIM3},"
    return used.pop() if used else Alignment.SE3


def _smoothness_rows(truth: str, smooth: Smoothness | None) -> list[tuple[str, ...]]:
    if smooth is None:
        return []
    return [
        _row("error [m] slower than 1 s", truth, smooth.slow_m, 4),
        _row("error [m] faster than 1 s", truth, smooth.fast_m, 4),
        _row("jitter [m] from frame to frame", truth, smooth.jitter_m, 4),
        _row("jitter [deg] from frame to frame", truth, smooth.jitter_deg, 3),
    ]


def _relative_rows(
    interval: str, units: tuple[str, str], truth: str, error: RelativeError | None
) -> list[tuple[str, ...]]:
    translation, rotation = (f"RPE [{unit}] {interval}" for unit in units)
    if error is None:
        return [(name, truth, *["–"] * (len(HEADER) - 2)) for name in (translation, rotation)]
    return [_row(translation, truth, error.translation_m, 4), _row(rotation, truth, error.rotation_deg, 3)]


def _row(name: str, truth: str, s: Statistics, digits: int) -> tuple[str, ...]:
    return (name, truth, *(f"{value:.{digits}f}" for value in (s.rmse, s.mean, s.median, s.std, s.min, s.max)))


def _coverage(evaluation: Evaluation) -> str:
    if evaluation.n_given is None:
        return f"{evaluation.n_tracked} poses; of how many frames is not known, so neither is the coverage"
    return f"{evaluation.n_tracked} of {evaluation.n_given} frames tracked ({percent(evaluation.coverage)})"


def _improvement(gain: Improvement) -> str:
    parts = [
        f"{name} {value:+.1f} %"
        for name, value in (
            ("ATE", gain.ate_percent),
            ("RPE translation", gain.rpe_translation_percent),
            ("RPE rotation", gain.rpe_rotation_percent),
        )
        if value is not None
    ]
    return f"improvement over {gain.baseline} in RMSE, (1 − β/α)·100: {', '.join(parts) or 'not comparable'}"
