"""A finished run, as far as its folder tells of it."""

import csv
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stillroom.data.trajectory import Trajectory, read_tum
from stillroom.errors import StillroomError
from stillroom.evaluation.report import Evaluation
from stillroom.evaluation.report_file import from_json
from stillroom.evaluation.time_matching import TimeMatching
from stillroom.evaluation.trajectory_errors import AbsoluteError, ate
from stillroom.pipeline import results
from stillroom.pipeline.reading import read_config, read_stages, unless_missing
from stillroom.pipeline.results import results_folder

OF_A_RUN = (results.CONFIG, results.METRICS, results.FINAL)
"""A folder with none of these is no results folder."""


@dataclass(frozen=True)
class Frames:
    """Lines of frames.csv.

    Attributes:
        times_s: When each image was taken (N,) [s]; NaN where that is not known.
        states: State of tracking, or why there is none.
        counts: By name, numbers (N,) of each image: keypoints, static ones, and those that agree with the pose.
    """

    times_s: np.ndarray[Any, Any]
    states: tuple[str, ...]
    counts: Mapping[str, np.ndarray[Any, Any]]


@dataclass(frozen=True)
class Finished:
    """A finished run.

    Attributes:
        folder: Where it lies.
        config: Its configuration, with `run`, how it came about; empty where that is missing.
        config_text: The same as it was written.
        figures: What is in metrics.json; None where that is missing.
        evaluation: The errors among them; None where there are none.
        trajectory: Final poses; None where they are missing.
        truth: The true ones; None where there are none.
        error: The trajectory aligned with the truth, and its errors; None where that cannot be done.
        frames: What became of each image; None where that is missing.
        stages_ms: Wall time of each stage [ms], over the frames in which it ran.
        warnings: What was warned of.
        missing: What is not in the folder, and why.
    """

    folder: Path
    config: Mapping[str, Any]
    config_text: str
    figures: Mapping[str, Any] | None
    evaluation: Evaluation | None
    trajectory: Trajectory | None
    truth: Trajectory | None
    error: AbsoluteError | None
    frames: Frames | None
    stages_ms: Mapping[str, np.ndarray[Any, Any]]
    warnings: tuple[str, ...]
    missing: tuple[str, ...]

    @property
    def how(self) -> Mapping[str, Any]:
        """How it came about."""
        how = self.config.get("run", {})
        return how if isinstance(how, dict) else {}

    @property
    def method(self) -> str:
        """Name of the method; that of the folder where it is not known."""
        return str(self.config.get("method", self.folder.name))

    @property
    def sequence(self) -> str:
        """Name of the sequence; a dash where it is not known."""
        return str(self.how.get("name", "–"))

    @property
    def run(self) -> Mapping[str, Any]:
        """Figures of the run itself; empty where they are missing."""
        run = (self.figures or {}).get("run")
        return run if isinstance(run, dict) else {}

    @property
    def begin_s(self) -> float:
        """Time of the first image, or else of the first pose [s]; 0 where neither is known."""
        known = [] if self.frames is None else self.frames.times_s[np.isfinite(self.frames.times_s)]
        if len(known):
            return float(known[0])
        return float(self.trajectory.timestamps_s[0]) if self.trajectory is not None and len(self.trajectory) else 0.0

    def lost_s(self) -> list[tuple[float, float]]:
        """Return the stretches of time without a pose, from and to [s], counted from the first image."""
        if self.frames is None:
            return []
        is_known = np.isfinite(self.frames.times_s)
        times_s = self.frames.times_s[is_known] - self.begin_s
        is_lost = np.array([state != "ok" for state in self.frames.states], dtype=np.bool_)[is_known]
        edges = np.flatnonzero(np.diff(np.concatenate(([False], is_lost, [False])).astype(np.int8)))
        ends = zip(edges[::2], edges[1::2], strict=True)
        return [(float(times_s[first]), float(times_s[min(end, len(times_s) - 1)])) for first, end in ends]


def read_finished(path: Path) -> Finished:
    """Read a results folder; `latest` may stand for one.

    Raises:
        StillroomError: It is no results folder; a file that is missing or damaged is noted instead.
    """
    folder, missing = results_folder(path), list[str]()
    if not any((folder / name).is_file() for name in OF_A_RUN):
        raise StillroomError(f"{folder}: none of {', '.join(OF_A_RUN)} in it; is it the folder of a run?")
    figures = unless_missing("figures", lambda: _figures(folder / results.METRICS), missing)
    trajectory = unless_missing("trajectory", lambda: read_tum(folder / results.FINAL), missing)
    evaluation = unless_missing("errors", lambda: _evaluation(figures), missing)
    truth = unless_missing("ground truth", lambda: results.Truth.read(folder), missing)
    as_given = None if truth is None else truth.as_given
    error = None
    if trajectory is not None and as_given is not None and len(trajectory):
        error = unless_missing("error over time", lambda: _error(trajectory, as_given, evaluation), missing)
    stages_ms = unless_missing("time of each stage", lambda: _stages(folder / results.TIMING), missing)
    return Finished(
        folder=folder,
        config=unless_missing("configuration", lambda: read_config(folder), missing) or {},
        config_text=_text(folder / results.CONFIG),
        figures=figures,
        evaluation=evaluation,
        trajectory=trajectory,
        truth=as_given,
        error=error,
        frames=unless_missing("states and counts", lambda: _frames(folder / results.FRAMES), missing),
        stages_ms=stages_ms or {},
        warnings=tuple(_text(folder / results.WARNINGS).splitlines()),
        missing=tuple(missing),
    )


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""


def _figures(path: Path) -> dict[str, Any]:
    figures = json.loads(path.read_text(encoding="utf-8"))
    if not isinstance(figures, dict):
        raise ValueError("no figures")
    return figures


def _evaluation(figures: Mapping[str, Any] | None) -> Evaluation | None:
    """Return the errors of a metrics.json; None where it says that there are none.

    Raises:
        TrajectoryError: It holds something else.
    """
    return None if figures is None or figures.get("as_given") is None else from_json(json.dumps(figures))


def _error(trajectory: Trajectory, truth: Trajectory, evaluation: Evaluation | None) -> AbsoluteError:
    """Align as the figures were made.

    Raises:
        TrajectoryError: Nothing can be compared.
    """
    if evaluation is None:
        matching = TimeMatching()
    else:
        matching = TimeMatching(offset_s=evaluation.offset_s, interpolate=evaluation.interpolated)
    return ate(*matching.match(trajectory, truth), matching.max_gap_s)


def _frames(path: Path) -> Frames:
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    names = {"keypoints": "keypoints", "static": "static", "agreeing with the pose": "inliers"}
    return Frames(
        times_s=np.array([float(row["timestamp_s"] or "nan") for row in rows]),
        states=tuple(row["state"] for row in rows),
        counts={shown: np.array([float(row[name]) for row in rows]) for shown, name in names.items()},
    )


def _stages(path: Path) -> dict[str, np.ndarray[Any, Any]]:
    columns: dict[str, list[float]] = {}
    for stages in read_stages(path).values():
        for name, ms in stages.items():
            columns.setdefault(name, []).append(ms)
    return {name: np.array(ms) for name, ms in columns.items()}
