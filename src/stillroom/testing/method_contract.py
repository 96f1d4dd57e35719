"""The contract of every `Method`.

In a test of your own::

    from stillroom.testing.method_contract import check_method

    def test_my_method():
        check_method(METHOD, open_dataset("synthetic:walking,frames=30"))
"""

import tomllib
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from stillroom.config import SlamConfig, to_toml, updated
from stillroom.config.sensors import fit_to_sensor
from stillroom.data.image import Image
from stillroom.data.result import FrameResult, FrameSummary, TrackingState
from stillroom.data.trajectory import Trajectory
from stillroom.datasets.recording import sensor_of
from stillroom.geometry.arrays import F64
from stillroom.presets.method import Method
from stillroom.protocols import Dataset, Segmenter
from stillroom.system import System, build

DARK_FRAMES = 2


def check_method(method: Method, dataset: Dataset, segmenter: Callable[[], Segmenter] | None = None) -> System:
    """Check that a method fulfils the contract.

    Args:
        method: The method.
        dataset: A short sequence, some 30 frames, in which the camera can be tracked; of any sensor that the method
            works with.
        segmenter: Builds a replacement of the method's own segmenter, such as one without weights; a new one each time.

    Returns:
        The system after a run, for further assertions.

    Raises:
        AssertionError: A rule is broken; the message says which.
    """
    _check_description(method)
    sensor = sensor_of(dataset)
    config, _ = fit_to_sensor(method.config, sensor)
    images = [dataset.load(place) for place in range(len(dataset))]

    def fresh(config: SlamConfig) -> System:
        return build(config, dataset.camera, segmenter() if segmenter else None, sensor=sensor)

    system = _run(fresh(config), images)
    _check_results(system, images)
    _check_trajectories(system)
    assert any(result.state is TrackingState.OK for result in system.results[1:]), "nothing of the sequence is tracked"
    _check_same(system, _run(fresh(config), images), "the same input and seed give another trajectory")
    _run(fresh(replace(config, seed=config.seed + 1)), images[:5])
    _check_darkness(fresh(config), images)
    _check_empty(fresh(config), images[0])
    return system


def _check_description(method: Method) -> None:
    assert method.name == method.config.method, f"'{method.name}' has a config of '{method.config.method}'"
    assert method.name == method.name.lower().strip(), f"'{method.name}' must be lower case: it is typed"
    assert "/" not in method.name, f"'{method.name}' has a slash; the results folder is called by it"
    assert " " not in method.name, f"'{method.name}' has a space; it is typed"
    assert method.summary, "no summary"
    assert "\n" not in method.summary, "the summary has more than one line"
    again = updated(SlamConfig(), tomllib.loads(to_toml(method.config)))
    assert again == method.config, "the config written as TOML and read again is another one"


def _run(system: System, images: Sequence[Image]) -> System:
    for image in images:
        result = system.process(image)
        _check_result(result, system.results[-1], image)
    system.close()
    return system


def _check_result(result: FrameResult, kept: FrameSummary, image: Image) -> None:
    where = f"image {image.index}"
    assert result.T_world_cam is kept.T_world_cam, f"{where}: what process returns is not kept"
    assert _counts(result) == _counts(kept), f"{where}: what process returns is not kept"
    assert result.motion.moving.shape == (image.height, image.width), f"{where}: the moving mask is of another size"
    assert len(result.keypoints) == result.n_keypoints, f"{where}: {len(result.keypoints)} keypoints returned"
    n_static = int(result.motion.is_static.sum())
    assert n_static == result.n_static, f"{where}: {n_static} keypoints returned as static, {result.n_static} counted"


