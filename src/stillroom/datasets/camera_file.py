"""The user's own camera, as a TOML file.

::

    width = 640
    height = 480
    fx = 535.4
    fy = 539.2
    cx = 320.1
    cy = 247.6
    distortion = [0.0, 0.0, 0.0, 0.0, 0.0]   # k1 k2 p1 p2 k3, OpenCV's order; may be left out
    depth_factor = 5000.0                    # units of the depth image per metre; 1000 for millimetres
    baseline_m = 0.075                       # or bf = 40.0 [px·m]; may be left out
    max_depth_m = 6.0                        # depth beyond the sensor's range is unknown; may be left out
    readout_s = 0.030                        # from the first row of a colour image to the last; 0: global shutter
    depth_noise = "structured-light"         # or "time-of-flight": how well depth is known; may be left out
    depth_scale = 0.97                       # by what depth is multiplied; below 1 where it reads too far
    depth_offset_s = -0.015                  # added to the times of depth; negative where it is stamped late
"""

import math
import tomllib
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from stillroom.data.text import read_text
from stillroom.errors import CalibrationError
from stillroom.geometry.camera import Camera
from stillroom.geometry.depth_noise import KNOWN, STRUCTURED_LIGHT, UNKNOWN

REQUIRED = ("width", "height", "fx", "fy", "cx", "cy", "depth_factor")
OPTIONAL = (
    "distortion",
    "bf",
    "baseline_m",
    "max_depth_m",
    "readout_s",
    "depth_noise",
    "depth_scale",
    "depth_offset_s",
)
DEFAULT_BASELINE_M = 0.075
"""Of a Kinect's projector and camera; what `bf` = 40 comes to on TUM's cameras."""


def read_camera(path: Path, has_depth: bool = True, is_pair: bool = False) -> Camera:
    """Read a camera file; that of a camera without depth images may lack the factor, that of a pair has a baseline.

    Raises:
        CalibrationError: The file is missing or is no TOML; a key is unknown, missing or of the wrong type; both
            `bf` and `baseline_m` are given; or the numbers make no camera.
    """
    values = _read_toml(path)
    for key in values:
        if key not in (*REQUIRED, *OPTIONAL):
            guess = get_close_matches(key, (*REQUIRED, *OPTIONAL), n=1, cutoff=0.0)[0]
            raise CalibrationError(f"{path}: unknown key '{key}'; did you mean '{guess}'?")
    required = [key for key in REQUIRED if has_depth or key != "depth_factor"]
    missing = [key for key in required if key not in values]
    if missing:
        raise CalibrationError(f"{path}: '{missing[0]}' is missing; a camera needs {', '.join(required)}")
    if is_pair and "bf" not in values and "baseline_m" not in values:
        raise CalibrationError(f"{path}: 'baseline_m' is missing; all lengths that a pair measures depend on it")
    if "bf" in values and "baseline_m" in values:
        raise CalibrationError(f"{path}: both 'bf' and 'baseline_m' are given; leave one out")
    width, height = _integer(path, values, "width"), _integer(path, values, "height")
    fx, fy, cx, cy = (_number(path, values, key) for key in ("fx", "fy", "cx", "cy"))
    bf = _number(path, values, "bf") if "bf" in values else fx * _baseline_m(path, values)
    read_range(path)
    depth_factor = _number(path, values, "depth_factor") if "depth_factor" in values else Camera.depth_factor
    distortion = _distortion(path, values)
    numbers = {
        key: _number(path, values, key) for key in ("readout_s", "depth_scale", "depth_offset_s") if key in values
    }
    try:
        return Camera(
            width, height, fx, fy, cx, cy, distortion, depth_factor, bf, depth_noise=_sensor(path, values), **numbers
        )
    except CalibrationError as error:
        raise CalibrationError(f"{path}: {error}") from error


def read_range(path: Path) -> float:
    """Return the depth [m] beyond which a camera file says that its sensor knows nothing; infinite where it does not.

    Raises:
        CalibrationError: The file is missing or is no TOML, or the value is no positive number.
    """
    values = _read_toml(path)
    if "max_depth_m" not in values:
        return math.inf
    max_depth_m = _number(path, values, "max_depth_m")
    if not (math.isfinite(max_depth_m) and max_depth_m > 0):
        raise CalibrationError(
            f"{path}: 'max_depth_m' is {max_depth_m}; it must be a positive number of metres, or left out "
            "[see troubleshooting: depth-range]"
        )
    return max_depth_m


