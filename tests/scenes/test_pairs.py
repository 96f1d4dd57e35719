"""Rendered pairs: rows, disparities and poses against the scene's own depth, and what cannot be chosen."""

import cv2
import numpy as np
import pytest

from stillroom.data.image import StereoImage
from stillroom.data.sensor import Sensor
from stillroom.datasets.open import open_dataset
from stillroom.errors import ConfigError
from stillroom.testing.dataset_contract import check_dataset
from stillroom.testing.stereo_rows import disparities_px
from stillroom_scenes.config import open_synthetic
from stillroom_scenes.eyes import BASELINE_M, turned_eyes
from stillroom_scenes.pair_room import PairRoom
from stillroom_scenes.room import CAMERA

SPEC = "synthetic:walking,frames=40,seed=2"


def pair(how: str) -> tuple[PairRoom, StereoImage]:
    room = open_synthetic(f"{SPEC},stereo={how}")
    assert isinstance(room, PairRoom)
    image = room.load(20)
    assert isinstance(image, StereoImage)
    return room, image


@pytest.mark.parametrize("how", ["rectified", "turned"])
def test_the_right_image_shows_each_pixel_where_its_depth_says(how: str) -> None:
    """The right image, read at x − bf/z, is the left one; a row or a pixel aside it is much less so."""
    room, image = pair(how)
    depth_m = room.truth(20).depth_m
    y, x = np.mgrid[: image.height, : image.width].astype(np.float32)
    at = x - (room.camera.bf / np.maximum(depth_m, 0.1)).astype(np.float32)

    def off(across: float, down: float) -> float:
        seen = cv2.remap(image.right, at + across, y + down, cv2.INTER_LINEAR).astype(float)
        return float(np.mean(np.minimum(np.abs(seen - image.gray), 30.0)))

    for across, down in ((1.0, 0.0), (-1.0, 0.0), (0.0, 0.5), (0.0, -0.5)):
        assert off(0.0, 0.0) < 0.85 * off(across, down)
    assert np.median(np.abs(disparities_px(image)[:, 1])) < 0.1


@pytest.mark.parametrize("how", ["rectified", "turned"])
def test_poses_are_those_of_the_rectified_left_camera(how: str) -> None:
    """A corner of the still room, back-projected by the truth of one frame, is where another frame shows it."""
    room, _ = pair(how)
    first, last = room.truth(0), room.truth(39)
    still = (first.instance == 0) & (first.depth_m > 0)
    rows, columns = (each[::997] for each in np.nonzero(still))
    px = np.column_stack((columns, rows)).astype(np.float32)
    points_m = room.camera.back_project(px, first.depth_m[rows, columns])
    T = np.linalg.inv(last.T_world_cam) @ first.T_world_cam
    there_m = points_m @ T[:3, :3].T + T[:3, 3]
    seen_px = np.rint(room.camera.project(there_m)).astype(int)
    inside = np.all((seen_px >= 0) & (seen_px < (640, 480)), axis=1)
    found_m = last.depth_m[seen_px[inside, 1], seen_px[inside, 0]]
    assert inside.sum() > 100
    assert np.mean(np.abs(found_m - there_m[inside, 2]) < 0.02) > 0.8  # people cover the rest
    assert room.groundtruth is not None
    np.testing.assert_array_equal(room.groundtruth.T_world_cam[39], last.T_world_cam)


def test_the_turned_pair_is_turned_by_a_degree_and_distorted() -> None:
    eyes = turned_eyes(CAMERA)
    turn, _ = cv2.Rodrigues(eyes.right.T_left_eye[:3, :3])
    assert np.degrees(np.linalg.norm(turn)) == pytest.approx(1.0)
    assert eyes.left.camera.is_distorted
    assert eyes.right.camera.is_distorted
    assert eyes.camera.bf == pytest.approx(eyes.camera.fx * BASELINE_M)


@pytest.mark.parametrize("how", ["rectified", "turned"])
def test_pairs_keep_the_contract(how: str) -> None:
    check_dataset(open_dataset(f"{SPEC.replace('40', '9')},stereo={how}"))


def test_the_sensor_asked_for_makes_a_pair_or_drops_the_depth() -> None:
    assert open_dataset(SPEC).sensor is Sensor.RGBD
    assert open_dataset(SPEC, sensor="stereo").name.endswith("_stereo")
    assert open_dataset(f"{SPEC},stereo=turned", sensor="stereo").name.endswith("_stereo_turned")
    mono = open_dataset(SPEC, sensor="monocular")
    assert mono.sensor is Sensor.MONOCULAR
    image = mono.load(3)
    assert image.truth is not None
    assert image.truth.has_any


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("stereo=twisted", "stereo is 'twisted'; .*there are none, rectified, turned"),
        ("stereo=rectified,readout_ms=20", "readout_ms is for the RGB-D camera"),
    ],
)
def test_what_cannot_be_is_refused(options: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        open_synthetic(f"{SPEC},{options}")
