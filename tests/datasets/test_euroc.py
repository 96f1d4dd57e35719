"""EuRoC's layout: pairs and single images, whole nanoseconds, truth moved to the camera, and what is refused."""

import logging
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from pair_folders import BASELINE_M, DISPARITY_PX, START_NS, T_BODY_LEFT, F, right_of, sensor_yaml, write_euroc

from stillroom.data.image import MonoImage, StereoImage
from stillroom.data.sensor import Sensor
from stillroom.datasets.euroc import EUROC_LEFT
from stillroom.datasets.euroc_files import read_sensor, read_stamps
from stillroom.datasets.open import open_dataset
from stillroom.errors import CalibrationError, ConfigError, DatasetError, StillroomError
from stillroom.testing.dataset_contract import check_dataset
from stillroom.testing.stereo_rows import disparities_px


def test_a_pair_is_stereo_and_keeps_the_contract(tmp_path: Path) -> None:
    dataset = open_dataset(str(write_euroc(tmp_path / "walls")))
    assert dataset.sensor is Sensor.STEREO
    assert dataset.camera.bf == pytest.approx(dataset.camera.fx * BASELINE_M)
    image = dataset.load(2)
    assert isinstance(image, StereoImage)
    across_px, down_px = np.median(disparities_px(image), axis=0)
    assert across_px == pytest.approx(DISPARITY_PX * dataset.camera.fx / F, abs=0.1)
    assert abs(down_px) < 0.05
    check_dataset(dataset)


def test_a_mav0_folder_opens_by_itself(tmp_path: Path) -> None:
    write_euroc(tmp_path / "walls", states=True)
    assert len(open_dataset(str(tmp_path / "walls" / "mav0"))) == 6


def test_one_camera_is_monocular_and_distorted_as_taken(tmp_path: Path) -> None:
    folder = write_euroc(tmp_path / "walls", cameras=1)
    bent = sensor_yaml(T_BODY_LEFT, "[-0.1, 0.01, 0.001, -0.002]")
    (folder / "mav0" / "cam0" / "sensor.yaml").write_text(bent)
    dataset = open_dataset(str(folder))
    assert dataset.sensor is Sensor.MONOCULAR
    assert dataset.camera.distortion == (-0.1, 0.01, 0.001, -0.002, 0.0)
    assert isinstance(dataset.load(0), MonoImage)
    check_dataset(dataset)


def test_the_left_camera_of_a_pair_can_be_used_alone(tmp_path: Path) -> None:
    dataset = open_dataset(str(write_euroc(tmp_path / "walls")), sensor="monocular")
    assert dataset.sensor is Sensor.MONOCULAR
    assert not dataset.load(0).has_depth_image


@pytest.mark.parametrize("states", [False, True])
@pytest.mark.parametrize("cameras", [1, 2])
def test_the_truth_of_the_body_is_moved_to_the_camera(tmp_path: Path, states: bool, cameras: int) -> None:
    """By hand: the body is turned by q = (x ½, y −½, z ½, w ½), which takes x to z̄ … and moves along x."""
    dataset = open_dataset(str(write_euroc(tmp_path / "walls", cameras=cameras, states=states)))
    R = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])  # of that quaternion
    assert dataset.groundtruth is not None
    poses = dataset.groundtruth.T_world_cam
    np.testing.assert_allclose(poses[0, :3, :3], R @ T_BODY_LEFT[:3, :3], atol=1e-9)
    np.testing.assert_allclose(poses[0, :3, 3], R @ T_BODY_LEFT[:3, 3], atol=1e-9)
    assert dataset.groundtruth_at_camera is None
    np.testing.assert_array_equal(dataset.groundtruth.timestamps_s, dataset.timestamps_s)


def test_stamps_stay_whole_numbers(tmp_path: Path) -> None:
    """1403715273262142976 and the next number are the same float64."""
    write_euroc(tmp_path / "walls")
    path = tmp_path / "walls" / "mav0" / "cam0" / "data.csv"
    path.write_text(f"#timestamp [ns],filename\n{START_NS},a.png\n{START_NS + 1},b.png\n")
    assert list(read_stamps(path)) == [START_NS, START_NS + 1]


