"""A recorded sequence as a camera, and what can be wrong with it."""

from pathlib import Path

import numpy as np
import pytest

from stillroom.cameras.faults import Faults
from stillroom.cameras.registry import all_kinds, is_camera, kind_of, open_camera
from stillroom.cameras.replay import ReplayCamera
from stillroom.data.image import RgbdImage
from stillroom.datasets.open import open_dataset
from stillroom.errors import CameraError, ConfigError, DatasetError, FrameError
from stillroom.protocols import CameraStream
from stillroom.testing.camera_contract import check_camera
from stillroom.testing.tiny_sequence import write_tiny_sequence

LENGTH = 8


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_tiny_sequence(tmp_path / "tiny", LENGTH)
    return tmp_path / "tiny"


def seen(stream: CameraStream) -> list[int | str]:
    """Return the numbers of the images that come, and errors in their place."""
    found: list[int | str] = []
    with stream:
        while True:
            try:
                image = stream.next()
            except FrameError:
                found.append("damaged")
                continue
            except CameraError:
                return [*found, "gone"]
            if image is None:
                return found
            found.append(image.index)


def test_a_folder_keeps_the_contract_of_cameras(folder: Path) -> None:
    images = check_camera(lambda: open_camera(f"camera:replay:{folder}"))
    dataset = open_dataset(str(folder))
    for place, image in enumerate(images):
        of_folder = dataset.load(place)
        assert (image.timestamp_s, image.index, image.name) == (of_folder.timestamp_s, place, of_folder.name)
        assert np.array_equal(image.rgb, of_folder.rgb)
        assert np.array_equal(image.depth_m, of_folder.depth_m)


def test_it_has_what_the_folder_has_and_begins_anew_when_it_is_entered_again(folder: Path) -> None:
    camera, dataset = open_camera(f"camera:replay:{folder}"), open_dataset(str(folder))
    assert (camera.name, camera.camera, camera.camera_source) == ("tiny", dataset.camera, dataset.camera_source)
    assert camera.groundtruth is not None
    assert dataset.groundtruth is not None
    assert np.array_equal(camera.groundtruth.T_world_cam, dataset.groundtruth.T_world_cam)
    assert camera.groundtruth_at_camera is None
    assert seen(camera) == seen(camera) == list(range(LENGTH))
    assert camera.next() is None


def test_whatever_open_dataset_opens_can_be_played() -> None:
    [image] = check_camera(lambda: open_camera("camera:replay:synthetic:walking,frames=1"))
    assert isinstance(image, RgbdImage)
    assert image.truth is not None


@pytest.mark.parametrize(
    ("faults", "expected"),
    [
        ("", [0, 1, 2, 3, 4, 5, 6, 7]),
        ("missing=0,3", [1, 2, 4, 5, 6, 7]),
        ("doubled=2", [0, 1, 2, 2, 3, 4, 5, 6, 7]),
        ("swapped=2", [0, 1, 3, 2, 4, 5, 6, 7]),
        ("swapped=2,3,7", [0, 1, 4, 3, 2, 5, 6, 7]),
        ("unreadable=1,7", [0, "damaged", 2, 3, 4, 5, 6, "damaged"]),
        ("gone=2", [0, 1, 2, "gone"]),
        ("gone=2&missing=2", [0, 1, 3, "gone"]),
        ("missing=1&doubled=4&gone=5", [0, 2, 3, 4, 4, 5, "gone"]),
    ],
)
def test_faults(folder: Path, faults: str, expected: list[int | str]) -> None:
    assert seen(open_camera(f"camera:replay:{folder}?{faults}")) == expected
    assert seen(ReplayCamera(open_dataset(str(folder)), Faults.read(faults))) == expected


def test_once_the_cable_is_out_it_stays_out(folder: Path) -> None:
    with open_camera(f"camera:replay:{folder}?gone=0") as camera:
        assert camera.next() is not None
        for _ in range(2):
            with pytest.raises(CameraError, match=r"^camera:replay: tiny: the camera is gone$"):
                camera.next()


def test_late_images_are_waited_for(folder: Path) -> None:
    waited_s: list[float] = []
    faults = Faults.read("late=2:0.5,4:1e-3,6:0")
    assert faults == Faults(late={2: 0.5, 4: 0.001, 6: 0.0})
    assert seen(ReplayCamera(open_dataset(str(folder)), faults, waited_s.append)) == list(range(LENGTH))
    assert waited_s == [0.5, 0.001]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("missing", "'missing' is no fault"),
        ("missing=1&missing=2", "stands there twice"),
        ("missing=first", "invalid literal"),
        ("late=3", "could not convert"),
        ("late=3:-1", "is no image and its delay"),
        ("late=3:inf", "is no image and its delay"),
        ("gone=", "invalid literal"),
        ("asleep=3", "has no fault 'asleep'"),
    ],
)
def test_malformed_faults_are_one_line_that_names_what_there_is(folder: Path, text: str, reason: str) -> None:
    with pytest.raises(ConfigError, match=rf"^\?{text}: .*{reason}.*there is: missing, doubled, swapped") as raised:
        open_camera(f"camera:replay:{folder}?{text}")
    assert "\n" not in str(raised.value)


def test_a_folder_with_a_question_mark_in_its_name_is_a_folder(tmp_path: Path) -> None:
    write_tiny_sequence(tmp_path / "which?", 2)
    assert seen(open_camera(f"camera:replay:{tmp_path}/which?")) == [0, 1]
    assert seen(open_camera(f"camera:replay:{tmp_path}/which??missing=0")) == [1]


def test_what_cannot_be_played_is_one_line() -> None:
    with pytest.raises(ConfigError, match=r"name what is to be played: camera:replay:FOLDER"):
        open_camera("camera:replay")
    with pytest.raises(DatasetError, match="no such folder"):
        open_camera("camera:replay:no/where")


@pytest.mark.parametrize("text", ["camera:kinect", "camera:", "camera:kinect:3?x", "webcam"])
def test_an_unknown_camera_names_those_that_there_are(text: str) -> None:
    with pytest.raises(ConfigError) as raised:
        open_camera(text)
    assert str(raised.value).endswith(
        "; there is: camera:replay:FOLDER[?FAULTS], camera:realsense[:SERIAL], camera:oak[:ID]"
    )


def test_kinds() -> None:
    assert list(all_kinds()) == ["replay", "realsense", "oak"]
    assert kind_of("camera:replay:synthetic:walking").name == "replay"
    assert kind_of("camera:replay?gone=1").name == "replay"
    assert is_camera("camera:oak")
    assert not is_camera("cameras/of/mine")
