"""Sequences used as those of a single camera: with depth that is dropped, and without any."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from stillroom.data.image import MonoImage
from stillroom.data.sensor import Sensor
from stillroom.datasets.open import open_dataset
from stillroom.datasets.recording import sensor_of
from stillroom.datasets.selection import select
from stillroom.errors import CalibrationError, DatasetError
from stillroom.testing.dataset_contract import check_dataset


def without_depth(folder: Path) -> None:
    shutil.rmtree(folder / "depth")
    (folder / "depth.txt").unlink()


def test_depth_is_dropped_where_that_is_asked(tiny: Path) -> None:
    whole, single = open_dataset(str(tiny)), open_dataset(str(tiny), sensor="monocular")
    assert sensor_of(whole) is Sensor.RGBD
    assert single.sensor is Sensor.MONOCULAR
    image = single.load(3)
    assert isinstance(image, MonoImage)
    np.testing.assert_array_equal(image.rgb, whole.load(3).rgb)
    assert image.index == 3
    with pytest.raises(TypeError, match="a monocular image has no depth image"):
        _ = image.depth_m
    assert not image.known_depth_m.any()
    check_dataset(single)


def test_colours_alone_open_only_where_that_is_asked(tiny: Path) -> None:
    without_depth(tiny)
    with pytest.raises(
        DatasetError, match=r"no depth\.txt in it.*--sensor monocular tracks by the colour images alone"
    ):
        open_dataset(str(tiny))
    check_dataset(open_dataset(str(tiny), sensor="monocular"))


def test_colours_alone_need_no_list(tiny: Path) -> None:
    without_depth(tiny)
    (tiny / "rgb.txt").unlink()
    with pytest.raises(DatasetError, match=r"no folder depth/ in it; --sensor monocular"):
        open_dataset(str(tiny))
    timed = open_dataset(str(tiny), sensor="monocular")
    rated = open_dataset(str(tiny), sensor="monocular", fps=10.0)
    assert len(timed) == len(rated) == 6
    np.testing.assert_allclose(np.diff(rated.timestamps_s), 0.1, atol=1e-6)
    np.testing.assert_allclose(np.diff(timed.timestamps_s), 1 / 30, atol=1e-5)
    assert timed.groundtruth is not None


def test_a_single_camera_needs_no_depth_factor(tiny: Path) -> None:
    path = tiny / "camera.toml"
    path.write_text("".join(line for line in path.read_text().splitlines(True) if "depth_factor" not in line))
    with pytest.raises(CalibrationError, match="'depth_factor' is missing"):
        open_dataset(str(tiny))
    without_depth(tiny)
    assert open_dataset(str(tiny), sensor="monocular").camera.fx == 60.0


def test_an_rgbd_sequence_has_no_right_images(tiny: Path) -> None:
    with pytest.raises(DatasetError, match="its images are RGB-D and have no right images; leave --sensor stereo out"):
        open_dataset(str(tiny), sensor="stereo")


def test_selections_keep_the_sensor(tiny: Path) -> None:
    chosen = select(open_dataset(str(tiny), sensor="monocular"), "1:5", drop=["2:3"], blackout=["3:4"])
    assert chosen.sensor is Sensor.MONOCULAR
    assert [bool(image.rgb.any()) for image in chosen] == [True, False, True]
    check_dataset(chosen)
