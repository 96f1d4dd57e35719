"""The calibrations that Stillroom knows by name, and the choice of the one in force."""

from difflib import get_close_matches
from pathlib import Path

from stillroom.datasets.camera_file import read_camera
from stillroom.errors import CalibrationError
from stillroom.geometry.camera import Camera

CAMERA_FILE_NAME = "camera.toml"

NAMED_CAMERAS: dict[str, Camera] = {
    # Palazzolo et al., ReFusion, IROS 2019; values as SG-SLAM ships them (docs/reference.md#bonn-calibration).
    "bonn": Camera(
        width=640,
        height=480,
        fx=542.822841,
        fy=542.576870,
        cx=315.593520,
        cy=237.756098,
        distortion=(0.039903, -0.099343, -0.000730, -0.000144, 0.0),
    ),
    # Sturm et al., IROS 2012; values as in ORB-SLAM2's TUM1.yaml, TUM2.yaml and TUM3.yaml
    # (docs/reference.md#tum-rgb-d-calibration).
    "tum-freiburg1": Camera(
        width=640,
        height=480,
        fx=517.306408,
        fy=516.469215,
        cx=318.643040,
        cy=255.313989,
        distortion=(0.262383, -0.953104, -0.005358, 0.002628, 1.163314),
    ),
    "tum-freiburg2": Camera(
        width=640,
        height=480,
        fx=520.908620,
        fy=521.007327,
        cx=325.141442,
        cy=249.701764,
        distortion=(0.231222, -0.784899, -0.003257, -0.000105, 0.917205),
    ),
    "tum-freiburg3": Camera(width=640, height=480, fx=535.4, fy=539.2, cx=320.1, cy=247.6),
}

ALIASES: dict[str, str] = {
    alias: f"tum-freiburg{number}"
    for number in (1, 2, 3)
    for alias in (f"fr{number}", f"tum{number}", f"freiburg{number}", f"tum-fr{number}")
}

RECOGNISED_PREFIXES: dict[str, str] = {
    "rgbd_bonn_": "bonn",
    "rgbd_dataset_freiburg1_": "tum-freiburg1",
    "rgbd_dataset_freiburg2_": "tum-freiburg2",
    "rgbd_dataset_freiburg3_": "tum-freiburg3",
}


def named_camera(name: str) -> tuple[str, Camera]:
    """Return the full name and the calibration that `name`, or an alias such as "fr1", stands for.

    Raises:
        CalibrationError: No calibration has this name.
    """
    lowered = name.lower()
    full = ALIASES.get(lowered, lowered)
    if full not in NAMED_CAMERAS:
        guess = get_close_matches(lowered, [*NAMED_CAMERAS, *ALIASES], n=1, cutoff=0.0)[0]
        raise CalibrationError(
            f"no camera is called '{name}' (did you mean '{guess}'?) and no file has this path; "
            f"known: {', '.join(NAMED_CAMERAS)}"
        )
    return full, NAMED_CAMERAS[full]


def choose_camera(folder: Path, sequence_name: str, option: str | None) -> tuple[Camera, str]:
    """Choose the calibration of a sequence, and say in one line where it comes from.

    The order: the explicit option, a name or a file; the sequence's own `camera.toml`; the data set's name.

    Raises:
        CalibrationError: None of the three gives one, or the one it gives cannot be read.
    """
    if option is not None:
        return _from_option(option)
    own = folder / CAMERA_FILE_NAME
    if own.is_file():
        return read_camera(own), f"the sequence's own {CAMERA_FILE_NAME}: {own}"
    for prefix, name in RECOGNISED_PREFIXES.items():
        if sequence_name.startswith(prefix):
            return NAMED_CAMERAS[name], f"'{name}', because the sequence is called {prefix}*"
    raise CalibrationError(
        f"{folder}: no calibration is known for this sequence; give --camera with a name "
        f"({', '.join(NAMED_CAMERAS)}) or a file, or put a {CAMERA_FILE_NAME} into the folder"
    )


def _from_option(option: str) -> tuple[Camera, str]:
    path = Path(option).expanduser()
    # A name wins over a file of the same name; `./bonn` reaches the file.
    is_name = option.lower() in NAMED_CAMERAS or option.lower() in ALIASES
    if not is_name and (path.is_file() or path.suffix == ".toml" or len(path.parts) > 1):
        return read_camera(path), f"the camera file given: {path}"
    name, camera = named_camera(option)
    return camera, f"'{name}', as given"
