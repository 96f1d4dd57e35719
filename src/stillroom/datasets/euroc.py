"""EuRoC's layout: `mav0/cam0`, `mav0/cam1`, and the poses of the body that carries them (Burri et al., IJRR 2016).

The ground truth is that of the body, which is the inertial sensor; it is moved to the left camera, rectified where the
pair is (docs/reference.md#euroc): left where it is, it costs 3 to 6 cm of ATE. A sequence of one camera is monocular,
and so is a pair of which that is asked.
"""

import logging
from pathlib import Path

import numpy as np

from stillroom.data.sensor import Sensor
from stillroom.data.trajectory import Trajectory
from stillroom.datasets.camera_file import NAMED_CAMERAS, camera_of
from stillroom.datasets.euroc_files import MountedCamera, read_sensor, read_stamps, read_states
from stillroom.datasets.image_sequence import GROUNDTRUTH_NAME, read_groundtruth
from stillroom.datasets.kind import DatasetKind, SequenceRequest
from stillroom.datasets.mono_sequence import MonoSequence
from stillroom.datasets.stereo_sequence import StereoSequence
from stillroom.datasets.time_units import in_seconds
from stillroom.errors import CalibrationError, ConfigError, DatasetError, TrajectoryError
from stillroom.geometry import se3
from stillroom.geometry.arrays import F64
from stillroom.geometry.camera import Camera
from stillroom.geometry.stereo_rig import Rectification, StereoRig
from stillroom.protocols import Dataset

log = logging.getLogger(__name__)
BODY, LIST_NAME, SENSOR_NAME = "mav0", "data.csv", "sensor.yaml"
LEFT, RIGHT = "cam0", "cam1"
STATES = Path("state_groundtruth_estimate0") / LIST_NAME

# The rig of all sequences, as their files have it (docs/reference.md#euroc).
EUROC_LEFT = MountedCamera(
    NAMED_CAMERAS["euroc"],
    np.array(
        [
            [0.0148655429818, -0.999880929698, 0.00414029679422, -0.0216401454975],
            [0.999557249008, 0.0149672133247, 0.025715529948, -0.064676986768],
            [-0.0257744366974, 0.00375618835797, 0.999660727178, 0.00981073058949],
            [0.0, 0.0, 0.0, 1.0],
        ]
    ),
)
EUROC_RIGHT = MountedCamera(
    Camera(
        width=752,
        height=480,
        fx=457.587,
        fy=456.134,
        cx=379.999,
        cy=255.238,
        distortion=(-0.28368365, 0.07451284, -0.00010473, -3.55590700e-05, 0.0),
    ),
    np.array(
        [
            [0.0125552670891, -0.999755099723, 0.0182237714554, -0.0198435579556],
            [0.999598781151, 0.0130119051815, 0.0251588363115, 0.0453689425024],
            [-0.0253898008918, 0.0179005838253, 0.999517347078, 0.00786212447038],
            [0.0, 0.0, 0.0, 1.0],
        ]
    ),
)
RECTIFIED_FOCAL_PX, RECTIFIED_CENTER_PX = 435.2046959714599, (367.4517211914062, 252.2008514404297)
"""The rectified camera of published results on this rig, whichever OpenCV is installed (docs/reference.md#euroc)."""


def open_euroc(
    folder: Path, camera: str | None = None, name: str | None = None, sensor: Sensor | None = None
) -> MonoSequence | StereoSequence:
    """Open a folder with `mav0/cam0/data.csv`, or a `mav0` itself.

    Args:
        folder: The sequence.
        camera: The calibration asked for: "euroc" for the built-in one; that of single images may be a file, too.
        name: Name of the sequence; the folder's where not given.
        sensor: What is to be used: the pair, or the left image alone; what is there where not given.

    Raises:
        DatasetError: A list is missing, empty or malformed, a second camera is asked for and missing, no image of it
            was taken at the moment of a left one, or no frame can be used.
        CalibrationError: A `sensor.yaml` cannot be used, the calibration asked for is unknown, or it does not fit the
            images.
        ConfigError: A calibration file is given for a pair.
    """
    body = folder / BODY if (folder / BODY).is_dir() else folder
    name = name or folder.resolve().name
    has_pair = (body / RIGHT / LIST_NAME).is_file()
    if sensor is Sensor.STEREO and not has_pair:
        raise DatasetError(f"{body}: no {RIGHT}/{LIST_NAME} in it; a stereo sequence needs the second camera")
    if not has_pair or sensor is Sensor.MONOCULAR:
        return _open_left(folder, body, name, camera)
    return _open_pair(folder, body, name, camera)


def _open_left(folder: Path, body: Path, name: str, camera: str | None) -> MonoSequence:
    mounted, source = _mounted(body, LEFT, EUROC_LEFT, None if camera is None else camera.lower())
    calibration = mounted.camera
    if camera is not None:
        calibration, source = camera_of(camera, has_depth=False)
    stamps = read_stamps(body / LEFT / LIST_NAME)
    times_s = _in_seconds(list(stamps))
    groundtruth, flaw = _groundtruth(folder, body, times_s, mounted.T_body_cam)
    sequence = MonoSequence(name, calibration, source, times_s, tuple(stamps.values()), groundtruth, flaw)
    return sequence.checked(folder)