def test_images_of_one_camera_alone_are_left_out_and_counted(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    folder = write_euroc(tmp_path / "walls")
    path = folder / "mav0" / "cam1" / "data.csv"
    path.write_text("".join(line for line in path.read_text().splitlines(True) if "312142976" not in line))
    with caplog.at_level(logging.WARNING):
        dataset = open_dataset(str(folder))
    assert len(dataset) == 5
    assert len(dataset.unpaired_s) == 1
    assert "1 of 6 left images have no right image of the same moment" in caplog.text


def test_without_sensor_yaml_the_built_in_rig_is_named(tmp_path: Path) -> None:
    folder = write_euroc(tmp_path / "walls")
    for path in (folder / "mav0").rglob("sensor.yaml"):
        path.unlink()
    for path in (folder / "mav0").rglob("*.png"):
        cv2.imwrite(str(path), np.zeros((480, 752), np.uint8))
    dataset = open_dataset(str(folder))
    assert dataset.camera_source.startswith("'euroc', because there is no cam0/sensor.yaml")
    assert dataset.camera.bf == pytest.approx(47.906, abs=1e-3)


def bad_camera_model(folder: Path) -> None:
    path = folder / "mav0" / "cam0" / "sensor.yaml"
    path.write_text(path.read_text().replace("radial-tangential", "equidistant"))


def no_pose(folder: Path) -> None:
    path = folder / "mav0" / "cam1" / "sensor.yaml"
    path.write_text(path.read_text().replace("T_BS:", "T_SB:"))


def few_intrinsics(folder: Path) -> None:
    path = folder / "mav0" / "cam0" / "sensor.yaml"
    path.write_text(path.read_text().replace(f"[{F}, {F}, ", f"[{F}, "))


def scaled_pose(folder: Path) -> None:
    (folder / "mav0" / "cam0" / "sensor.yaml").write_text(sensor_yaml(T_BODY_LEFT * 2.0))


def one_yaml(folder: Path) -> None:
    (folder / "mav0" / "cam1" / "sensor.yaml").unlink()


def exchanged(folder: Path) -> None:
    (folder / "mav0" / "cam0" / "sensor.yaml").write_text(sensor_yaml(right_of(T_BODY_LEFT)))
    (folder / "mav0" / "cam1" / "sensor.yaml").write_text(sensor_yaml(T_BODY_LEFT))


def binary_yaml(folder: Path) -> None:
    (folder / "mav0" / "cam0" / "sensor.yaml").write_bytes(b"\x00\xff")


def other_moments(folder: Path) -> None:
    path = folder / "mav0" / "cam1" / "data.csv"
    path.write_text(path.read_text().replace("142976,", "142977,"))


def seconds(folder: Path) -> None:
    path = folder / "mav0" / "cam0" / "data.csv"
    path.write_text("1403715273.26,a.png\n")


def empty_list(folder: Path) -> None:
    (folder / "mav0" / "cam0" / "data.csv").write_text("#timestamp [ns],filename\n")


def no_right_images(folder: Path) -> None:
    shutil.rmtree(folder / "mav0" / "cam1" / "data")


def unequal_sizes(folder: Path) -> None:
    for path in (folder / "mav0" / "cam1" / "data").iterdir():
        cv2.imwrite(str(path), np.zeros((60, 94), np.uint8))


@pytest.mark.parametrize(
    ("spoil", "kind", "message"),
    [
        (
            bad_camera_model,
            CalibrationError,
            r"sensor\.yaml: 'distortion_model' is 'equidistant'; only radial-tang.*fisheye",
        ),
        (no_pose, CalibrationError, r"cam1/sensor\.yaml: 'T_BS' is missing"),
        (few_intrinsics, CalibrationError, r"'intrinsics' must be a list of 4 numbers"),
        (scaled_pose, CalibrationError, "'T_BS' is no pose"),
        (one_yaml, CalibrationError, r"cam1/sensor\.yaml: no such file, and the other camera has one"),
        (exchanged, CalibrationError, "are left and right exchanged"),
        (binary_yaml, CalibrationError, "cannot be read as text"),
        (other_moments, DatasetError, "no image of cam1 has the timestamp of one of cam0"),
        (seconds, DatasetError, r"data\.csv:1: '1403715273\.26' is no time in whole nanoseconds"),
        (empty_list, DatasetError, "lists no images"),
        (no_right_images, DatasetError, "none of the first 5 frames can be used; .*cam1.*no such image"),
        (unequal_sizes, DatasetError, "94×60 pixels, the left image 188×120; both of a pair must be of one size"),
    ],
    ids=lambda value: getattr(value, "__name__", None),
)
def test_bad_input_gives_one_line(spoil: object, kind: type[StillroomError], message: str, tmp_path: Path) -> None:
    folder = write_euroc(tmp_path / "walls")
    spoil(folder)  # type: ignore[operator]
    with pytest.raises(kind, match=message) as raised:
        open_dataset(str(folder))
    assert "\n" not in str(raised.value)


def test_what_a_sequence_has_not_is_refused(tmp_path: Path) -> None:
    one = str(write_euroc(tmp_path / "one", cameras=1))
    with pytest.raises(DatasetError, match=r"no cam1/data\.csv in it; a stereo sequence needs the second camera"):
        open_dataset(one, sensor="stereo")
    with pytest.raises(
        DatasetError, match="its images are monocular and have no depth images; leave --sensor rgbd out"
    ):
        open_dataset(one, sensor="rgbd")
    with pytest.raises(ConfigError, match="lists tell the times; leave --fps out"):
        open_dataset(one, fps=20.0)
    with pytest.raises(ConfigError, match="sensor is 'mono'; it must be one of rgbd, stereo, monocular"):
        open_dataset(one, sensor="mono")


def test_a_bad_truth_costs_the_figures_alone(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    folder = write_euroc(tmp_path / "walls", states=True)
    path = folder / "mav0" / "state_groundtruth_estimate0" / "data.csv"
    path.write_text(path.read_text().replace("0.5,0.5,-0.5,0.5", "0.5,0.5,-0.5,nan"))
    with caplog.at_level(logging.WARNING):
        dataset = open_dataset(str(folder))
    assert dataset.groundtruth is None
    assert "ground truth is left out" in caplog.text


@pytest.mark.real
def test_real_pairs_are_rectified(euroc_v101: Path) -> None:
    """The done-when of the rectification: at most half a pixel between the rows of matched corners."""
    dataset = open_dataset(str(euroc_v101))
    assert dataset.camera.bf == pytest.approx(47.90639384423901, abs=1e-4)
    down_px = np.concatenate([disparities_px(dataset.load(k))[:, 1] for k in range(0, 95, 19)])
    assert len(down_px) > 500
    assert np.median(np.abs(down_px)) <= 0.5
    raw = read_sensor(euroc_v101 / "mav0" / "cam0" / "sensor.yaml")
    assert raw.camera.lens == EUROC_LEFT.camera.lens
    np.testing.assert_array_equal(raw.T_body_cam, EUROC_LEFT.T_body_cam)
    check_dataset(dataset)


@pytest.mark.real
def test_the_real_truth_has_the_lever_arm_of_the_camera(euroc_v101: Path, euroc_mh05: Path) -> None:
    """|t_BS| of cam0 is 6.89 cm: as far are the positions of the camera from those of the body."""
    for folder in (euroc_v101, euroc_mh05):
        dataset = open_dataset(str(folder))
        rows = np.loadtxt(folder / "groundtruth.txt")
        assert dataset.groundtruth is not None
        away_m = np.linalg.norm(dataset.groundtruth.positions_m - rows[:, 1:4], axis=1)
        np.testing.assert_allclose(away_m, 0.0689, atol=1e-4)
