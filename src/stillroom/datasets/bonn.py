"""The Bonn RGB-D Dynamic data set (Palazzolo et al., ReFusion, IROS 2019): TUM's layout, another ground truth.

Its ground truth is the pose of a motion-capture marker body that rides on the camera, in a world with other axes. An
alignment multiplies from the left and cannot undo either, so relative errors mean something only after
`marker_to_camera` (docs/reference.md#bonn-ground-truth).
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from stillroom.data.trajectory import Trajectory
from stillroom.datasets.image_sequence import ImageSequence
from stillroom.datasets.kind import DatasetKind, SequenceRequest
from stillroom.datasets.pairing import Pairing
from stillroom.datasets.tum import RGB_LIST_NAME, open_tum
from stillroom.geometry import se3
from stillroom.geometry.arrays import F64
from stillroom.protocols import Dataset

NAME_PREFIX = "rgbd_bonn_"

T_ROS = np.array([[-1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""From the motion-capture axes to the data set's: x is negated, y and z are swapped."""

SCALED_T_MARKER_CAM = np.array(
    [
        [1.0157, 0.1828, -0.2389, 0.0113],
        [0.0009, -0.8431, -0.6413, -0.0098],
        [-0.3009, 0.6147, -0.8085, 0.0111],
        [0.0, 0.0, 0.0, 1.0],
    ]
)
"""The marker's calibration as published (docs/reference.md#bonn-ground-truth): a scaled rotation and a lever arm."""


def marker_calibration() -> F64:
    """Return `T_marker_cam` (4, 4): the published matrix without its scale, its rotation orthonormalised."""
    scale = float(np.cbrt(np.linalg.det(SCALED_T_MARKER_CAM[:3, :3])))
    unscaled = SCALED_T_MARKER_CAM.copy()
    unscaled[:3, :3] /= scale
    return se3.orthonormalize(unscaled)


def marker_to_camera(groundtruth: Trajectory) -> Trajectory:
    """Return the camera's trajectory of the marker body's: `T_ROSᵀ · T_world_marker · T_ROS · T_marker_cam`."""
    T_world_cam = T_ROS.T @ groundtruth.T_world_cam @ T_ROS @ marker_calibration()
    return Trajectory(groundtruth.timestamps_s, T_world_cam)


def open_bonn(
    folder: Path,
    camera: str | None = None,
    name: str | None = None,
    fps: float | None = None,
    pairing: Pairing | None = None,
) -> ImageSequence:
    """Open a Bonn sequence; its ground truth is given as published, that is of the marker, and moved to the camera.

    Arguments are those of `open_tum`.

    Raises:
        DatasetError: The folder or a list is missing, empty or malformed, or no frame can be used.
        CalibrationError: The calibration asked for is unknown or does not fit the images.
        ConfigError: `fps` is not a positive number.
    """
    sequence = open_tum(folder, camera, name, fps, pairing)
    if sequence.groundtruth is None:
        return sequence
    return replace(sequence, groundtruth_at_camera=marker_to_camera(sequence.groundtruth))


def _is_bonn(asked: SequenceRequest) -> bool:
    folder = asked.folder
    return folder is not None and asked.name.startswith(NAME_PREFIX) and (folder / RGB_LIST_NAME).exists()


def _open(asked: SequenceRequest, camera: str | None, fps: float | None) -> Dataset:
    assert asked.folder is not None, "recognised by its folder"
    return open_bonn(asked.folder, camera, asked.name, fps, asked.pairing)


KIND = DatasetKind(
    "bonn",
    f"a sequence of the Bonn RGB-D Dynamic data set: a folder {NAME_PREFIX}*",
    _is_bonn,
    _open,
    takes_pairing=True,
)