def write_camera(camera: Camera, path: Path) -> None:
    """Write a camera file that `read_camera` reads back exactly."""
    k1_to_k3 = ", ".join(repr(float(value)) for value in camera.distortion)
    path.write_text(
        f"width = {camera.width}\n"
        f"height = {camera.height}\n"
        f"fx = {float(camera.fx)!r}\n"
        f"fy = {float(camera.fy)!r}\n"
        f"cx = {float(camera.cx)!r}\n"
        f"cy = {float(camera.cy)!r}\n"
        f"distortion = [{k1_to_k3}]  # k1 k2 p1 p2 k3\n"
        f"depth_factor = {float(camera.depth_factor)!r}  # units of the depth image per metre\n"
        f"bf = {float(camera.bf)!r}  # baseline of the virtual stereo pair times fx [px·m]\n"
        f"readout_s = {float(camera.readout_s)!r}  # from the first row of a colour image to the last [s]\n"
        f'depth_noise = "{camera.depth_noise}"  # what measures depth\n'
        f"depth_scale = {float(camera.depth_scale)!r}  # by what depth is multiplied\n"
        f"depth_offset_s = {float(camera.depth_offset_s)!r}  # added to the times of depth [s]\n",
        encoding="utf-8",
    )


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(read_text(path))
    except (FileNotFoundError, IsADirectoryError):
        raise CalibrationError(f"{path}: no such camera file") from None
    except (OSError, UnicodeError) as error:
        raise CalibrationError(f"{path}: cannot be read as text ({error}) [see troubleshooting: text-files]") from error
    except tomllib.TOMLDecodeError as error:
        raise CalibrationError(f"{path}: not a TOML file: {error}") from error


def _number(path: Path, values: dict[str, Any], key: str) -> float:
    value = values[key]
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise CalibrationError(f"{path}: '{key}' is {value!r}; it must be a number")
    return _float(path, key, value)


def _float(path: Path, key: str, value: float) -> float:
    try:
        return float(value)
    except OverflowError:  # TOML's whole numbers have any length
        raise CalibrationError(f"{path}: '{key}' has a number of {len(str(value))} digits") from None


def _integer(path: Path, values: dict[str, Any], key: str) -> int:
    value = values[key]
    if isinstance(value, bool) or not isinstance(value, int):
        raise CalibrationError(f"{path}: '{key}' is {value!r}; it must be a whole number of pixels")
    return value


def _sensor(path: Path, values: dict[str, Any]) -> str:
    name = values.get("depth_noise", UNKNOWN)
    if not isinstance(name, str):
        raise CalibrationError(f"{path}: 'depth_noise' is {name!r}; it must be one of {', '.join(KNOWN)}")
    return name


def _baseline_m(path: Path, values: dict[str, Any]) -> float:
    return _number(path, values, "baseline_m") if "baseline_m" in values else DEFAULT_BASELINE_M


def _distortion(path: Path, values: dict[str, Any]) -> tuple[float, float, float, float, float]:
    given = values.get("distortion", [0.0] * 5)
    is_five = isinstance(given, list) and len(given) == 5
    if not is_five or any(isinstance(v, bool) or not isinstance(v, int | float) for v in given):
        raise CalibrationError(f"{path}: 'distortion' is {given!r}; it must be five numbers [k1, k2, p1, p2, k3]")
    k1, k2, p1, p2, k3 = (_float(path, "distortion", value) for value in given)
    return k1, k2, p1, p2, k3


