"""Shows a finished run from what its results folder holds, and the images where their sequence is at hand."""

import csv
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from stillroom.config.settings import updated
from stillroom.data.association import closest
from stillroom.data.dense_cloud import NAME as DENSE
from stillroom.data.dense_cloud import DenseCloud, load_cloud
from stillroom.data.result import TrackingState
from stillroom.data.trajectory import Trajectory, read_tum
from stillroom.errors import StillroomError
from stillroom.geometry.arrays import F64
from stillroom.pipeline import results
from stillroom.pipeline.options import Source
from stillroom.pipeline.reading import read_config, read_stages, unless_missing
from stillroom.pipeline.run import RunProgress
from stillroom.protocols import Dataset
from stillroom.storage.reader import load_map
from stillroom.storage.schema import StoredMap
from stillroom.viz.viewer.blueprint import Eye, arranged
from stillroom.viz.viewer.observer import FLUSH_EVERY, few, truth_beside
from stillroom.viz.viewer.recording import Destination, Recording
from stillroom.viz.viewer.scene import Scene

NEVER_KEPT = "keypoints, boxes, masks and clusters, which results do not hold; 'stillroom run … --rerun FILE.rrd' does"
SAME_S = 1e-5
"""Times in results have microseconds."""


@dataclass(frozen=True)
class Row:
    """A line of frames.csv.

    Attributes:
        index, timestamp_s: Number and time [s] of the image.
        state: State of tracking; LOST for an image that could not be read.
        counts: Keypoints, static ones, and matches.
    """

    index: int
    timestamp_s: float
    state: TrackingState
    counts: Mapping[str, int]


@dataclass
class Replayed:
    """What was shown.

    Attributes:
        n_frames: How many frames.
        n_images: Of how many of them the image.
        missing: What is not shown, and why.
    """

    n_frames: int = 0
    n_images: int = 0
    missing: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Finished:
    """A finished run, as far as its folder holds it."""

    trajectory: Trajectory
    rows: tuple[Row, ...]
    stages_ms: Mapping[int, Mapping[str, float]]
    keyframes: Trajectory | None
    truth: Trajectory | None
    cloud: DenseCloud | None
    stored: StoredMap | None
    dataset: Dataset | None


def replay(path: Path, destination: Destination, progress: RunProgress) -> Replayed:
    """Show a finished run.

    Args:
        path: Its results folder; `latest` may stand for one.
        destination: Where to.
        progress: Receives the progress.

    Raises:
        MissingExtraError: rerun is not installed.
        StillroomError: It is no results folder, it has no poses, or what is shown cannot be delivered.
    """
    folder, shown = results.results_folder(path), Replayed()
    run = read_finished(folder, shown.missing)
    recording = destination.open(folder.name)
    try:
        scene = Scene(recording)
        cloud, poses = run.cloud, run.trajectory.T_world_cam if run.keyframes is None else run.keyframes.T_world_cam
        recording.arrange(arranged(recording.rr, False, run.dataset is not None, Eye.of(cloud, poses)))
        _show_map(scene, run)
        _show_frames(scene, recording, run, shown, progress)
        recording.flush()
    except BaseException:  # closing would wait for a window that hangs
        recording.abandon()
        raise
    recording.close()
    shown.missing.append(NEVER_KEPT)
    return shown


def read_finished(folder: Path, missing: list[str]) -> Finished:
    """Read a results folder; what is not in it is added to `missing`.

    Raises:
        StillroomError: The folder has no poses, or the file of them is damaged.
    """
    if not (folder / results.FINAL).is_file():
        raise StillroomError(f"{folder}: no {results.FINAL} in it; is it the folder of a run?")
    trajectory = read_tum(folder / results.FINAL)
    rows = unless_missing("states and counts", lambda: _read_rows(folder / results.FRAMES), missing)
    how = unless_missing("configuration", lambda: _provenance(folder), missing) or {}
    truth = unless_missing("ground truth", lambda: _truth(folder), missing)
    return Finished(
        trajectory=trajectory,
        rows=rows if rows is not None else _rows_of(trajectory),
        stages_ms=unless_missing("time of each stage", lambda: read_stages(folder / results.TIMING), missing) or {},
        keyframes=unless_missing("keyframes", lambda: read_tum(folder / results.KEYFRAMES), missing),
        truth=truth,
        cloud=unless_missing("dense map", lambda: load_cloud(folder / DENSE), missing),
        stored=unless_missing("sparse map and covisibility", lambda: _stored(how), missing),
        dataset=unless_missing("images", lambda: _sequence(how), missing),
    )


# What is in the folder.


