"""The files of a results folder.

=======================  =========================================================================
config.toml              the effective config; in `[run]`, which configures nothing, how it came about
trajectory.tum           final poses: each frame on its reference keyframe's corrected pose; here and below, a comment
                         says where they are up to scale
trajectory_online.tum    poses as they were reported when the frame was tracked
trajectory_lag5.tum      poses as settled five frames later, of methods whose trajectory has a prior
keyframes.tum            keyframes of the map
frames.csv               every image with its state: tracked, lost, or unreadable; the sub-map of its pose, and
                         how it was relocalized where tracking had been lost
timing.csv               time of each stage in each frame
groundtruth.tum          true poses as the data set gives them, where it does
groundtruth_camera.tum   the same moved to the camera, where the given ones are of another body
metrics.json             the figures
dense_cloud.npz          the dense map, where one is made; `stillroom export` makes other files of it
cloud.ply                its points, for a viewer
pictures/                trajectories, errors, maps, and frames with static and dynamic features
warnings.txt             what was warned of, a line each, where anything was
report.html              all that to look at, in one file
=======================  =========================================================================
"""

import csv
import json
import logging
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from datetime import datetime
from io import StringIO
from math import isnan
from pathlib import Path
from typing import Any

import numpy as np

from stillroom.config import SlamConfig, to_toml
from stillroom.data.dense_cloud import NAME as DENSE
from stillroom.data.dense_cloud import DenseCloud
from stillroom.data.map import submaps
from stillroom.data.replacing import cannot_be_written, replace_text
from stillroom.data.result import Recovery, TrackingState
from stillroom.data.trajectory import Trajectory, read_tum
from stillroom.errors import NO_MEMORY, ConfigError, StillroomError
from stillroom.evaluation.report import Evaluation
from stillroom.evaluation.report_file import to_json
from stillroom.evaluation.timing import FRAME, peak_memory_mb
from stillroom.pipeline.options import RunOptions, RunOutcome
from stillroom.protocols import Origin
from stillroom.session.provenance import provenance
from stillroom.system import System

log = logging.getLogger(__name__)
LATEST = "latest"
CONFIG = "config.toml"
FINAL, ONLINE, KEYFRAMES = "trajectory.tum", "trajectory_online.tum", "keyframes.tum"
FRAMES, TIMING, METRICS, PICTURES = "frames.csv", "timing.csv", "metrics.json", "pictures"
CLOUD = "cloud.ply"
WARNINGS, REPORT = "warnings.txt", "report.html"
TRUTH, TRUTH_CAMERA = "groundtruth.tum", "groundtruth_camera.tum"
UNREADABLE, DROPPED = "unreadable", "dropped"
"""States of images that were not tracked: they cannot be read, or were due while tracking was late."""


# Where results lie: a new folder for each run, and a link to the latest.


def new_folder(root: Path, *names: str, latest: bool = True) -> Path:
    """Make `root/<date>_<names…>` and, where it is a run's, let `root/latest` point to it.

    Raises:
        StillroomError: It cannot be made.
    """
    words = [re.sub(r"[^\w.+-]+", "-", name).strip("-") for name in names]
    stem = "_".join([datetime.now().strftime("%Y-%m-%d_%H-%M"), *words])
    try:
        root.mkdir(parents=True, exist_ok=True)
        folder = _unused(root, stem)
    except OSError as error:
        raise _cannot_make(root, error) from error
    if latest:
        _point_latest_to(folder)
    return folder


