"""The readout of a camera from its recording, without ground truth: found where the motion tells, else refused."""

from pathlib import Path

import pytest

from stillroom.datasets.open import open_dataset
from stillroom.datasets.selection import select
from stillroom.errors import CalibrationError
from stillroom.optimize.readout import Readout
from stillroom.pipeline.shutter import ShutterCalibration, calibrate_shutter
from stillroom.presets.registry import configure

STATIC = configure("orb-slam2")
TURNING = "synthetic:empty,path=rpy,frames=100"
MS = 1e-3


@pytest.mark.parametrize(
    ("spec", "readout_ms"),
    [
        (TURNING, 25.0),
        pytest.param(TURNING, 10.0, marks=pytest.mark.slow),
        pytest.param(f"{TURNING},room=library,seed=3", 30.0, marks=pytest.mark.slow),
        pytest.param("synthetic:empty,frames=150", 25.0, marks=pytest.mark.slow),
    ],
)
def test_a_rendered_readout_is_found_within_two_milliseconds(spec: str, readout_ms: float) -> None:
    found = calibrate_shutter(open_dataset(f"{spec},readout_ms={readout_ms:g}"), STATIC)
    assert abs(found.found.readout_s - readout_ms * MS) < 2.0 * MS
    assert abs(found.found.readout_s - readout_ms * MS) < 2.5 * found.found.sigma_s
    assert found.found.sigma_s < 2.5 * MS
    assert not found.is_global
    assert found.line == f"readout_s = {found.found.readout_s:.4f}  # ± {found.found.sigma_s:.4f}"


@pytest.mark.parametrize("spec", [TURNING, pytest.param("synthetic:empty,frames=150", marks=pytest.mark.slow)])
def test_a_global_shutter_has_none_within_its_uncertainty(spec: str) -> None:
    found = calibrate_shutter(open_dataset(spec), STATIC)
    assert abs(found.found.readout_s) < 2.0 * found.found.sigma_s
    assert found.found.sigma_s < 2.5 * MS
    assert found.is_global
    assert found.line.startswith("readout_s = 0.0000  # ± 0.00")


def test_the_readout_that_a_camera_says_it_has_does_not_count() -> None:
    room = open_dataset("synthetic:empty,path=rpy,frames=50,readout_ms=25")
    once, again = calibrate_shutter(room, STATIC), calibrate_shutter(room, STATIC)
    assert once == again
    assert once.runs[-1] == once.found
    assert 1 < len(once.runs) <= 3


def test_a_camera_at_rest_is_refused_in_one_line() -> None:
    room = open_dataset("synthetic:empty,path=still,frames=45,readout_ms=25")
    with pytest.raises(CalibrationError, match=r"the motion does not tell the readout .*turn the camera") as caught:
        calibrate_shutter(room, STATIC)
    assert "\n" not in str(caught.value)


def test_too_few_frames_are_refused() -> None:
    with pytest.raises(CalibrationError, match="only 13 frames tell of the shutter, 30 are needed"):
        calibrate_shutter(select(open_dataset(TURNING), "0:20", (), (), False), STATIC)


def test_fr1_is_found_where_its_rows_say(freiburg1: Path) -> None:
    """24 ± 5 ms: docs/reference.md#rolling-shutters."""
    found = calibrate_shutter(open_dataset(str(freiburg1)), STATIC)
    assert abs(found.found.readout_s - 24.0 * MS) < 5.0 * MS
    assert found.found.sigma_s < 4.0 * MS


@pytest.mark.parametrize(
    ("readout_ms", "sigma_ms", "is_global", "line"),
    [
        (24.31, 1.18, False, "readout_s = 0.0243  # ± 0.0012"),
        (1.0, 0.9, True, "readout_s = 0.0000  # ± 0.0009"),
        (-0.4, 0.3, True, "readout_s = 0.0000  # ± 0.0003"),
    ],
)
def test_what_is_printed(readout_ms: float, sigma_ms: float, is_global: bool, line: str) -> None:
    found = Readout(readout_ms * MS, sigma_ms * MS, 170.0, 90)
    calibration = ShutterCalibration(found, (found,))
    assert calibration.is_global == is_global
    assert calibration.line == line
    assert f"{readout_ms:.1f} ± {sigma_ms:.1f} ms" in calibration.sentences()[0]
    assert ("global" in " ".join(calibration.sentences())) == is_global
