"""TUM's layout: what it gives, and each way in which it can be bad ends in one line."""

import logging
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from stillroom.data.trajectory import read_tum
from stillroom.datasets.camera_file import write_camera
from stillroom.datasets.open import open_dataset
from stillroom.datasets.selection import select
from stillroom.datasets.tum import open_tum, read_list
from stillroom.errors import CalibrationError, DatasetError, FrameError, TrajectoryError
from stillroom.geometry.camera import Camera
from stillroom.session.front_door import evaluate


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def rgb_line(folder: Path, k: int) -> str:
    return (folder / "rgb.txt").read_text().splitlines()[2 + k]


def image_file(folder: Path, name: str, k: int) -> Path:
    return sorted((folder / name).iterdir())[k]


def overwrite(path: Path, pixels: np.ndarray) -> None:
    path.write_bytes(cv2.imencode(".png", pixels)[1].tobytes())


def one_line(caught: pytest.ExceptionInfo[Exception]) -> str:
    message = str(caught.value)
    assert "\n" not in message
    return message


def test_opens_a_folder(tiny: Path) -> None:
    sequence = open_tum(tiny)
    assert len(sequence) == 6
    assert sequence.name == "tiny"
    assert len(sequence.unpaired_s) == 0
    assert sequence.groundtruth is not None
    assert len(sequence.groundtruth) == 6
    assert sequence.timestamps_s[0] == pytest.approx(1305031229.5, abs=1e-6)
    image = sequence.load(4)
    assert image.index == 4
    assert image.timestamp_s == sequence.timestamps_s[4]
    assert image.depth_m[0, 0] == np.float32(1.9)


def test_without_ground_truth_there_is_none(tiny: Path) -> None:
    (tiny / "groundtruth.txt").unlink()
    assert open_tum(tiny).groundtruth is None


def test_a_missing_folder_is_said(tmp_path: Path) -> None:
    for opened in (lambda p: open_tum(p), lambda p: open_dataset(str(p))):
        with pytest.raises(DatasetError, match=r"absent: no such folder"):
            opened(tmp_path / "absent")


@pytest.mark.parametrize("name", ["rgb.txt", "depth.txt"])
def test_a_missing_list_is_said(name: str, tiny: Path) -> None:
    (tiny / name).unlink()
    with pytest.raises(DatasetError, match=f"tiny: no {name} in it"):
        open_tum(tiny)


def test_a_folder_without_lists_and_images_is_no_sequence(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"no rgb\.txt and no folder rgb/"):
        open_dataset(str(tmp_path))


@pytest.mark.parametrize("name", ["rgb.txt", "depth.txt"])
@pytest.mark.parametrize("content", ["", "# timestamp filename\n\n"])
def test_an_empty_list_is_said(name: str, content: str, tiny: Path) -> None:
    (tiny / name).write_text(content)
    with pytest.raises(DatasetError, match=f"{name}: lists no images"):
        open_tum(tiny)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("1305031229.6", "rgb.txt:4: '1305031229.6' is no line"),
        ("yesterday rgb/a.png", "rgb.txt:4: 'yesterday' is no timestamp"),
        ("nan rgb/a.png", "rgb.txt:4: the timestamp is not a finite number"),
        ("1305031229.500000 rgb/a.png", "rgb.txt:4: the timestamp 1305031229.500000 repeats"),
        ("1305031229.400000 rgb/a.png", "rgb.txt:4: the timestamp 1305031229.400000 goes back"),
    ],
)
def test_a_bad_line_is_named(line: str, said: str, tiny: Path) -> None:
    edit(tiny / "rgb.txt", rgb_line(tiny, 1), line)
    with pytest.raises(DatasetError) as caught:
        open_tum(tiny)
    assert said in one_line(caught)


def test_a_list_that_is_no_text_is_said(tiny: Path) -> None:
    (tiny / "rgb.txt").write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(DatasetError, match=r"rgb\.txt: cannot be read as text"):
        open_tum(tiny)