def chosen_folder(folder: Path) -> Path:
    """Make a folder that the user named.

    Raises:
        ConfigError: There is something in it already.
        StillroomError: It cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        is_empty = next(folder.iterdir(), None) is None
    except OSError as error:
        raise _cannot_make(folder, error) from error
    if not is_empty:
        raise ConfigError(f"{folder}: is not empty; name a new folder for the results")
    return folder


def results_folder(path: Path) -> Path:
    """Return the results folder of a path, `latest` also where links are not supported.

    Raises:
        StillroomError: There is none, or `latest.txt` names one elsewhere.
    """
    note = path.with_name(f"{path.name}.txt")
    if not path.exists() and path.name == LATEST and note.is_file():
        name = note.read_text(encoding="utf-8", errors="replace").strip()
        if Path(name).name != name or name == "..":
            raise StillroomError(f"{note}: '{name[:60]}' is no folder beside it; name the folder of the run")
        path = path.parent / name
    if not path.is_dir():
        raise StillroomError(f"{path}: no such results folder; 'stillroom run' makes one")
    return path.resolve()


def _unused(root: Path, stem: str) -> Path:
    number = 1
    while True:
        folder = root / (stem if number == 1 else f"{stem}_{number}")
        try:
            folder.mkdir()
        except FileExistsError:
            number += 1
        else:
            return folder


def _point_latest_to(folder: Path) -> None:
    """Replace the link atomically, so that it never dangles; a text file is used where links are not supported."""
    link, new = folder.parent / LATEST, folder.parent / f".{LATEST}-{os.getpid()}"
    try:
        new.unlink(missing_ok=True)
        new.symlink_to(folder.name, target_is_directory=True)
        new.replace(link)
    except (OSError, NotImplementedError) as error:
        log.info("%s: cannot be made a link (%s); its name stands in %s.txt", link, error, LATEST)
        new.unlink(missing_ok=True)
        replace_text(link.with_name(f"{LATEST}.txt"), folder.name + "\n")


def _cannot_make(folder: Path, error: OSError) -> StillroomError:
    return StillroomError(f"{folder}: cannot be made a folder for results ({error.strerror}); choose another")


@dataclass(frozen=True)
class Truth:
    """Ground truth, as the data set gives it and, where that is another body's, moved to the camera."""

    as_given: Trajectory
    at_camera: Trajectory | None = None

    @classmethod
    def of(cls, origin: Origin) -> "Truth | None":
        """Return that of a sequence or a camera, if it has any."""
        as_given = origin.groundtruth
        return None if as_given is None else cls(as_given, origin.groundtruth_at_camera)

    @classmethod
    def read(cls, folder: Path) -> "Truth | None":
        """Return that of a results folder, if it has any."""
        if not (folder / TRUTH).exists():
            return None
        at_camera = read_tum(folder / TRUTH_CAMERA) if (folder / TRUTH_CAMERA).exists() else None
        return cls(read_tum(folder / TRUTH), at_camera)

    def write(self, folder: Path) -> None:
        """Write it into a results folder."""
        self.as_given.write_tum(folder / TRUTH)
        if self.at_camera is not None:
            self.at_camera.write_tum(folder / TRUTH_CAMERA)


class Attempts:
    """Writes files one after the other; where one cannot be written, the others are all the same."""

    def __init__(self) -> None:
        self._first: StillroomError | None = None

    @contextmanager
    def file(self, path: Path) -> Iterator[None]:
        """Let a block write a file; what goes wrong is kept until `conclude`."""
        try:
            yield
        except OSError as error:
            self._first = self._first or cannot_be_written(path, error)
        except MemoryError:
            self._first = self._first or StillroomError(f"{path}: cannot be written: {NO_MEMORY}")
        except StillroomError as error:
            self._first = self._first or error

    def conclude(self) -> None:
        """Say whether all was written.

        Raises:
            StillroomError: The first file that was not.
        """
        if self._first is not None:
            raise self._first


def write_config(folder: Path, origin: Origin, config: SlamConfig, options: RunOptions) -> None:
    """Write the effective config and its provenance, before the run begins."""
    source = {} if options.source is None else {"source": asdict(options.source)}
    off = [f"{first}:{end}" for first, end in options.detector_off]
    how = {"name": origin.name, "camera_source": origin.camera_source, "detector_off": off, **options.asked}
    replace_text(folder / CONFIG, to_toml(config, provenance() | how | source))


def lagged_name(system: System) -> str:
    """Return the name of the file with the poses as settled a few frames later."""
    return f"trajectory_lag{system.reported.lag}.tum"


def write_results(folder: Path, outcome: RunOutcome, truth: Truth | None) -> DenseCloud | None:
    """Write everything that a run came to: trajectories, then figures, then the rest, and the dense map last.

    Returns:
        The dense map; None where none is made.

    Raises:
        StillroomError: A file cannot be written; what was there is there still, and so are all others.
    """
    system, attempts = outcome.system, Attempts()
    with attempts.file(folder / FINAL):
        system.trajectory().write_tum(folder / FINAL)
    with attempts.file(folder / ONLINE):
        system.online_trajectory().write_tum(folder / ONLINE)
    lagged = system.lagged_trajectory()
    if lagged is not None:
        with attempts.file(folder / lagged_name(system)):
            lagged.write_tum(folder / lagged_name(system))
    with attempts.file(folder / KEYFRAMES):
        system.keyframe_trajectory().write_tum(folder / KEYFRAMES)
    with attempts.file(folder / METRICS):
        write_run_metrics(folder, outcome)
    with attempts.file(folder / FRAMES):
        dropped = [] if outcome.live is None else outcome.live.dropped
        without_pose = [(number, time_s, UNREADABLE) for number, time_s in outcome.bad]
        without_pose += [(arrival.number, arrival.time_s, DROPPED) for arrival in dropped]
        _write_frames(folder / FRAMES, system, without_pose)
    with attempts.file(folder / TRUTH):
        if truth is not None:
            truth.write(folder)
    with attempts.file(folder / TIMING):
        outcome.clock.write_csv(folder / TIMING)
    cloud = None
    with attempts.file(folder / DENSE):  # fusing may need room on a disk as well
        cloud = system.dense_cloud()
    for name in (DENSE, CLOUD):  # for `stillroom export`, and for a viewer
        with attempts.file(folder / name):
            if cloud is not None:
                cloud.write(folder / name)
    attempts.conclude()
    return cloud


