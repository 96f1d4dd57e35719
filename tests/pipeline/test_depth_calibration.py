"""Scale and clock of depth from a recording: found where the motion and the ground truth tell, else said or refused."""

import re

import pytest

from stillroom.datasets.open import open_dataset
from stillroom.datasets.selection import select
from stillroom.errors import CalibrationError
from stillroom.optimize.depth_offset import ClockOffset
from stillroom.optimize.depth_scale import DepthScale
from stillroom.pipeline.depth import DepthCalibration, WithDepthClock, calibrate_depth
from stillroom.presets.registry import configure
from stillroom_scenes.room import CAMERA

STATIC = configure("orb-slam2")
SWAYING = "synthetic:empty,frames=150"
MS = 1e-3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("spec", "scale", "late_ms"),
    [
        (SWAYING, 1.03, 15.0),
        (f"{SWAYING},room=library,seed=3", 1.03, 15.0),
        (f"{SWAYING},seed=4", 1.0, 0.0),
        (f"{SWAYING},seed=5", 1.03, 0.0),
        (f"{SWAYING},seed=6", 1.0, 15.0),
    ],
)
def test_rendered_faults_are_found(spec: str, scale: float, late_ms: float) -> None:
    found = calibrate_depth(open_dataset(f"{spec},depth_scale={scale},depth_late_ms={late_ms}"), STATIC)
    assert found.scale is not None
    assert found.offset is not None
    assert abs(found.scale.scale - scale) < 0.003
    assert abs(found.offset.after_s + late_ms * MS) < 3.0 * MS
    assert found.offset.sigma_s < 3.0 * MS
    assert found.is_in_time == (late_ms == 0.0)


def test_a_turning_camera_tells_the_clock_but_not_the_scale() -> None:
    found = calibrate_depth(open_dataset("synthetic:empty,path=rpy,frames=70,depth_late_ms=15"), STATIC)
    assert found.offset is not None
    assert abs(found.offset.after_s + 15.0 * MS) < 4.0 * MS
    assert [re.sub(r" =.*", "", line) for line in found.lines()][-1] == "depth_offset_s"


def test_a_camera_at_rest_is_refused_in_one_line() -> None:
    room = open_dataset("synthetic:empty,path=still,frames=50")
    with pytest.raises(CalibrationError, match=r"scale of depth is not told .*depth clock is not told") as caught:
        calibrate_depth(room, STATIC)
    assert "\n" not in str(caught.value)


def test_too_few_frames_are_refused() -> None:
    with pytest.raises(CalibrationError, match=r"only \d+ frames tell of depth, 30 are needed"):
        calibrate_depth(select(open_dataset("synthetic:empty,path=still,frames=50"), "0:15", (), (), False), STATIC)


def test_a_view_has_the_offset_in_camera_and_images() -> None:
    room = WithDepthClock(open_dataset("synthetic:empty,frames=1,cache=off"), -0.01)
    assert room.camera.depth_offset_s == -0.01
    assert room.load(0).depth_after_s == -0.01


@pytest.mark.parametrize(
    ("scale", "after_ms", "lines"),
    [
        (1.03, -15.8, ["depth_scale = 0.9709  # ± 0.0010", "depth_offset_s = -0.0158  # ± 0.0017"]),
        (1.001, -2.0, ["depth_scale = 1.0000  # ± 0.0010", "depth_offset_s = 0.0000  # ± 0.0017"]),
        (0.98, 9.0, ["depth_scale = 1.0204  # ± 0.0010", "depth_offset_s = 0.0090  # ± 0.0017"]),
    ],
)
def test_what_is_printed(scale: float, after_ms: float, lines: list[str]) -> None:
    found = DepthCalibration(CAMERA, ClockOffset(after_ms * MS, 1.7 * MS, 60.0, 140), DepthScale(scale, 0.001, 700))
    assert found.lines() == lines
    said = " ".join(found.sentences())
    assert ("too far" in said) == (scale > 1.0)
    assert ("too late" in said) == (after_ms < 0.0)
    assert ("clock in force explains" in said) == (lines[1].split()[2] == "0.0000")
    assert DepthCalibration(CAMERA, None, None, ("nothing",)).lines() == []
