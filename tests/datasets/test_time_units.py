"""Times that are not seconds are told from digits and steps and converted, or refused with what to do."""

import logging
from pathlib import Path

import numpy as np
import pytest
from tests.fabricated.recorders import (
    counter,
    microseconds,
    milliseconds,
    nanoseconds,
    restamp,
    without_lists,
    write_stretch,
)

from stillroom.data.trajectory import Trajectory, read_tum
from stillroom.datasets.folder import open_folder
from stillroom.datasets.open import open_dataset
from stillroom.datasets.pairing import Pairing
from stillroom.datasets.time_units import COUNTER, in_seconds, unit_of
from stillroom.datasets.tum import open_tum
from stillroom.errors import ConfigError, DatasetError

ROW = "[see troubleshooting: time-unit]"
STRETCH = (200, 240)


def warnings(caplog: pytest.LogCaptureFixture) -> list[str]:
    return [record.getMessage() for record in caplog.records if record.levelno >= logging.WARNING]


@pytest.mark.parametrize(
    ("stamp", "unit", "within_s"),
    [(nanoseconds, "nanoseconds", 0.0), (microseconds, "microseconds", 0.0), (milliseconds, "milliseconds", 5.1e-4)],
)
def test_real_frames_stamped_in_another_unit_are_the_same_sequence(
    stamp, unit: str, within_s: float, bonn: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    right = open_dataset(str(write_stretch(bonn, tmp_path / "s" / "rgbd_bonn_x", *STRETCH)))
    assert not warnings(caplog)
    other = open_dataset(str(write_stretch(bonn, tmp_path / "o" / "rgbd_bonn_x", *STRETCH, stamp)))
    said = warnings(caplog)
    assert len(said) == 1
    assert f"are read as {unit}, converted to seconds" in said[0]
    assert said[0].endswith(ROW)
    assert len(right) == STRETCH[1] - STRETCH[0]
    assert np.abs(other.timestamps_s - right.timestamps_s).max() <= within_s  # whole milliseconds are all that is there
    assert (other.rgb_files, other.depth_files) == (right.rgb_files, right.depth_files)
    assert np.array_equal(other.groundtruth.timestamps_s, right.groundtruth.timestamps_s)


def test_real_frames_that_are_counted_are_refused_and_a_rate_times_them(bonn: Path, tmp_path: Path) -> None:
    folder = write_stretch(bonn, tmp_path / "rgbd_bonn_x", *STRETCH, counter)
    with pytest.raises(DatasetError) as caught:
        open_dataset(str(folder))
    for words in ("rgb.txt: 0, 1, 2 … may count images", "--fps", "--time-unit", ROW):
        assert words in str(caught.value)
    sequence = open_dataset(str(folder), fps=30.0)
    assert np.abs(sequence.timestamps_s - np.arange(40) / 30.0).max() < 1e-12
    assert [path.name for path in sequence.rgb_files] == [
        path.name for path in open_dataset(str(bonn)).rgb_files[slice(*STRETCH)]
    ]
    assert open_dataset(str(folder), pairing=Pairing(time_unit="s")).timestamps_s.tolist() == list(range(40))


def test_counted_images_that_were_lost_leave_gaps(tiny: Path) -> None:
    restamp(tiny, lambda k, time: str(k + (k > 2)), ["rgb.txt"])  # 0 1 2 4 5 6
    restamp(tiny, lambda k, time: str(k + (k > 3)), ["depth.txt"])  # 0 1 2 3 5 6
    sequence = open_tum(tiny, fps=10.0)
    assert sequence.timestamps_s == pytest.approx([0.0, 0.1, 0.2, 0.5, 0.6])
    assert [sequence.load(i).depth_m[0, 0] for i in range(5)] == pytest.approx([1.5, 1.6, 1.7, 1.9, 2.0])
    assert sequence.unpaired_s == pytest.approx([0.4])


def test_counters_without_a_number_in_common_are_refused(tiny: Path) -> None:
    restamp(tiny, lambda k, time: str(k + 100), ["depth.txt"])
    restamp(tiny, counter, ["rgb.txt"])
    with pytest.raises(DatasetError, match=r"--pair-by order .*\[see troubleshooting: pairing\]"):
        open_tum(tiny, fps=10.0)
    assert len(open_tum(tiny, fps=10.0, pairing=Pairing(by="order"))) == 6


def test_a_rate_overrides_the_times_of_lists(tiny: Path) -> None:
    before = open_tum(tiny)
    sequence = open_tum(tiny, fps=10.0)
    assert sequence.timestamps_s == pytest.approx(before.timestamps_s[0] + np.arange(6) / 10)
    assert sequence.depth_files == before.depth_files


def test_the_unit_asked_for_wins(tiny: Path, caplog: pytest.LogCaptureFixture) -> None:
    restamp(tiny, lambda k, time: str(k * 10_000))  # 10 s in ms, or 10 ms in us, which the steps tell
    assert open_tum(tiny).timestamps_s == pytest.approx(0.01 * np.arange(6))
    assert len(warnings(caplog)) == 1
    caplog.clear()
    assert open_tum(tiny, pairing=Pairing(time_unit="ns")).timestamps_s == pytest.approx(1e-5 * np.arange(6))
    assert not warnings(caplog)  # he who says so need not be told


def test_lists_may_differ_in_unit(tiny: Path) -> None:
    right = open_tum(tiny)
    restamp(tiny, nanoseconds, ["depth.txt"])
    assert np.array_equal(open_tum(tiny).timestamps_s, right.timestamps_s)
    assert open_tum(tiny).depth_files == right.depth_files


def test_ground_truth_in_another_unit_is_converted(tiny: Path, caplog: pytest.LogCaptureFixture) -> None:
    truth = read_tum(tiny / "groundtruth.txt")
    Trajectory(truth.timestamps_s * 1e9, truth.T_world_cam).write_tum(tiny / "groundtruth.txt")
    sequence = open_tum(tiny)
    assert sequence.groundtruth.timestamps_s == pytest.approx(truth.timestamps_s, abs=1e-6)
    assert len(warnings(caplog)) == 1
    assert warnings(caplog)[0].endswith(f"groundtruth.txt: read as nanoseconds, converted to seconds {ROW}")


def test_steps_of_no_camera_are_refused(tiny: Path) -> None:
    restamp(tiny, lambda k, time: f"{float(time) / 3600:.9f}")  # hours
    with pytest.raises(DatasetError, match=r"in no unit; give --time-unit .*\[see troubleshooting: time-unit\]"):
        open_tum(tiny)


@pytest.mark.parametrize(
    ("first", "step", "unit"),
    [
        (1.3e9, 1 / 30, "s"),
        (0.0, 1 / 30, "s"),
        (1.3e9, 2.0, "s"),  # one image in two seconds
        (1.3e9, 60.0, "s"),
        (0.0, 1 / 500, "s"),
        (1.3e12, 33.0, "ms"),
        (0.0, 33.0, "ms"),
        (17.25, 33.37, "ms"),
        (1.3e15, 33_333.0, "us"),
        (12_000.0, 33_333.0, "us"),
        (1.3e18, 33_333_333.0, "ns"),
        (4e9, 33_333_333.0, "ns"),  # of a clock that starts with the machine; as seconds, steps of a year
        (0.0, 1.0, COUNTER),
        (1000.0, 1.0, COUNTER),
        (0.0, 5.0, COUNTER),
        (0.0, 10.0, COUNTER),  # every tenth image, or 10 ms: who knows
        (1.3e9, 1e-5, None),
        (1.3e20, 33.0, None),
    ],
)
def test_the_unit_is_told_from_digits_and_steps(first: float, step: float, unit: str | None) -> None:
    assert unit_of(first + step * np.arange(40)) == unit


def test_a_lost_image_makes_no_other_unit() -> None:
    assert unit_of(np.delete(np.arange(40.0), [3, 4, 5, 20])) == COUNTER
    assert unit_of(np.delete(np.arange(40) / 30, [3, 4, 5, 20])) == "s"


def test_one_image_has_digits_only() -> None:
    assert [unit_of(np.array([time])) for time in (1.3e9, 1.3e12, 1.3e18, 5.0, 1e25)] == ["s", "ms", "ns", "s", None]


@pytest.mark.parametrize("word", ["1548339819874261234", "1e3", "nan", "1e400"])
def test_conversion_rounds_once(word: str) -> None:
    expected = {"1548339819874261234": 1548339819.874261234, "1e3": 1e-6, "nan": np.nan, "1e400": np.inf}[word]
    assert in_seconds(word, "ns") == expected or np.isnan(expected)


def test_a_unit_that_is_none_is_said() -> None:
    with pytest.raises(ConfigError, match="time-unit is 'min'; it must be one of s, ms, us, ns"):
        Pairing(time_unit="min")


@pytest.mark.parametrize(("digits", "power"), [(13, 3), (16, 6), (19, 9)])
def test_names_of_whole_times_are_told_by_their_digits(digits: int, power: int, tiny: Path) -> None:
    without_lists(tiny, lambda stream, k: f"{1403636579 * 10**power + 50 * k * 10 ** (power - 3):0{digits}d}")
    assert open_folder(tiny).timestamps_s == pytest.approx(1403636579 + 0.05 * np.arange(6), abs=1e-6)


def test_shorter_names_may_count_and_need_a_rate_or_a_unit(tiny: Path) -> None:
    without_lists(tiny, lambda stream, k: f"{33 * k:06d}")
    with pytest.raises(DatasetError, match=r"tells no time .*--fps.*\[see troubleshooting: time-unit\]"):
        open_folder(tiny)
    sequence = open_folder(tiny, pairing=Pairing(time_unit="ms"))
    assert sequence.timestamps_s == pytest.approx(0.033 * np.arange(6))