def write_run_metrics(folder: Path, outcome: RunOutcome) -> None:
    """Write the figures of a run as they are by now.

    Raises:
        StillroomError: They cannot be written.
    """
    write_metrics(folder, outcome.n_tracked, outcome.n_recorded, outcome.evaluation, run_figures(outcome))


def write_metrics(
    folder: Path, n_tracked: int, n_given: int | None, evaluation: Evaluation | None, run: Mapping[str, Any] | None
) -> None:
    """Write the figures: those of the evaluation where there is one, and those of the run itself."""
    if evaluation is not None:
        figures = json.loads(to_json(evaluation))
    else:
        coverage = n_tracked / n_given if n_given else None
        figures = {"n_tracked": n_tracked, "n_given": n_given, "coverage": coverage, "as_given": None}
    if run is not None:
        figures["run"] = run
    replace_text(folder / METRICS, json.dumps(figures, indent=2, allow_nan=False) + "\n")


def read_run_figures(folder: Path) -> dict[str, Any] | None:
    """Return the figures of the run itself in metrics.json, if present."""
    try:
        figures = json.loads((folder / METRICS).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    run = figures.get("run") if isinstance(figures, dict) else None
    return run if isinstance(run, dict) else None


def count_frames(folder: Path) -> int | None:
    """Return how many images were recorded for a run, those left out for want of depth too, as its folder tells."""
    n_unpaired = (read_run_figures(folder) or {}).get("n_unpaired", 0)
    try:
        with (folder / FRAMES).open(encoding="utf-8", newline="") as file:
            return sum(1 for _ in csv.DictReader(file)) + (n_unpaired if isinstance(n_unpaired, int) else 0)
    except OSError:
        return None


def _write_frames(path: Path, system: System, without_pose: Sequence[tuple[int, float, str]]) -> None:
    submap = system.map.keyframes.submap
    rows: list[tuple[Any, ...]] = [
        (
            r.index,
            f"{r.timestamp_s:.6f}",
            r.state.value,
            r.n_keypoints,
            r.n_static,
            r.n_inliers,
            int(r.is_keyframe),
            "" if r.T_world_cam is None else int(submap[r.reference_keyframe]),
            "" if r.recovery is Recovery.NONE else r.recovery.value,
        )
        for r in system.results
    ]
    rows += [
        (number, "" if isnan(time_s) else f"{time_s:.6f}", why, 0, 0, 0, 0, "", "")
        for number, time_s, why in without_pose
    ]
    header = ("frame", "timestamp_s", "state", "keypoints", "static", "inliers", "is_keyframe", "submap", "recovery")
    text = StringIO(newline="")
    writer = csv.writer(text)
    writer.writerow(header)
    writer.writerows(sorted(rows))
    replace_text(path, text.getvalue())


def run_figures(outcome: RunOutcome) -> dict[str, Any]:
    """Return the figures of a run itself, which stand in metrics.json under `run`."""
    frames, world = outcome.system.results, outcome.system.map
    frame_time = next((stage for stage in outcome.clock.summary() if stage.stage == FRAME), None)
    peak_mb = peak_memory_mb()
    tracked = [r for r in frames if r.T_world_cam is not None]
    rows = outcome.system.tracker.rows
    return {
        "sensor": outcome.sensor.value,
        "left_out": list(outcome.left_out),
        "n_left_out": len(outcome.left_out),
        "n_unreadable": outcome.n_bad,
        "doubts": [str(doubt) for doubt in outcome.doubts],
        "n_unpaired": outcome.n_unpaired,
        "n_repeated": outcome.system.n_repeated,
        "readout": None if rows is None else asdict(rows),
        "n_looked_again": outcome.system.last_look.n_improved,
        "n_not_looked_again_for_memory": outcome.system.last_look.n_forgotten,
        "n_before_map": sum(r.state is TrackingState.NOT_INITIALIZED for r in frames),
        "two_views_refused": dict(outcome.system.tracker.start.beginnings.refusals),
        "n_maps_dropped": outcome.system.tracker.start.beginnings.n_dropped,
        "n_in_dropped_maps": outcome.n_dropped,
        "interrupted": outcome.interrupted,
        "n_pictures_failed": outcome.ornaments.n_failed,
        "n_frames_not_shown": outcome.ornaments.n_not_shown,
        "n_in_unjoined_submaps": outcome.n_apart - outcome.n_dropped,
        "n_submaps": len(submaps.unjoined(world)),
        "scale": "metric" if world.sensor.is_metric else "unknown",
        "n_keyframes": len(world.alive_keyframes()),
        "n_points": int(world.points.is_alive.sum()),
        "keypoints_mean": _mean([r.n_keypoints for r in tracked]),
        "static_mean": _mean([r.n_static for r in tracked]),
        "inliers_mean": _mean([r.n_inliers for r in tracked]),
        "frame_ms": None if frame_time is None else asdict(frame_time),
        "live": None if outcome.live is None else outcome.live.to_dict(),
        "peak_memory_mb": None if np.isnan(peak_mb) else peak_mb,
    }


def _mean(values: Sequence[int]) -> float | None:
    return float(np.mean(values)) if values else None
