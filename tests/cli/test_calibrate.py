"""`stillroom calibrate shutter`: what it prints goes into a camera file as it is, and refusals are one line."""

import re
from pathlib import Path

import pytest

from stillroom.datasets.camera_file import read_camera, write_camera
from stillroom.datasets.open import open_dataset


def test_the_line_is_one_for_the_camera_file(stillroom: object, tmp_path: Path) -> None:
    said = stillroom("calibrate", "shutter", "synthetic:empty,path=rpy,frames=60,readout_ms=25")  # type: ignore[operator]
    assert said.code == 0
    line = said.out.splitlines()[-1]
    assert re.fullmatch(r"readout_s = 0\.02\d\d  # ± 0\.00\d\d", line)
    file = tmp_path / "camera.toml"
    write_camera(open_dataset("synthetic:empty,frames=1,cache=off").camera, file)
    kept = "".join(row for row in file.read_text().splitlines(True) if not row.startswith("readout_s"))
    file.write_text(kept + line + "\n", encoding="utf-8")
    assert read_camera(file).readout_s == pytest.approx(0.025, abs=0.003)
    assert "rows are read in" in said.out


def test_a_camera_at_rest_ends_in_one_line(stillroom: object) -> None:
    said = stillroom("calibrate", "shutter", "synthetic:empty,path=still,frames=50")  # type: ignore[operator]
    assert said.code == 1
    assert len(said.errors) == 1
    assert "the motion does not tell the readout" in said.errors[0]
    assert "[see troubleshooting: readout]" in said.errors[0]


def test_a_camera_in_place_of_a_recording_is_refused(stillroom: object) -> None:
    said = stillroom("calibrate", "shutter", "camera:realsense")  # type: ignore[operator]
    assert said.code == 1
    assert "is a camera, and this needs a sequence" in said.errors[0]


def test_the_clock_of_depth_has_a_line_for_the_camera_file(stillroom: object, tmp_path: Path) -> None:
    said = stillroom("calibrate", "depth", "synthetic:empty,path=rpy,frames=70,depth_late_ms=15")  # type: ignore[operator]
    assert said.code == 0
    line = said.out.splitlines()[-1]
    assert re.fullmatch(r"depth_offset_s = -0\.01\d\d  # ± 0\.00\d\d", line)
    file = tmp_path / "camera.toml"
    write_camera(open_dataset("synthetic:empty,frames=1,cache=off").camera, file)
    kept = "".join(row for row in file.read_text().splitlines(True) if not row.startswith("depth_offset_s"))
    file.write_text(kept + line + "\n", encoding="utf-8")
    assert read_camera(file).depth_offset_s == pytest.approx(-0.015, abs=0.004)
    assert "depth is stamped" in said.out
