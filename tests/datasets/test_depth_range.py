"""65535 and what lies beyond the sensor's range are no depth; all else is left as it is."""

import logging
from pathlib import Path

import cv2
import numpy as np
import pytest

from stillroom.datasets.image_sequence import without_unknown
from stillroom.datasets.open import open_dataset
from stillroom.datasets.tum import open_tum
from stillroom.errors import CalibrationError

ROW = "[see troubleshooting: depth-range]"


def with_pixel(path: Path, units: int) -> None:
    """Give the patch of a depth image, 8×8 pixels in its corner, other units."""
    pixels = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    pixels[:8, :8] = units
    cv2.imwrite(str(path), pixels)


def depth_files(folder: Path) -> list[Path]:
    return sorted((folder / "depth").iterdir())


def test_65535_is_no_depth_and_one_line_says_so(tiny: Path, caplog: pytest.LogCaptureFixture) -> None:
    before = open_tum(tiny).load(2).depth_m
    for path in depth_files(tiny):
        with_pixel(path, 65535)
    sequence = open_tum(tiny)
    depth_m = sequence.load(2).depth_m
    assert not depth_m[:8, :8].any()
    assert np.array_equal(depth_m[8:], before[8:])
    said = [record.getMessage() for record in caplog.records if record.levelno >= logging.WARNING]
    assert len(said) == 1
    assert "depth of 65535" in said[0]
    assert said[0].endswith(ROW)


def test_beyond_the_range_of_the_camera_file_is_no_depth(tiny: Path) -> None:
    with_pixel(depth_files(tiny)[0], 65534)  # 65.5 m
    assert open_tum(tiny).load(0).depth_m[0, 0] == np.float32(65.534)
    text = (tiny / "camera.toml").read_text(encoding="utf-8")
    (tiny / "camera.toml").write_text(text + "max_depth_m = 1.9\n", encoding="utf-8")
    sequence = open_tum(tiny)
    assert [float(sequence.load(k).depth_m[0, 0]) for k in range(6)] == pytest.approx([0, 1.6, 1.7, 1.8, 1.9, 0])
    assert not sequence.load(1).depth_m[8:].any()  # 2 m all around
    given = tiny.parent / "other.toml"
    given.write_text(text, encoding="utf-8")
    assert open_tum(tiny, str(given)).load(5).depth_m[0, 0] == 2.0  # the file given is in force, and knows no range


@pytest.mark.parametrize("value", ["0", "-1.0", "inf", "nan"])
def test_a_range_that_is_none_is_said(value: str, tiny: Path) -> None:
    with (tiny / "camera.toml").open("a", encoding="utf-8") as file:
        file.write(f"max_depth_m = {value}\n")
    with pytest.raises(CalibrationError, match="'max_depth_m' is") as caught:
        open_tum(tiny)
    assert str(caught.value).endswith(ROW)


def test_what_is_depth_is_not_even_copied() -> None:
    units = np.arange(65535, dtype=np.uint16).reshape(255, 257)
    assert without_unknown(units, 5000.0, np.inf) is units


@pytest.mark.real
def test_the_real_stretches_lose_nothing(bonn: Path, freiburg1: Path, caplog: pytest.LogCaptureFixture) -> None:
    for folder in (bonn, freiburg1):
        sequence = open_dataset(str(folder))
        for path in sequence.depth_files[::10]:
            units = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
            assert without_unknown(units, sequence.camera.depth_factor, sequence.range_m) is units
    assert not caplog.records