def _check_results(system: System, images: Sequence[Image]) -> None:
    assert len(system.results) == len(images), f"{len(images)} images, {len(system.results)} results"
    for image, result in zip(images, system.results, strict=True):
        where = f"image {image.index}"
        assert result.index == image.index, f"{where} is numbered {result.index} in the results"
        assert result.timestamp_s == image.timestamp_s, f"{where} has another time in the results"
        has_pose = result.T_world_cam is not None
        assert has_pose == (result.state is TrackingState.OK), f"{where}: {result.state.value}, pose: {has_pose}"
        assert has_pose == (result.T_reference_cam is not None), f"{where}: only one of its two poses is there"
        _check_pose(result.T_world_cam, where)
        _check_pose(result.T_reference_cam, where)
        assert 0 <= result.n_inliers <= result.n_keypoints, f"{where}: {result.n_inliers} of {result.n_keypoints}"
        assert 0 <= result.n_static <= result.n_keypoints, f"{where}: {result.n_static} of {result.n_keypoints}"
        assert has_pose or not result.is_keyframe, f"{where}: a keyframe without a pose"
    assert system.results[-1].n_keyframes == len(system.map.alive_keyframes()), "keyframes are counted wrongly"


def _check_pose(pose: F64 | None, where: str) -> None:
    if pose is None:
        return
    assert pose.shape == (4, 4), f"{where}: a pose is {pose.shape}"
    assert np.all(np.isfinite(pose)), f"{where}: a pose is not finite"
    R = pose[:3, :3]
    assert np.allclose(R @ R.T, np.eye(3), atol=1e-6), f"{where}: the rotation of a pose is none"
    assert np.linalg.det(R) > 0, f"{where}: the rotation of a pose mirrors"
    assert np.array_equal(pose[3], [0.0, 0.0, 0.0, 1.0]), f"{where}: the last row of a pose is {pose[3]}"


def _check_trajectories(system: System) -> None:
    tracked_s = [result.timestamp_s for result in system.results if result.T_world_cam is not None]
    for name, trajectory in (("final", system.trajectory()), ("online", system.online_trajectory())):
        assert trajectory.timestamps_s.tolist() == tracked_s, f"the {name} trajectory is not that of the tracked frames"
        _check_trajectory(trajectory, name)
    _check_trajectory(system.keyframe_trajectory(), "keyframes'")
    assert len(system.keyframe_trajectory()) == len(system.map.alive_keyframes()), "keyframes are missing"


def _check_trajectory(trajectory: Trajectory, name: str) -> None:
    assert np.all(np.diff(trajectory.timestamps_s) > 0), f"times of the {name} trajectory do not increase"
    for row, pose in enumerate(trajectory.T_world_cam):
        _check_pose(pose, f"{name} trajectory, pose {row}")


def _check_same(one: System, other: System, problem: str) -> None:
    for mine, theirs in ((one.trajectory(), other.trajectory()), (one.online_trajectory(), other.online_trajectory())):
        assert mine.timestamps_s.tobytes() == theirs.timestamps_s.tobytes(), problem
        assert mine.T_world_cam.tobytes() == theirs.T_world_cam.tobytes(), problem
    assert [_counts(result) for result in one.results] == [_counts(result) for result in other.results], problem


def _counts(result: FrameSummary) -> tuple[int, ...]:
    return result.n_keypoints, result.n_static, result.n_inliers, result.n_keyframes


def _check_darkness(system: System, images: Sequence[Image]) -> None:
    """Test a black image in the middle, and an image without depth."""
    middle = len(images) // 2
    changed = list(images)
    for place in range(middle, min(middle + DARK_FRAMES, len(images))):
        changed[place] = images[place].black()
    blind = middle + 2 * DARK_FRAMES
    if blind < len(images):
        changed[blind] = images[blind].without_depth()
    _run(system, changed)
    _check_results(system, changed)
    _check_trajectories(system)
    dark = system.results[middle]
    assert dark.T_world_cam is None, "a black image has a pose"
    if system.results[middle - 1].state is TrackingState.OK:
        assert dark.state is TrackingState.LOST, f"a black image in the middle is '{dark.state.value}', not lost"


def _check_empty(system: System, image: Image) -> None:
    """Begin with a black image: there is no map yet, so tracking cannot be lost."""
    system.process(image.black())
    assert system.results[-1].state is TrackingState.NOT_INITIALIZED, "a black first image must not begin a map"
    for name, trajectory in (("final", system.trajectory()), ("keyframes'", system.keyframe_trajectory())):
        assert trajectory.T_world_cam.shape == (0, 4, 4), f"the {name} trajectory of nothing has poses"
