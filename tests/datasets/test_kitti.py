"""KITTI's layout: calibration with and without names, times, poses, and what is refused."""

import logging
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from pair_folders import BASELINE_M, CX, CY, DISPARITY_PX, STEP_M, F, write_kitti

from stillroom.data.image import MonoImage, StereoImage
from stillroom.data.sensor import Sensor
from stillroom.datasets.open import open_dataset
from stillroom.datasets.selection import select
from stillroom.errors import CalibrationError, DatasetError, StillroomError
from stillroom.geometry.camera import Camera
from stillroom.testing.dataset_contract import check_dataset
from stillroom.testing.stereo_rows import disparities_px


@pytest.mark.parametrize("named", [True, False])
def test_a_pair_is_stereo_and_keeps_the_contract(tmp_path: Path, named: bool) -> None:
    dataset = open_dataset(str(write_kitti(tmp_path / "00", named=named)))
    assert dataset.sensor is Sensor.STEREO
    assert dataset.camera == Camera(188, 120, F, F, CX, CY, bf=F * BASELINE_M)
    image = dataset.load(2)
    assert isinstance(image, StereoImage)
    np.testing.assert_allclose(np.median(disparities_px(image), axis=0), (DISPARITY_PX, 0.0), atol=0.05)
    np.testing.assert_allclose(dataset.timestamps_s, 0.1 * np.arange(6))
    assert dataset.groundtruth is not None
    np.testing.assert_allclose(dataset.groundtruth.positions_m[:, 0], STEP_M * np.arange(6))
    check_dataset(dataset)


def test_rows_of_other_sensors_are_no_cameras(tmp_path: Path) -> None:
    folder = write_kitti(tmp_path / "00")
    calib = folder / "calib.txt"
    calib.write_text(calib.read_text() + "Tr: 1 0 0 0 0 1 0 0 0 0 1 0\n")
    assert open_dataset(str(folder)).camera.fx == F


def test_the_left_images_alone_are_monocular(tmp_path: Path) -> None:
    folder = write_kitti(tmp_path / "00")
    asked = open_dataset(str(folder), sensor="monocular")
    shutil.rmtree(folder / "image_1")
    found = open_dataset(str(folder))
    for dataset in (asked, found):
        assert dataset.sensor is Sensor.MONOCULAR
        assert isinstance(dataset.load(0), MonoImage)
        check_dataset(dataset)
    with pytest.raises(DatasetError, match="no image_1/ in it; a stereo sequence needs the right images"):
        open_dataset(str(folder), sensor="stereo")


def test_poses_lie_beside_the_sequences_as_in_the_data_set(tmp_path: Path) -> None:
    folder = write_kitti(tmp_path / "sequences" / "07")
    (tmp_path / "poses").mkdir()
    (folder / "poses.txt").rename(tmp_path / "poses" / "07.txt")
    assert open_dataset(str(folder)).groundtruth is not None


def test_a_part_of_the_images_has_the_times_and_poses_of_its_numbers(tmp_path: Path) -> None:
    folder = write_kitti(tmp_path / "00")
    for k in (0, 3):
        for side in (0, 1):
            (folder / f"image_{side}" / f"{k:06d}.png").unlink()
    dataset = open_dataset(str(folder))
    np.testing.assert_allclose(dataset.timestamps_s, 0.1 * np.array([1, 2, 4, 5]))
    assert dataset.groundtruth is not None
    np.testing.assert_allclose(dataset.groundtruth.positions_m[:, 0], STEP_M * np.array([1, 2, 4, 5]))


