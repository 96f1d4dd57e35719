"""What a camera sees, kept as a folder."""

import logging
import signal
import threading
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from stillroom.cameras.faults import Faults
from stillroom.cameras.recorder import TumRecorder, depth_in_units
from stillroom.cameras.registry import open_camera
from stillroom.cameras.replay import ReplayCamera
from stillroom.data.image import RgbdImage
from stillroom.datasets.bonn import marker_to_camera
from stillroom.datasets.open import open_dataset
from stillroom.errors import ConfigError, StillroomError
from stillroom.geometry.arrays import U8
from stillroom.pipeline.recording import record
from stillroom.testing.dataset_contract import check_dataset
from stillroom.testing.tiny_sequence import write_tiny_sequence

LENGTH = 8


@pytest.fixture
def tiny(tmp_path: Path) -> Path:
    write_tiny_sequence(tmp_path / "tiny", LENGTH)
    return tmp_path / "tiny"


def same_images(first: Path, second: Path, places: list[int]) -> None:
    """Check that the images of the second folder are those of the first at some places."""
    one, two = open_dataset(str(first)), open_dataset(str(second))
    assert one.camera == two.camera
    assert two.timestamps_s.tolist() == [one.timestamps_s[place] for place in places]
    for k, place in enumerate(places):
        assert np.array_equal(one.load(place).rgb, two.load(k).rgb)
        assert np.array_equal(one.load(place).depth_m, two.load(k).depth_m)