def _read_rows(path: Path) -> tuple[Row, ...]:
    with path.open(encoding="utf-8", newline="") as file:
        return tuple(_row(cells) for cells in csv.DictReader(file))


def _row(cells: Mapping[str, str]) -> Row:
    unreadable = cells["state"] == results.UNREADABLE
    counts = {"keypoints": int(cells["keypoints"]), "static": int(cells["static"]), "matches": int(cells["inliers"])}
    state = TrackingState.LOST if unreadable else TrackingState(cells["state"])
    return Row(int(cells["frame"]), float(cells["timestamp_s"]), state, counts)


def _rows_of(trajectory: Trajectory) -> tuple[Row, ...]:
    return tuple(Row(i, float(t), TrackingState.OK, {}) for i, t in enumerate(trajectory.timestamps_s))


def _truth(folder: Path) -> Trajectory:
    truth = results.Truth.read(folder)
    if truth is None:
        raise StillroomError("the sequence has none, or none that could be read")
    return truth.at_camera or truth.as_given


def _provenance(folder: Path) -> dict[str, Any]:
    return dict(read_config(folder).get("run", {}))


def _stored(how: Mapping[str, Any]) -> StoredMap:
    if "map" not in how:
        raise StillroomError("the run kept no map file; 'stillroom run … --map FILE' does")
    return load_map(Path(how["map"]))


def _sequence(how: Mapping[str, Any]) -> Dataset:
    """Open the sequence that a run was given.

    Raises:
        StillroomError: It is not named, or not at hand.
    """
    source = how.get("source")
    if not isinstance(source, dict):
        raise StillroomError("the run was not given a sequence by name")
    given = {name: value for name, value in source.items() if name in asdict(Source("")) and value != ""}
    return _source(given).open()


def _source(given: Mapping[str, Any]) -> Source:
    pairing = given.get("pairing", {})
    rest = {name: value for name, value in given.items() if name != "pairing"}
    return updated(Source(""), rest | {"pairing": {k: v for k, v in pairing.items() if v != ""}})


# How it is shown.


def _show_map(scene: Scene, run: Finished) -> None:
    path, true_path = run.trajectory, None if run.truth is None else truth_beside(run.trajectory, run.truth)
    recording = scene.recording
    first_s = run.rows[0].timestamp_s if run.rows else 0.0
    if run.rows:
        recording.at(run.rows[0].index, run.rows[0].timestamp_s - first_s)
    scene.path(
        path.positions_m[few(len(path))], None if true_path is None else true_path.positions_m[few(len(true_path))]
    )
    if run.keyframes is not None:
        scene.keyframes(run.keyframes.T_world_cam)
    if run.stored is not None:
        world = run.stored.world
        loops = np.array(world.loop_edges, dtype=np.int32).reshape(-1, 2)
        scene.points(world.points.position_m[world.points.is_alive])
        scene.graph(world.keyframes.T_world_cam[:, :3, 3], world.covisibility.edges()[:, :2], loops)
    if run.cloud is not None:
        scene.dense(run.cloud)


def _show_frames(scene: Scene, recording: Recording, run: Finished, shown: Replayed, progress: RunProgress) -> None:
    if run.dataset is not None:
        scene.camera(run.dataset.camera)
    progress.start(len(run.rows))
    try:
        for n, row in enumerate(run.rows, start=1):
            recording.at(row.index, row.timestamp_s - run.rows[0].timestamp_s)
            scene.pose(_pose_at(run.trajectory, row.timestamp_s))
            scene.figures(row.state, row.counts)
            scene.stages(run.stages_ms.get(row.index, {}))
            shown.n_images += _show_image(scene, run.dataset, row.index)
            shown.n_frames += 1
            progress.frame(None)
            if n % FLUSH_EVERY == 0:
                recording.flush()
    finally:
        progress.finish()


def _pose_at(trajectory: Trajectory, time_s: float) -> F64 | None:
    """Return the pose (4, 4) of the image taken at a time [s]; None where it has none."""
    nearest = int(closest(trajectory.timestamps_s, np.array([time_s]))[0])
    if abs(float(trajectory.timestamps_s[nearest]) - time_s) > SAME_S:
        return None
    pose: F64 = trajectory.T_world_cam[nearest]
    return pose


def _show_image(scene: Scene, dataset: Dataset | None, index: int) -> bool:
    if dataset is None:
        return False
    place = int(np.searchsorted(dataset.numbers, index))
    if place >= len(dataset) or int(dataset.numbers[place]) != index:
        return False
    try:
        scene.image(dataset.load(place).rgb)
    except StillroomError:  # the run left it out as well
        return False
    return True
