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
"""

import tomllib
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from stillroom.errors import CalibrationError
from stillroom.geometry.camera import Camera

REQUIRED = ("width", "height", "fx", "fy", "cx", "cy", "depth_factor")
OPTIONAL = ("distortion", "bf", "baseline_m")
DEFAULT_BASELINE_M = 0.075
"""Of a Kinect's projector and camera; what `bf` = 40 comes to on TUM's cameras."""


def read_camera(path: Path) -> Camera:
    """Read a camera file.

    Raises:
        CalibrationError: The file is missing or is no TOML; a key is unknown, missing or of the wrong type; both
            `bf` and `baseline_m` are given; or the numbers make no camera.
    """
    values = _read_toml(path)
    for key in values:
        if key not in (*REQUIRED, *OPTIONAL):
            guess = get_close_matches(key, (*REQUIRED, *OPTIONAL), n=1, cutoff=0.0)[0]
            raise CalibrationError(f"{path}: unknown key '{key}'; did you mean '{guess}'?")
    missing = [key for key in REQUIRED if key not in values]
    if missing:
        raise CalibrationError(f"{path}: '{missing[0]}' is missing; a camera needs {', '.join(REQUIRED)}")
    if "bf" in values and "baseline_m" in values:
        raise CalibrationError(f"{path}: both 'bf' and 'baseline_m' are given; leave one out")
    width, height = _integer(path, values, "width"), _integer(path, values, "height")
    fx, fy, cx, cy = (_number(path, values, key) for key in ("fx", "fy", "cx", "cy"))
    bf = _number(path, values, "bf") if "bf" in values else fx * _baseline_m(path, values)
    depth_factor, distortion = _number(path, values, "depth_factor"), _distortion(path, values)
    try:
        return Camera(width, height, fx, fy, cx, cy, distortion, depth_factor, bf)
    except CalibrationError as error:
        raise CalibrationError(f"{path}: {error}") from error


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
        f"bf = {float(camera.bf)!r}  # baseline of the virtual stereo pair times fx [px·m]\n",
        encoding="utf-8",
    )


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, IsADirectoryError):
        raise CalibrationError(f"{path}: no such camera file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise CalibrationError(f"{path}: cannot be read as text ({error})") from error
    except tomllib.TOMLDecodeError as error:
        raise CalibrationError(f"{path}: not a TOML file: {error}") from error


def _number(path: Path, values: dict[str, Any], key: str) -> float:
    value = values[key]
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise CalibrationError(f"{path}: '{key}' is {value!r}; it must be a number")
    return float(value)


def _integer(path: Path, values: dict[str, Any], key: str) -> int:
    value = values[key]
    if isinstance(value, bool) or not isinstance(value, int):
        raise CalibrationError(f"{path}: '{key}' is {value!r}; it must be a whole number of pixels")
    return value


def _baseline_m(path: Path, values: dict[str, Any]) -> float:
    return _number(path, values, "baseline_m") if "baseline_m" in values else DEFAULT_BASELINE_M


def _distortion(path: Path, values: dict[str, Any]) -> tuple[float, float, float, float, float]:
    given = values.get("distortion", [0.0] * 5)
    is_five = isinstance(given, list) and len(given) == 5
    if not is_five or any(isinstance(v, bool) or not isinstance(v, int | float) for v in given):
        raise CalibrationError(f"{path}: 'distortion' is {given!r}; it must be five numbers [k1, k2, p1, p2, k3]")
    k1, k2, p1, p2, k3 = (float(value) for value in given)
    return k1, k2, p1, p2, k3