def test_a_recording_is_a_data_set_with_the_same_images(tiny: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    with open_camera(f"camera:replay:{tiny}") as camera:
        outcome = record(camera, out)
    assert (outcome.n_written, outcome.n_dropped, outcome.n_not_later, outcome.n_unreadable) == (LENGTH, 0, 0, 0)
    same_images(tiny, out, list(range(LENGTH)))
    dataset = open_dataset(str(out))
    check_dataset(dataset)
    assert "the sequence's own camera.toml" in dataset.camera_source
    assert (out / "groundtruth.txt").read_bytes() == (tiny / "groundtruth.txt").read_bytes()
    assert {path.name for path in out.iterdir()} == {
        "rgb",
        "depth",
        "rgb.txt",
        "depth.txt",
        "camera.toml",
        "groundtruth.txt",
    }


def test_it_ends_after_so_many_images_or_seconds(tiny: Path, tmp_path: Path) -> None:
    for k, (limits, expected) in enumerate(
        [({"n_frames": 3}, 3), ({"seconds": 0.09}, 3), ({"n_frames": 5, "seconds": 9.0}, 5), ({"seconds": 0.11}, 4)]
    ):
        with open_camera(f"camera:replay:{tiny}") as camera:
            assert record(camera, tmp_path / str(k), **limits).n_written == expected
        assert len(open_dataset(str(tmp_path / str(k)))) == expected


@pytest.mark.parametrize("limits", [{"n_frames": 0}, {"seconds": 0.0}, {"seconds": float("nan")}])
def test_impossible_limits_are_refused(tiny: Path, tmp_path: Path, limits: dict[str, float]) -> None:
    with open_camera(f"camera:replay:{tiny}") as camera, pytest.raises(ConfigError, match=r"^(frames|seconds) is "):
        record(camera, tmp_path / "out", **limits)  # type: ignore[arg-type]
    assert not (tmp_path / "out").exists()


def test_nothing_is_overwritten(tiny: Path) -> None:
    with open_camera(f"camera:replay:{tiny}") as camera, pytest.raises(ConfigError, match="is not empty"):
        record(camera, tiny)


def test_what_a_faulty_camera_sends_is_kept_in_order(
    tiny: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    out = tmp_path / "out"
    faults = "missing=1&doubled=2&swapped=3&unreadable=5&gone=6"
    with caplog.at_level(logging.WARNING), open_camera(f"camera:replay:{tiny}?{faults}") as camera:
        outcome = record(camera, out)
    assert (outcome.n_written, outcome.n_not_later, outcome.n_unreadable, outcome.is_gone) == (4, 2, 1, True)
    same_images(tiny, out, [0, 2, 4, 6])
    assert [record.getMessage() for record in caplog.records if record.name.endswith("recording")] == [
        "an image is left out: camera:replay: tiny: image 5 arrived damaged",
        "camera:replay: tiny: the camera is gone; the recording ends here [see troubleshooting: camera]",
    ]


def test_a_camera_that_delivers_nothing_is_an_error(tiny: Path, tmp_path: Path) -> None:
    with (
        open_camera(f"camera:replay:{tiny}?missing={','.join(map(str, range(LENGTH)))}") as camera,
        pytest.raises(StillroomError, match="delivered no image"),
    ):
        record(camera, tmp_path / "out")


class InTime(ReplayCamera):
    """A camera whose images do not wait."""

    comes_in_time = True


class Pressed(ReplayCamera):
    """Ctrl-C is pressed when an image is asked for, once or twice."""

    def __init__(self, folder: Path, times: int) -> None:
        super().__init__(open_dataset(str(folder)))
        self._times, self._n = times, 0

    def next(self) -> RgbdImage | None:
        self._n += 1
        if self._n == 4:
            for _ in range(self._times):
                signal.raise_signal(signal.SIGINT)
        return super().next()


@pytest.mark.parametrize("times", [1, 2])
def test_ctrl_c_leaves_whole_files(tiny: Path, tmp_path: Path, times: int) -> None:
    out = tmp_path / "out"
    before = signal.getsignal(signal.SIGINT)
    with Pressed(tiny, times) as camera:
        if times == 1:
            assert record(camera, out).n_written == 4
        else:
            with pytest.raises(KeyboardInterrupt):
                record(camera, out)
    same_images(tiny, out, list(range(5 - times)))
    assert signal.getsignal(signal.SIGINT) is before
    assert not any(thread.name == "recorder" for thread in threading.enumerate())


class Stuck:
    """An encoder of PNG that waits until it is told to go on."""

    def __init__(self) -> None:
        self.began, self.may_go_on = threading.Event(), threading.Event()
        self._encode = cv2.imencode
        self.compression: list[int] = []

    def __call__(self, suffix: str, pixels: U8, options: tuple[int, ...]) -> object:
        self.began.set()
        assert self.may_go_on.wait(60.0)
        self.compression.append(options[options.index(cv2.IMWRITE_PNG_COMPRESSION) + 1])
        return self._encode(suffix, pixels, options)


def test_images_that_come_faster_than_they_are_written_are_counted(
    tiny: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stuck, out = Stuck(), tmp_path / "out"
    out.mkdir()
    monkeypatch.setattr("stillroom.cameras.recorder.cv2.imencode", stuck)
    with InTime(open_dataset(str(tiny))) as camera, TumRecorder(out, camera, length=2) as recorder:
        images = [image for _ in range(LENGTH) if (image := camera.next()) is not None]
        kept = [recorder.keep(images[0])]
        assert stuck.began.wait(60.0)  # it holds the first one; two fit into the queue
        kept += [recorder.keep(image) for image in images[1:6]]
        stuck.may_go_on.set()
    assert kept == [True, True, True, False, False, False]
    assert (recorder.n_written, recorder.n_dropped) == (3, 3)
    same_images(tiny, out, [0, 1, 2])


def test_images_are_not_compressed_while_many_wait(tiny: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stuck, out = Stuck(), tmp_path / "out"
    out.mkdir()
    monkeypatch.setattr("stillroom.cameras.recorder.cv2.imencode", stuck)
    with open_camera(f"camera:replay:{tiny}") as camera, TumRecorder(out, camera, length=6) as recorder:
        images = [image for _ in range(LENGTH) if (image := camera.next()) is not None]
        assert recorder.keep(images[0])
        assert stuck.began.wait(60.0)  # it holds the first one, and six wait; the last entry of a queue is its end
        assert all(recorder.keep(image) for image in images[1:7])
        stuck.may_go_on.set()
    assert stuck.compression[:2] == [1, 1]
    assert stuck.compression[2:6] == [0, 0, 0, 0]
    assert stuck.compression[-2:] == [1, 1]
    same_images(tiny, out, list(range(7)))


def test_a_full_disk_ends_it_in_one_line_and_what_is_listed_is_whole(
    tiny: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, write_bytes, n_files = tmp_path / "out", Path.write_bytes, [0]

    def full(path: Path, content: bytes) -> int:
        n_files[0] += 1
        if n_files[0] == 6:  # the depth of the third image
            write_bytes(path, content[:10])
            raise OSError(28, "No space left on device", str(path))
        return write_bytes(path, content)

    monkeypatch.setattr(Path, "write_bytes", full)
    with (
        open_camera(f"camera:replay:{tiny}") as camera,
        pytest.raises(StillroomError, match=r"depth/.*cannot be written \(No space left .*disk-full\]$"),
    ):
        record(camera, out)
    same_images(tiny, out, [0, 1])


def test_a_folder_that_cannot_be_written_is_one_line(tiny: Path, tmp_path: Path) -> None:
    (tmp_path / "out" / "rgb").mkdir(parents=True)
    with (
        open_camera(f"camera:replay:{tiny}") as camera,
        pytest.raises(StillroomError, match=r"out.*: cannot be written"),
        TumRecorder(tmp_path / "out", camera),
    ):
        pass


@pytest.mark.parametrize("start_s", [0.0, 3.25, 86400.0, 1.7e9])
def test_times_of_any_clock_are_read_back_as_they_were(tiny: Path, tmp_path: Path, start_s: float) -> None:
    """A device may count from when it was plugged in; and two images may lie within a microsecond."""
    out, image = tmp_path / "out", open_dataset(str(tiny)).load(0)
    out.mkdir()
    times_s = [start_s + k / 30 for k in range(5)]
    times_s.append(float(np.nextafter(times_s[-1], np.inf)))
    with open_camera(f"camera:replay:{tiny}") as camera, TumRecorder(out, camera) as recorder:
        for time_s in times_s:
            recorder.keep(replace(image, timestamp_s=time_s))
    assert recorder.n_written == 6
    assert open_dataset(str(out)).timestamps_s.tolist() == times_s


def test_depth_is_rounded_and_what_does_not_fit_is_unknown() -> None:
    depth_m = np.array([[0.0, 1.2344, 65.534, 65.535, 90.0]], dtype=np.float32)
    image = RgbdImage(0.0, np.zeros((1, 5, 3), dtype=np.uint8), depth_m)
    assert depth_in_units(image, 1000.0).tolist() == [[0, 1234, 65534, 0, 0]]


def test_every_depth_of_16_bits_survives() -> None:
    units = np.arange(65535, dtype=np.uint16).reshape(1, -1)
    for factor in (1000.0, 5000.0, 999.95, 10000.0):
        depth_m = np.divide(units, np.float32(factor), dtype=np.float32)
        image = RgbdImage(0.0, np.zeros((1, 65535, 3), dtype=np.uint8), depth_m)
        assert np.array_equal(depth_in_units(image, factor), units)


def test_ground_truth_of_another_body_is_moved_to_the_camera(tiny: Path, tmp_path: Path) -> None:
    bonn = tmp_path / "rgbd_bonn_tiny"
    tiny.rename(bonn)
    for name in ("out", "rgbd_bonn_again"):
        with open_camera(f"camera:replay:{bonn}") as camera:
            record(camera, tmp_path / name)
    given = open_dataset(str(bonn)).groundtruth
    assert given is not None
    moved, again = open_dataset(str(tmp_path / "out")), open_dataset(str(tmp_path / "rgbd_bonn_again"))
    assert moved.groundtruth is not None
    assert again.groundtruth_at_camera is not None
    for found in (moved.groundtruth, again.groundtruth_at_camera):
        assert np.allclose(found.T_world_cam, marker_to_camera(given).T_world_cam, atol=1e-6)


def test_late_images_are_kept_too(tiny: Path, tmp_path: Path) -> None:
    waits_s: list[float] = []
    camera = ReplayCamera(open_dataset(str(tiny)), Faults(late={3: 2.0}), waits_s.append)
    with camera:
        assert record(camera, tmp_path / "out").n_written == LENGTH
    assert waits_s == [2.0]