def _open_pair(folder: Path, body: Path, name: str, camera: str | None) -> StereoSequence:
    if camera is not None and camera.lower() != "euroc":
        raise ConfigError(
            f"--camera {camera}: describes one camera, and {name} has a pair, with a {SENSOR_NAME} each; "
            "leave it out, or give euroc for the built-in rig"
        )
    lacking = [each for each in (LEFT, RIGHT) if not (body / each / SENSOR_NAME).is_file()]
    if camera is None and len(lacking) == 1:
        raise CalibrationError(f"{body / lacking[0] / SENSOR_NAME}: no such file, and the other camera has one")
    left, source = _mounted(body, LEFT, EUROC_LEFT, camera)
    right, _ = _mounted(body, RIGHT, EUROC_RIGHT, camera)
    rectification = _rectification(left, right)
    left_files, right_files = read_stamps(body / LEFT / LIST_NAME), read_stamps(body / RIGHT / LIST_NAME)
    both = [stamp for stamp in left_files if stamp in right_files]
    if not both:
        raise DatasetError(f"{body}: no image of {RIGHT} has the timestamp of one of {LEFT}, so there are no pairs")
    times_s = _in_seconds(both)
    T_body_cam = left.T_body_cam @ rectification.T_left_rectified
    groundtruth, flaw = _groundtruth(folder, body, times_s, T_body_cam)
    sequence = StereoSequence(
        name=name,
        camera=rectification.camera,
        camera_source=f"{source}, rectified",
        timestamps_s=times_s,
        left_files=tuple(left_files[stamp] for stamp in both),
        right_files=tuple(right_files[stamp] for stamp in both),
        rectification=rectification,
        groundtruth=groundtruth,
        unpaired_s=_in_seconds([stamp for stamp in left_files if stamp not in right_files]),
        groundtruth_flaw=flaw,
    )
    return sequence.checked(folder)


def _mounted(body: Path, camera: str, built_in: MountedCamera, asked: str | None) -> tuple[MountedCamera, str]:
    """Return a camera's calibration and mounting: those of its file, or the built-in ones where it has none."""
    path = body / camera / SENSOR_NAME
    if path.is_file() and asked is None:
        return read_sensor(path), f"the sequence's own {SENSOR_NAME}: {path}"
    return (
        built_in,
        "'euroc', as given" if asked is not None else f"'euroc', because there is no {camera}/{SENSOR_NAME}",
    )


def _rectification(left: MountedCamera, right: MountedCamera) -> Rectification:
    rig = StereoRig(left.camera, right.camera, se3.inverse(right.T_body_cam) @ left.T_body_cam)
    is_known = all(
        given.camera.lens == known.camera.lens and np.allclose(given.T_body_cam, known.T_body_cam, atol=1e-9)
        for given, known in ((left, EUROC_LEFT), (right, EUROC_RIGHT))
    )
    return Rectification.of(rig, RECTIFIED_FOCAL_PX, RECTIFIED_CENTER_PX) if is_known else rig.rectification


def _groundtruth(folder: Path, body: Path, times_s: F64, T_body_cam: F64) -> tuple[Trajectory | None, str]:
    """Return the camera's poses, where those of the body are known, and what is wrong where they cannot be used."""
    states = body / STATES
    if states.is_file():
        try:
            of_body: Trajectory | None = read_states(states)
        except TrajectoryError as error:
            flaw = str(error).partition(" [see")[0]
            log.warning(
                "ground truth is left out, so there are no figures: %s [see troubleshooting: groundtruth]", flaw
            )
            return None, flaw
        flaw = ""
    else:
        of_body, flaw = read_groundtruth(folder / GROUNDTRUTH_NAME, times_s)
    if of_body is None:
        return None, flaw
    return Trajectory(of_body.timestamps_s, of_body.T_world_cam @ T_body_cam), ""


def _in_seconds(stamps: list[int]) -> F64:
    return np.array([in_seconds(str(stamp), "ns") for stamp in stamps], dtype=np.float64)


def _is_euroc(asked: SequenceRequest) -> bool:
    folder = asked.folder
    if folder is None:
        return False
    bodies = [folder / BODY, *([folder] if folder.name == BODY else [])]
    return any((body / camera).is_dir() for body in bodies for camera in (LEFT, RIGHT))


def _open(asked: SequenceRequest, camera: str | None, fps: float | None) -> Dataset:
    assert asked.folder is not None, "recognised by its folder"
    if fps is not None:
        raise ConfigError(f"{asked.text}: its lists tell the times; leave --fps out")
    return open_euroc(asked.folder, camera, asked.name, asked.sensor)


KIND = DatasetKind(
    "euroc",
    f"a sequence in EuRoC's layout: {BODY}/{LEFT}, {BODY}/{RIGHT} (stereo, or monocular with one)",
    _is_euroc,
    _open,
)