def test_file_names_may_hold_spaces(tmp_path: Path) -> None:
    path = tmp_path / "rgb.txt"
    path.write_text("1.0 rgb/an image.png\n2.0\trgb/b.png\n")
    listing = read_list(path)
    assert listing.files == (tmp_path / "rgb/an image.png", tmp_path / "rgb/b.png")
    assert listing.timestamps_s.tolist() == [1.0, 2.0]


def test_a_frame_without_depth_is_left_out_and_counted(tiny: Path, caplog: pytest.LogCaptureFixture) -> None:
    lines = (tiny / "depth.txt").read_text().splitlines()
    (tiny / "depth.txt").write_text("\n".join(lines[:4] + lines[5:]) + "\n")
    with caplog.at_level(logging.INFO, logger="stillroom"):
        sequence = open_tum(tiny)
    assert len(sequence) == 5
    assert sequence.unpaired_s == pytest.approx([1305031229.5 + 2 / 30], abs=1e-5)
    assert "1 of 6 colour images have no depth image" in caplog.text
    assert [sequence.load(i).depth_m[0, 0] for i in range(5)] == pytest.approx([1.5, 1.6, 1.8, 1.9, 2.0])


def test_lists_in_other_units_pair_nothing(tiny: Path) -> None:
    (tiny / "depth.txt").write_text((tiny / "depth.txt").read_text().replace("\n13050312", "\n23050312"))
    with pytest.raises(DatasetError, match=r"no colour image has a depth image within 0\.02 s"):
        open_tum(tiny)


def test_a_bad_frame_in_the_middle_costs_that_frame_only(tiny: Path) -> None:
    image_file(tiny, "rgb", 2).write_bytes(b"nothing of an image")
    overwrite(image_file(tiny, "depth", 4), np.zeros((48, 64), np.uint8))
    overwrite(image_file(tiny, "depth", 5), np.zeros((24, 32), np.uint16))
    image_file(tiny, "depth", 3).unlink()
    sequence = open_tum(tiny)
    said = ["does not decode", "no such image", "1 channel(s) of 8 bits", "depth of 32×24 pixels, colour of 64×48"]
    for index, words in zip(range(2, 6), said, strict=True):
        with pytest.raises(FrameError) as caught:
            sequence.load(index)
        assert words in one_line(caught)
    assert sequence.load(1).index == 1


def test_a_frame_of_another_size_in_the_middle_is_said(tiny: Path) -> None:
    overwrite(image_file(tiny, "rgb", 2), np.zeros((24, 32, 3), np.uint8))
    overwrite(image_file(tiny, "depth", 2), np.zeros((24, 32), np.uint16))
    with pytest.raises(FrameError, match="32×24 pixels; the sequence has 64×48"):
        open_tum(tiny).load(2)


def test_a_first_frame_that_is_bad_does_not_condemn_the_rest(tiny: Path) -> None:
    image_file(tiny, "rgb", 0).write_bytes(b"")
    assert len(open_tum(tiny)) == 6


@pytest.mark.parametrize(
    ("pixels", "said"),
    [
        (np.zeros((48, 64), np.uint8), "1 channel(s) of 8 bits; depth must be one channel of 16 bits"),
        (np.zeros((24, 32), np.uint16), "depth must be registered to colour"),
    ],
)
def test_depth_that_is_wrong_throughout_fails_at_opening(pixels: np.ndarray, said: str, tiny: Path) -> None:
    for k in range(6):
        overwrite(image_file(tiny, "depth", k), pixels)
    with pytest.raises(DatasetError) as caught:
        open_tum(tiny)
    assert not isinstance(caught.value, FrameError)
    assert said in one_line(caught)
    assert "none of the first 5 frames can be used" in one_line(caught)


def test_a_camera_of_another_size_is_said(tiny: Path) -> None:
    write_camera(Camera(320, 240, 300, 300, 160, 120), tiny / "camera.toml")
    with pytest.raises(CalibrationError) as caught:
        open_tum(tiny)
    assert "64×48 pixels, but the camera" in one_line(caught)
    assert "has 320×240" in one_line(caught)


