"""A calibration that cannot be true is refused, a doubtful one is said once and counted; both without ground truth."""

import json
import logging
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rgbd_folder import write_rgbd_folder

import stillroom as sr
from stillroom.datasets.camera_file import NAMED_CAMERAS, write_camera
from stillroom.errors import CalibrationError
from stillroom.pipeline import RunOptions, run
from stillroom.session.plausibility import DepthRange, ImageTimes, doubts_of_camera, require_possible

BONN = sr.camera("bonn")
N_FRAMES = 6
STRAIGHT = {"distortion": (0.0,) * 5}


def wrong_camera(**changes):
    return replace(BONN, **changes)


@pytest.mark.parametrize("name", NAMED_CAMERAS)
def test_cameras_that_exist_are_neither_refused_nor_doubted(name):
    require_possible(NAMED_CAMERAS[name])
    assert list(doubts_of_camera(NAMED_CAMERAS[name])) == []


IMPOSSIBLE = {
    "normalised": ({"fx": 0.85, "fy": 1.13, "cx": 0.49, "cy": 0.5}, "look like normalised intrinsics"),
    "of twice the resolution": (
        {"fx": 1086, "fy": 1085, "cx": 631.0, "cy": 485.0},
        "cy is .*another resolution",
    ),
    "of no angle": ({"fx": 1e5, "fy": 1e5}, r"a field of view of 0\.4 degrees"),
    "folding": ({"distortion": (-0.5, 0.0, 0.0, 0.0, 0.0)}, "folds inside the image: 2[0-9].*% of its pixels"),
}


@pytest.mark.parametrize(("changes", "said"), IMPOSSIBLE.values(), ids=IMPOSSIBLE)
def test_what_no_camera_can_be_is_refused(changes, said):
    with pytest.raises(CalibrationError, match=said) as raised:
        sr.Slam("orb-slam2", wrong_camera(**changes))
    assert "[see troubleshooting: " in str(raised.value)
    assert "\n" not in str(raised.value)


DOUBTFUL = {
    "cx and cy swapped": ({"cx": BONN.cy, "cy": BONN.cx}, "are cx and cy swapped?"),
    "half the resolution": (
        {"fx": 271, "fy": 271, "cx": 158, "cy": 119, **STRAIGHT},
        "of another resolution, or a crop?",
    ),
    "small": ({"width": 160, "height": 120, "cx": 79.0, "cy": 59.0, "fx": 135.0, "fy": 135.0}, "show few details"),
    "too wide": ({"fx": 170.0, "fy": 170.0, **STRAIGHT}, "a field of view of 124 degrees"),
    "not square": ({"fy": 400.0}, "differ by more than 20%"),
    "folding in the corners": ({"distortion": (-0.3, 0.0, 0.0, 0.0, 0.0)}, r"folds inside the image: 1\.\d% of its"),
}


@pytest.mark.parametrize(("changes", "said"), DOUBTFUL.values(), ids=DOUBTFUL)
def test_what_is_doubtful_is_one_warning(changes, said, caplog):
    with caplog.at_level(logging.WARNING), sr.Slam("orb-slam2", wrong_camera(**changes)) as slam:
        assert [re.search(said, str(doubt)) is not None for doubt in slam.doubts] == [True]
    assert caplog.text.count("[see troubleshooting: ") == 1


def sampled_depths(sequence):
    """Return depths of the sequence's first images [m]."""
    return [sequence.load(place).depth_m for place in range(5)]


@pytest.mark.real
@pytest.mark.parametrize("name", ["bonn", "freiburg1"])
def test_a_depth_factor_five_times_off_is_told_from_real_depths(name, request):
    depths_m = sampled_depths(sr.open_dataset(str(request.getfixturevalue(name))))
    for scale, said in ((1.0, None), (5.0, "may be too small"), (0.2, "may be too large")):
        looker = DepthRange(5000.0 / scale)
        doubts = [doubt for depth_m in depths_m for doubt in looker.add(depth_m * np.float32(scale))]
        assert [said in str(doubt) for doubt in doubts] == ([] if said is None else [True]), (scale, doubts)


TOLD = ["image-times"]


@pytest.mark.parametrize(("step", "expected"), [(1 / 30, []), (33.3, TOLD), (1.0, TOLD), (33e-6, TOLD)])
def test_times_in_another_unit_are_told_once(step, expected):
    looker = ImageTimes()
    doubts = [doubt for number in range(30) for doubt in looker.add(1000.0 + number * step)]
    assert [doubt.name for doubt in doubts] == expected


def test_images_without_any_depth_are_told_once():
    looker = DepthRange(5000.0)
    blind = np.zeros((48, 64), np.float32)
    doubts = [doubt for _ in range(20) for doubt in looker.add(blind)]
    assert [doubt.name for doubt in doubts] == ["no-depth"]


def test_a_wrong_factor_is_said_once_and_counted_in_the_metrics(tmp_path: Path, caplog):
    folder = tmp_path / "room"
    room = sr.open_dataset(f"synthetic:walking,frames={N_FRAMES},fps=10")
    write_rgbd_folder(room, folder)
    write_camera(replace(room.camera, depth_factor=1000.0), folder / "camera.toml")
    with caplog.at_level(logging.WARNING):
        outcome = run(
            sr.open_dataset(str(folder)), sr.configure("orb-slam2"), RunOptions(tmp_path / "results", pictures=0)
        )
    assert outcome.folder is not None
    counted = json.loads((outcome.folder / "metrics.json").read_text())["run"]["doubts"]
    names = [doubt.rsplit("[see troubleshooting: ")[-1] for doubt in counted]
    assert names == ["depth-factor]", "scale]", "worse-than-static]"]
    assert "scaled by 0.2" in counted[1]
    assert caplog.text.count("[see troubleshooting: depth-factor]") == 1


def test_a_right_calibration_is_not_doubted(tmp_path: Path):
    room = sr.open_dataset(f"synthetic:walking,frames={N_FRAMES},fps=10")
    outcome = run(room, sr.configure("orb-slam2"), RunOptions(None, pictures=0))
    assert outcome.doubts == []
