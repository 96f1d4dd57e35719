"""Evaluate a results folder, or any trajectory file."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from stillroom.data.trajectory import Trajectory, read_tum
from stillroom.errors import StillroomError, TrajectoryError
from stillroom.evaluation.report import Evaluation, evaluate
from stillroom.evaluation.time_matching import TimeMatching
from stillroom.evaluation.trajectory_errors import Alignment
from stillroom.pipeline import results
from stillroom.pipeline.ornaments import ending_nothing
from stillroom.pipeline.plots import draw_plots
from stillroom.pipeline.reports.run_page import write_run_page
from stillroom.pipeline.results import results_folder

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class EvaluatedTrajectory:
    """A trajectory with its figures.

    Attributes:
        name: Name in tables and pictures.
        folder: Where figures and pictures were written; None if nothing was written.
        evaluation: The figures.
        pictures: What was drawn.
    """

    name: str
    folder: Path | None
    evaluation: Evaluation
    pictures: tuple[Path, ...] = ()


def evaluate_trajectory(
    trajectory: Trajectory,
    truth: results.Truth | None,
    n_given: int,
    online: Trajectory | None = None,
    lagged: Trajectory | None = None,
) -> Evaluation | None:
    """Evaluate a run; None, with a warning, where there is no ground truth or nothing to compare."""
    if truth is None:
        return None
    try:
        return evaluate(
            trajectory,
            truth.as_given,
            groundtruth_camera=truth.at_camera,
            n_given=n_given,
            online=online,
            lagged=lagged,
        )
    except TrajectoryError as error:
        log.warning("no figures: %s", error)
        return None


def evaluate_folder(
    path: Path,
    baseline: Path | None = None,
    write: bool = True,
    matching: TimeMatching | None = None,
    formats: Sequence[str] = (),
    alignment: Alignment | None = None,
) -> EvaluatedTrajectory:
    """Evaluate the run of a results folder again; its metrics.json, pictures and report are made again.

    Args:
        path: The folder; `latest` may stand for one.
        baseline: The folder of a run to compare it with.
        write: Whether to write anything.
        matching: How poses find those of the ground truth in time.
        formats: In which plots are drawn beside PNG: "svg", "pdf".
        alignment: By what trajectories are aligned; by what suits each, where not given.

    Raises:
        StillroomError: A folder is not a results folder.
        TrajectoryError: There is no ground truth, or nothing can be compared.
    """
    folder, trajectory, truth, evaluation = _measured(path, matching, alignment)
    trajectories = {folder.name: trajectory}
    if baseline is not None:
        other, other_trajectory, _, other_evaluation = _measured(baseline, matching, alignment)
        evaluation = evaluation.against(other_evaluation, other.name)
        trajectories[other.name] = other_trajectory
    if not write:
        return EvaluatedTrajectory(folder.name, None, evaluation)
    run = results.read_run_figures(folder)
    results.write_metrics(folder, evaluation.n_tracked, evaluation.n_given, evaluation, run)
    place = folder / results.PICTURES
    pictures = draw_plots(place, trajectories, truth.as_given, folder.name, matching, formats=formats)
    if (folder / results.REPORT).is_file():  # it shows the figures as they were
        with ending_nothing("the report is left as it was"):
            write_run_page(folder)
    return EvaluatedTrajectory(folder.name, folder, evaluation, pictures)


def evaluate_files(
    estimate: Path,
    truth: results.Truth,
    folder: Path | None,
    baseline: Path | None = None,
    matching: TimeMatching | None = None,
    formats: Sequence[str] = (),
    alignment: Alignment | None = None,
) -> EvaluatedTrajectory:
    """Evaluate a trajectory of any system.

    Args:
        estimate: A file in the TUM format.
        truth: The ground truth.
        folder: Where to write figures and pictures; None to write nothing.
        baseline: Another such file, to compare it with.
        matching: How poses find those of the ground truth in time.
        formats: In which plots are drawn beside PNG: "svg", "pdf".
        alignment: By what trajectories are aligned; where not given by SE(3), and those that a comment in their file
            calls up to scale by Sim(3).

    Raises:
        TrajectoryError: A file cannot be read, or nothing can be compared.
    """
    own = _read(estimate, alignment)
    evaluation = evaluate(own, truth.as_given, groundtruth_camera=truth.at_camera, matching=matching)
    trajectories = {estimate.stem: own}
    if baseline is not None:
        other = _read(baseline, alignment)
        figures = evaluate(other, truth.as_given, groundtruth_camera=truth.at_camera, matching=matching)
        evaluation = evaluation.against(figures, str(baseline))
        trajectories[str(baseline)] = other
    if folder is None:
        return EvaluatedTrajectory(estimate.stem, None, evaluation)
    results.write_metrics(folder, evaluation.n_tracked, None, evaluation, None)
    pictures = draw_plots(folder, trajectories, truth.as_given, estimate.stem, matching, formats=formats)
    return EvaluatedTrajectory(estimate.stem, folder, evaluation, pictures)


def _read(path: Path, alignment: Alignment | None) -> Trajectory:
    """Read a trajectory; its alignment may be asked for.

    Raises:
        TrajectoryError: It cannot be read.
    """
    trajectory = read_tum(path)
    if alignment is Alignment.SE3 and not trajectory.is_metric:
        log.warning("%s is up to scale; its errors after SE(3) alignment say nothing but how far its unit is off", path)
    return _aligned_by(alignment, trajectory)


def _aligned_by(alignment: Alignment | None, trajectory: Trajectory) -> Trajectory:
    """Return a trajectory as one that is aligned as asked for, or, where nothing is, by what suits it."""
    return trajectory if alignment is None else replace(trajectory, is_metric=alignment is Alignment.SE3)


def _measured(
    path: Path, matching: TimeMatching | None, alignment: Alignment | None
) -> tuple[Path, Trajectory, results.Truth, Evaluation]:
    folder = results_folder(path)
    if not (folder / results.FINAL).is_file():
        raise StillroomError(f"{folder}: no {results.FINAL} in it; is it the folder of a run?")
    trajectory, truth = _read(folder / results.FINAL, alignment), results.Truth.read(folder)
    if truth is None:
        raise TrajectoryError(
            f"{folder}: the sequence has no ground truth, or none that could be read, so there is nothing to "
            "compare it with [see troubleshooting: groundtruth]"
        )
    lagged = next(iter(sorted(folder.glob("trajectory_lag*.tum"))), None)
    online = folder / results.ONLINE if lagged is not None and (folder / results.ONLINE).is_file() else None
    evaluation = evaluate(
        trajectory,
        truth.as_given,
        groundtruth_camera=truth.at_camera,
        n_given=results.count_frames(folder),
        matching=matching,
        online=None if online is None else _aligned_by(alignment, read_tum(online)),
        lagged=None if lagged is None else _aligned_by(alignment, read_tum(lagged)),
    )
    return folder, trajectory, truth, evaluation