def test_a_camera_file_with_an_unknown_key_is_said(tiny: Path) -> None:
    edit(tiny / "camera.toml", "depth_factor", "depth_facto")
    with pytest.raises(CalibrationError, match="unknown key 'depth_facto'; did you mean 'depth_factor'"):
        open_tum(tiny)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("0.0100000", "nan", r"groundtruth\.txt:3: a number is not finite"),
        ("1.0000000", "0.5000000", r"groundtruth\.txt:2: the quaternion has length 0\.500"),
    ],
)
def test_bad_ground_truth_is_said_at_opening_and_left_out(
    old: str, new: str, said: str, tiny: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tiny / "right.tum").write_bytes((tiny / "groundtruth.txt").read_bytes())
    edit(tiny / "groundtruth.txt", old, new)
    sequence = open_tum(tiny)
    assert len(sequence) == 6
    assert sequence.groundtruth is None
    warnings = [record.getMessage() for record in caplog.records if record.levelno >= logging.WARNING]
    assert len(warnings) == 1
    assert re.search(said, warnings[0])
    for shown in (sequence, select(sequence, ":3"), select(sequence, reverse=True)):
        with pytest.raises(TrajectoryError, match=said + r".*\[see troubleshooting: groundtruth\]"):
            evaluate(read_tum(tiny / "right.tum"), shown)


def test_a_gap_of_seconds_is_one_warning(tiny: Path, caplog: pytest.LogCaptureFixture) -> None:
    for name in ("rgb", "depth"):
        lines = (tiny / f"{name}.txt").read_text().splitlines()
        for k, shift_s in ((4, 3.5), (5, 6.5)):
            stamp, file = lines[2 + k].split()
            lines[2 + k] = f"{float(stamp) + shift_s:.6f} {file}"
        (tiny / f"{name}.txt").write_text("\n".join(lines) + "\n")
    sequence = open_tum(tiny)
    warnings = [record.getMessage() for record in caplog.records if record.levelno >= logging.WARNING]
    assert warnings == ["tiny: 2 gap(s) in time, the longest 3.5 s before image 4; tracking may be lost there"]
    assert len(sequence) == 6


def test_a_slow_recording_is_no_gap(tiny: Path, caplog: pytest.LogCaptureFixture) -> None:
    for name in ("rgb", "depth"):
        lines = (tiny / f"{name}.txt").read_text().splitlines()[2:]
        slow = [f"{1305031229 + 2 * k}.0 {line.split()[1]}" for k, line in enumerate(lines)]
        (tiny / f"{name}.txt").write_text("\n".join(slow) + "\n")
    assert len(open_tum(tiny)) == 6
    assert not caplog.records


def test_a_black_frame_and_one_without_any_depth_load(tiny: Path) -> None:
    overwrite(image_file(tiny, "rgb", 1), np.zeros((48, 64, 3), np.uint8))
    overwrite(image_file(tiny, "depth", 2), np.zeros((48, 64), np.uint16))
    sequence = open_tum(tiny)
    assert not sequence.load(1).rgb.any()
    assert not sequence.load(2).depth_m.any()
    assert sequence.load(2).rgb.any()


def test_the_real_stretch_of_freiburg1(freiburg1: Path) -> None:
    sequence = open_dataset(str(freiburg1))
    assert len(sequence) == 150
    assert "freiburg1" in sequence.camera_source
    assert sequence.camera.fx == 517.306408
    groundtruth = sequence.groundtruth
    assert groundtruth is not None
    # The file has four decimals, so its quaternions are off by up to 1e-4 in length; the rotations must not be.
    R = groundtruth.T_world_cam[:, :3, :3]
    assert np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)).max() < 1e-12
    assert len(groundtruth) == len(read_tum(freiburg1 / "groundtruth.txt")) == 507
