"""Functions of `import stillroom`: cameras by name, evaluation, methods, and map files."""

from dataclasses import replace
from pathlib import Path

from stillroom.data.trajectory import Trajectory, read_tum
from stillroom.datasets.camera_file import camera_of
from stillroom.datasets.recording import groundtruth_flaw, unpaired_s
from stillroom.errors import TrajectoryError
from stillroom.evaluation.report import Evaluation
from stillroom.evaluation.report import evaluate as evaluate_trajectories
from stillroom.geometry.camera import Camera
from stillroom.presets.registry import Method, all_methods
from stillroom.protocols import Dataset
from stillroom.storage import reader
from stillroom.storage.schema import StoredMap


def camera(name_or_file: str | Path) -> Camera:
    """Return a calibration that Stillroom knows by name, such as "bonn" or "tum-freiburg1", or that of a camera file.

    Raises:
        CalibrationError: There is no such name or file, or the file makes no camera.
    """
    return camera_of(str(name_or_file))[0]


def evaluate(
    estimate: Trajectory | str | Path, truth: Dataset | Trajectory | str | Path, up_to_scale: bool = False
) -> Evaluation:
    """Measure a trajectory against ground truth: ATE, RPE and coverage.

    Args:
        estimate: Poses `T_world_cam`, or a file of them in the TUM format. One that is up to scale, as a monocular run
            gives it, is aligned by Sim(3).
        truth: The sequence that the images came from, true poses of the camera, or a file of them.
        up_to_scale: Treat the estimate as up to scale although it does not say so, as a file of another system.

    Raises:
        TrajectoryError: A file cannot be read, the sequence has no ground truth, or nothing can be compared.
    """
    estimated = estimate if isinstance(estimate, Trajectory) else read_tum(Path(estimate))
    if up_to_scale:
        estimated = replace(estimated, is_metric=False)
    if isinstance(truth, str | Path):
        truth = read_tum(Path(truth))
    if isinstance(truth, Trajectory):
        return evaluate_trajectories(estimated, truth)
    flaw = groundtruth_flaw(truth)
    if flaw:
        raise TrajectoryError(f"{flaw} [see troubleshooting: groundtruth]")
    if truth.groundtruth is None:
        raise TrajectoryError(f"{truth.name}: has no ground truth, so there is nothing to compare the trajectory with")
    at_camera = truth.groundtruth_at_camera
    n_recorded = len(truth) + len(unpaired_s(truth))
    return evaluate_trajectories(estimated, truth.groundtruth, groundtruth_camera=at_camera, n_given=n_recorded)


def methods() -> dict[str, Method]:
    """Return all methods by name, those of installed packages too.

    Raises:
        ConfigError: What an installed package offers cannot be used.
    """
    return all_methods()


def load_map(path: str | Path) -> StoredMap:
    """Return what a map file holds: the sparse map (`world`), its camera, and the sessions and frames that made it.

    Raises:
        MapError: There is no such file, it is no map, of a newer version, cut short or damaged.
    """
    return reader.load_map(Path(path))