def test_left_images_without_a_right_one_are_counted(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    folder = write_kitti(tmp_path / "00")
    (folder / "image_1" / "000002.png").unlink()
    with caplog.at_level(logging.WARNING):
        dataset = open_dataset(str(folder))
    np.testing.assert_allclose(dataset.unpaired_s, [0.2])
    assert "1 of 6 left images have no right image" in caplog.text


def test_selections_work_for_pairs(tmp_path: Path) -> None:
    dataset = select(open_dataset(str(write_kitti(tmp_path / "00"))), "1:5", blackout=["2:3"], reverse=True)
    assert dataset.sensor is Sensor.STEREO
    dark = next(image for image in dataset if image.index == 3)  # counted from the end
    assert isinstance(dark, StereoImage)
    assert not dark.rgb.any()
    assert not dark.right.any()
    check_dataset(dataset)


def test_a_frame_rate_stands_in_for_times(tmp_path: Path) -> None:
    folder = write_kitti(tmp_path / "00")
    (folder / "times.txt").unlink()
    with pytest.raises(DatasetError, match=r"no times\.txt in it; give the frame rate \(--fps\)"):
        open_dataset(str(folder))
    np.testing.assert_allclose(open_dataset(str(folder), fps=20.0).timestamps_s, 0.05 * np.arange(6))


def no_calibration(folder: Path) -> None:
    (folder / "calib.txt").unlink()


def no_p1(folder: Path) -> None:
    (folder / "calib.txt").write_text((folder / "calib.txt").read_text().splitlines()[0])


def eleven_numbers(folder: Path) -> None:
    (folder / "calib.txt").write_text("P0: 1 2 3 4 5 6 7 8 9 10 11\n")


def exchanged(folder: Path) -> None:
    path = folder / "calib.txt"
    path.write_text(path.read_text().replace(f"{-F * BASELINE_M}", f"{F * BASELINE_M}"))


def other_lenses(folder: Path) -> None:
    path = folder / "calib.txt"
    path.write_text(path.read_text().replace(f"P1: {F}", "P1: 111.0"))


def too_few_times(folder: Path) -> None:
    (folder / "times.txt").write_text("0.0\n0.1\n0.2\n")


def times_go_back(folder: Path) -> None:
    (folder / "times.txt").write_text("0.0\n0.1\n0.2\n0.1\n0.4\n0.5\n")


def no_left_images(folder: Path) -> None:
    for path in (folder / "image_0").iterdir():
        path.unlink()


def other_names(folder: Path) -> None:
    for path in (folder / "image_1").iterdir():
        path.rename(path.with_name(f"right_{path.name}"))


def unequal_sizes(folder: Path) -> None:
    for path in (folder / "image_1").iterdir():
        cv2.imwrite(str(path), np.zeros((60, 94), np.uint8))


@pytest.mark.parametrize(
    ("spoil", "kind", "message"),
    [
        (no_calibration, CalibrationError, r"calib\.txt: no such file; a KITTI sequence needs its calibration"),
        (no_p1, CalibrationError, "'P1' is missing, the projection of image_1"),
        (eleven_numbers, CalibrationError, r"calib\.txt:1: 'P0' has not twelve numbers"),
        (exchanged, CalibrationError, "are left and right exchanged"),
        (other_lenses, CalibrationError, "P0 and P1 differ in their intrinsics"),
        (too_few_times, DatasetError, "3 times for 6 images in image_0/, whose names do not tell which is whose"),
        (times_go_back, DatasetError, "row 4: the timestamp 0.100000 goes back"),
        (no_left_images, DatasetError, "image_0: no images in it"),
        (other_names, DatasetError, "no image of image_1 is called like one of image_0"),
        (unequal_sizes, DatasetError, "94×60 pixels, the left image 188×120; both of a pair must be of one size"),
    ],
    ids=lambda value: getattr(value, "__name__", None),
)
def test_bad_input_gives_one_line(spoil: object, kind: type[StillroomError], message: str, tmp_path: Path) -> None:
    folder = write_kitti(tmp_path / "00")
    spoil(folder)  # type: ignore[operator]
    with pytest.raises(kind, match=message) as raised:
        open_dataset(str(folder))
    assert "\n" not in str(raised.value)


def test_a_pose_too_few_costs_the_figures_alone(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    folder = write_kitti(tmp_path / "00")
    (folder / "poses.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n")
    with caplog.at_level(logging.WARNING):
        dataset = open_dataset(str(folder))
    assert dataset.groundtruth is None
    assert "1 poses for 6 images" in caplog.text


@pytest.mark.real
def test_the_real_stretch_is_read_back(kitti: Path) -> None:
    dataset = open_dataset(str(kitti))
    assert len(dataset) == 51
    assert dataset.camera == Camera(1226, 370, 707.0912, 707.0912, 601.8873, 183.1104, bf=379.8145)
    rows = np.loadtxt(kitti / "poses.txt").reshape(-1, 3, 4)
    assert dataset.groundtruth is not None
    np.testing.assert_allclose(dataset.groundtruth.T_world_cam[:, :3], rows, atol=2e-6)
    path_m = np.linalg.norm(np.diff(dataset.groundtruth.positions_m, axis=0), axis=1).sum()
    assert path_m == pytest.approx(60.0, abs=1.0)
    check_dataset(dataset)


@pytest.mark.parametrize("there", ["image_1", "image_2"])
def test_a_folder_without_the_left_grey_images_is_told_what_it_lacks(there: str, tmp_path: Path) -> None:
    (tmp_path / "00" / there).mkdir(parents=True)
    with pytest.raises(DatasetError, match="00: no folder image_0/ in it; the grey pair, image_0/ and image_1/, is"):
        open_dataset(str(tmp_path / "00"))


def test_a_camera_file_of_a_pair_names_its_baseline(tmp_path: Path) -> None:
    """Without it, that of a Kinect would hold, and all lengths would be too small without a word."""
    folder, file = write_kitti(tmp_path / "00"), tmp_path / "mine.toml"
    file.write_text(f"width = 188\nheight = 120\nfx = {F}\nfy = {F}\ncx = {CX}\ncy = {CY}\n")
    with pytest.raises(CalibrationError, match=r"mine\.toml: 'baseline_m' is missing; all lengths"):
        open_dataset(str(folder), camera=str(file))
    assert open_dataset(str(folder), camera=str(file), sensor="monocular").sensor is Sensor.MONOCULAR
    file.write_text(file.read_text() + f"baseline_m = {BASELINE_M}\n")
    assert open_dataset(str(folder), camera=str(file)).camera.bf == pytest.approx(F * BASELINE_M)