# The calibrations that Stillroom knows by name, and the choice of the one in force.


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
        readout_s=0.033,  # estimated: docs/reference.md#rolling-shutters
        depth_noise=STRUCTURED_LIGHT,
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
        readout_s=0.024,  # estimated: docs/reference.md#rolling-shutters
        depth_noise=STRUCTURED_LIGHT,
    ),
    "tum-freiburg2": Camera(
        width=640,
        height=480,
        fx=520.908620,
        fy=521.007327,
        cx=325.141442,
        cy=249.701764,
        distortion=(0.231222, -0.784899, -0.003257, -0.000105, 0.917205),
        depth_noise=STRUCTURED_LIGHT,
    ),
    "tum-freiburg3": Camera(
        width=640, height=480, fx=535.4, fy=539.2, cx=320.1, cy=247.6, depth_noise=STRUCTURED_LIGHT
    ),
    # Burri et al., IJRR 2016; the left camera as its files have it (docs/reference.md#euroc).
    "euroc": Camera(
        width=752,
        height=480,
        fx=458.654,
        fy=457.296,
        cx=367.215,
        cy=248.375,
        distortion=(-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05, 0.0),
    ),
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


def choose_camera(folder: Path, sequence_name: str, option: str | None, has_depth: bool = True) -> tuple[Camera, str]:
    """Choose the calibration of a sequence, and say in one line where it comes from.

    The order: the explicit option, a name or a file; the sequence's own `camera.toml`; the data set's name.

    Raises:
        CalibrationError: None of the three gives one, or the one it gives cannot be read.
    """
    if option is not None:
        return camera_of(option, has_depth)
    own = folder / CAMERA_FILE_NAME
    recognised = next((prefix for prefix in RECOGNISED_PREFIXES if sequence_name.startswith(prefix)), None)
    if own.is_file():
        return _with_known_sensor(own, recognised, has_depth)
    if recognised is not None:
        name = RECOGNISED_PREFIXES[recognised]
        return NAMED_CAMERAS[name], f"'{name}', because the sequence is called {recognised}*"
    raise CalibrationError(
        f"{folder}: no calibration is known for this sequence; give --camera with a name "
        f"({', '.join(NAMED_CAMERAS)}) or a file, or put a {CAMERA_FILE_NAME} into the folder"
    )


def _with_known_sensor(path: Path, recognised: str | None, has_depth: bool) -> tuple[Camera, str]:
    """Return a sequence's own camera; what it does not say of its sensors is that of the data set's named one.

    Raises:
        CalibrationError: The file cannot be read.
    """
    camera, source = read_camera(path, has_depth), f"the sequence's own {CAMERA_FILE_NAME}: {path}"
    if recognised is None:
        return camera, source
    name, given = RECOGNISED_PREFIXES[recognised], _read_toml(path)
    known = NAMED_CAMERAS[name]
    if "depth_noise" not in given:
        camera = replace(camera, depth_noise=known.depth_noise)
    if "readout_s" in given or known.readout_s == 0.0:
        return camera, source
    return replace(
        camera, readout_s=known.readout_s
    ), f"{source}; readout of {1e3 * known.readout_s:.0f} ms as of '{name}'"


def choose_range(folder: Path, option: str | None) -> float:
    """Return the depth [m] beyond which the calibration in force (see `choose_camera`) says that nothing is known.

    Raises:
        CalibrationError: The camera file in force cannot be read.
    """
    path = _file_of(option) if option is not None else folder / CAMERA_FILE_NAME
    return read_range(path) if path is not None and path.is_file() else math.inf


def camera_of(option: str, has_depth: bool = True, is_pair: bool = False) -> tuple[Camera, str]:
    """Return the calibration that a name or the path of a camera file stands for, and say in one line which it is.

    Raises:
        CalibrationError: There is no such name or file, or the file makes no camera; one of a pair is asked for, and
            there is no baseline.
    """
    path = _file_of(option)
    if path is not None:
        return read_camera(path, has_depth, is_pair), f"the camera file given: {path}"
    name, camera = named_camera(option)
    return camera, f"'{name}', as given"


def _file_of(option: str) -> Path | None:
    """Return the camera file that is asked for; None where the name of a camera is."""
    path = Path(option).expanduser()
    # A name wins over a file of the same name; `./bonn` reaches the file.
    is_name = option.lower() in NAMED_CAMERAS or option.lower() in ALIASES
    return path if not is_name and (path.is_file() or path.suffix == ".toml" or len(path.parts) > 1) else None
