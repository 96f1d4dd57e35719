"""Ranges of frames: which images are left, what they are called, and every slip in one line."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stillroom.data.semantics import Box, Semantics
from stillroom.datasets.image_sequence import ImageSequence
from stillroom.datasets.open import open_dataset
from stillroom.datasets.recording import DatasetView
from stillroom.datasets.selection import parse_range, select
from stillroom.errors import ConfigError, FrameError
from stillroom.protocols import Dataset
from stillroom.testing.tiny_sequence import write_tiny_sequence


@pytest.fixture
def twenty(tmp_path: Path) -> Dataset:
    """Twenty tiny frames; frame k has the depth 1.5 m + k · 0.1 m in its corner."""
    write_tiny_sequence(tmp_path / "twenty", frames=20)
    return open_dataset(str(tmp_path / "twenty"))


def numbers(dataset: Dataset) -> list[int]:
    images = [dataset.load(i) for i in range(len(dataset))]
    for image in images:
        if image.depth_m.any():
            assert image.depth_m[0, 0] == pytest.approx(1.5 + 0.1 * image.index)
    return [image.index for image in images]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("5:9", [5, 6, 7, 8]),
        (":3", [0, 1, 2]),
        ("17:", [17, 18, 19]),
        ("-2:", [18, 19]),
        ("15:100", [15, 16, 17, 18, 19]),
        ("0:20:8", [0, 8, 16]),
    ],
)
def test_frames_are_python_slices(text: str, expected: list[int], twenty: Dataset) -> None:
    chosen = select(twenty, frames=text)
    assert numbers(chosen) == expected
    assert len(chosen) == len(expected)
    assert np.array_equal(chosen.timestamps_s, twenty.timestamps_s[expected])
    assert chosen.camera is twenty.camera
    assert chosen.camera_source == twenty.camera_source
    assert chosen.name == twenty.name
    assert chosen.groundtruth is twenty.groundtruth


def test_dropped_frames_do_not_exist(twenty: Dataset) -> None:
    chosen = select(twenty, frames="4:16", drop=["6:9", "12:14"])
    assert numbers(chosen) == [4, 5, 9, 10, 11, 14, 15]
    assert chosen.numbers.tolist() == numbers(chosen)


def test_blacked_out_frames_are_there_and_black(twenty: Dataset) -> None:
    chosen = select(twenty, frames="4:10", blackout=["6:8"])
    assert numbers(chosen) == [4, 5, 6, 7, 8, 9]
    dark = [not image.rgb.any() and not image.depth_m.any() for image in map(chosen.load, range(6))]
    assert dark == [False, False, True, True, False, False]
    assert not chosen.load(2).gray.any()
    assert chosen.load(2).timestamp_s == twenty.timestamps_s[6]


def test_selections_stack_in_original_numbers(twenty: Dataset) -> None:
    first = select(twenty, frames="5:15", blackout=["7:8"])
    second = select(first, drop=["9:11"], blackout=["12:13"])
    third = select(second, frames="6:-5")  # -5 counts from the original's end
    assert numbers(third) == [6, 7, 8, 11, 12, 13, 14]
    assert [bool(third.load(i).rgb.any()) for i in range(7)] == [True, False, True, True, False, True, True]


def test_without_options_is_the_sequence_itself(twenty: Dataset) -> None:
    assert select(twenty) is twenty


def test_what_a_renderer_knows_is_nothing_in_the_dark(twenty: ImageSequence) -> None:
    class Rendered(DatasetView):
        def load(self, index: int):
            box = Box(1, 1, 9, 9, "person", 1.0)
            return replace(twenty.load(index), truth=Semantics(48, 64, (box,)))

    chosen = select(Rendered(twenty), blackout=["3:4"])
    assert chosen.load(2).truth.has_any
    dark = chosen.load(3).truth
    assert not dark.has_any
    assert (dark.height, dark.width) == (48, 64)


def test_a_bad_frame_stays_one(twenty: ImageSequence) -> None:
    twenty.rgb_files[7].write_bytes(b"")
    with pytest.raises(FrameError):
        select(twenty, frames="5:10").load(2)


@pytest.mark.parametrize("text", ["", "5", "a:b", "1:2:3:4", "1-5", "1.5:3", "5..9"])
def test_a_malformed_range_is_said(text: str) -> None:
    with pytest.raises(ConfigError, match="is no range of frames; write it like 200:560"):
        parse_range(text)


@pytest.mark.parametrize("text", ["1:9:0", "9:1:-1"])
def test_a_step_back_is_said(text: str) -> None:
    with pytest.raises(ConfigError, match="must be positive"):
        parse_range(text)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"frames": "30:40"}, "frames 30:40: no such image; images left to choose from: 0 to 19"),
        ({"frames": "9:5"}, "frames 9:5: no such image"),
        ({"frames": "4:12", "drop": ["14:18"]}, "drop 14:18: no such image; images left to choose from: 4 to 11"),
        ({"drop": ["3:6"], "blackout": ["4:5"]}, "blackout 4:5: no such image"),
        ({"drop": [":"]}, "leaves no image of 'twenty'"),
        ({"blackout": ["x"]}, "blackout: 'x' is no range"),
    ],
)
def test_a_range_that_touches_nothing_is_said(options: dict, said: str, twenty: Dataset) -> None:
    with pytest.raises(ConfigError) as caught:
        select(twenty, **options)
    assert said in str(caught.value)


@pytest.mark.parametrize("index", [-1, 5])
def test_outside_is_an_index_error(index: int, twenty: Dataset) -> None:
    with pytest.raises(IndexError):
        select(twenty, frames="5:10").load(index)


def test_played_backwards_the_last_image_comes_first_and_time_goes_on(twenty: Dataset) -> None:
    backwards = select(twenty, frames="4:16", drop=["6:9"], reverse=True)
    originals = [15, 14, 13, 12, 11, 10, 9, 5, 4]
    assert len(backwards) == len(originals)
    for place, number in enumerate(originals):
        image, forwards = backwards.load(place), twenty.load(number)
        assert np.array_equal(image.rgb, forwards.rgb)
        assert np.array_equal(image.depth_m, forwards.depth_m)
        assert image.index == 19 - number == backwards.numbers[place]
        assert image.timestamp_s == backwards.timestamps_s[place]
    steps_s = np.diff(backwards.timestamps_s)
    np.testing.assert_allclose(steps_s, -np.diff(twenty.timestamps_s[originals]), atol=1e-6, rtol=0)
    ends_s = twenty.timestamps_s[[4, 15]]
    np.testing.assert_allclose(backwards.timestamps_s[[0, -1]], ends_s, rtol=0, atol=1e-6)


def test_played_backwards_each_image_keeps_its_true_pose(twenty: Dataset) -> None:
    def true_poses(dataset: Dataset, places: list[int]) -> np.ndarray:
        truth = dataset.groundtruth
        assert truth is not None
        assert np.all(np.diff(truth.timestamps_s) > 0)
        nearest = [int(np.argmin(np.abs(truth.timestamps_s - dataset.timestamps_s[place]))) for place in places]
        return truth.T_world_cam[nearest]

    backwards = select(twenty, frames="3:", reverse=True)
    assert np.array_equal(true_poses(backwards, list(range(17))), true_poses(twenty, list(range(19, 2, -1))))


def test_played_backwards_depth_that_came_after_its_colour_comes_before_it(twenty: Dataset) -> None:
    assert isinstance(twenty, ImageSequence)
    after_s = np.linspace(-0.01, 0.02, 20)
    late = replace(twenty, depth_after_s=after_s)
    backwards = select(late, reverse=True)
    assert [backwards.load(i).depth_after_s for i in range(20)] == list(-after_s[::-1])


def test_played_backwards_a_camera_has_no_readout_and_says_so(twenty: Dataset) -> None:
    assert isinstance(twenty, ImageSequence)
    rolling = replace(twenty, camera=replace(twenty.camera, readout_s=0.03))
    backwards = select(rolling, reverse=True)
    assert (rolling.camera.readout_s, backwards.camera.readout_s) == (0.03, 0.0)
    assert backwards.camera_source == f"{rolling.camera_source}; played backwards, its rows are read as one"
    assert select(twenty, reverse=True).camera_source == twenty.camera_source


def test_twice_backwards_is_forwards(twenty: Dataset) -> None:
    again = select(select(twenty, reverse=True), reverse=True)
    assert [again.load(i).index for i in range(20)] == list(range(20))
    assert not again.is_reversed
    np.testing.assert_allclose(again.timestamps_s, twenty.timestamps_s, atol=1e-6, rtol=0)


def test_ranges_of_what_is_played_backwards_count_from_the_end(twenty: Dataset) -> None:
    chosen = select(select(twenty, reverse=True), frames=":3")
    assert chosen.is_reversed
    deepest = [float(chosen.load(i).depth_m[0, 0]) for i in range(3)]
    assert deepest == pytest.approx([1.5 + 0.1 * number for number in (19, 18, 17)])


@pytest.mark.parametrize("index", [-1, 20])
def test_outside_of_what_is_played_backwards_is_an_index_error(index: int, twenty: Dataset) -> None:
    with pytest.raises(IndexError):
        select(twenty, reverse=True).load(index)
