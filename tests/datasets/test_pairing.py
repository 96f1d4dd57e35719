"""Which images belong together is told by times and names; what is left out is counted; nothing is guessed."""

import logging
from pathlib import Path

import numpy as np
import pytest
from tests.fabricated.recorders import keep, restamp, without_lists

from stillroom.datasets.folder import open_folder
from stillroom.datasets.open import open_dataset
from stillroom.datasets.pairing import Pairing
from stillroom.datasets.recording import unpaired_s
from stillroom.datasets.selection import select
from stillroom.datasets.tum import open_tum
from stillroom.errors import ConfigError, DatasetError

LOST = {"rgb": {1, 4}, "depth": {2, 3}}


def depths(sequence) -> list[float]:
    return [float(sequence.load(i).depth_m[0, 0]) for i in range(len(sequence))]


def lose(folder: Path, name_of=lambda stream, k: f"{k:06d}") -> Path:
    """Take other images out of either stream: four of each are left, and two moments have both."""
    without_lists(folder, name_of)
    for stream, places in LOST.items():
        for k in places:
            (folder / stream / f"{name_of(stream, k)}.png").unlink()
    return folder


@pytest.mark.parametrize("pattern", ["{k:06d}", "{stream}_{k}", "{stream}-{k:04d}-left"])
def test_streams_that_lost_other_images_pair_by_number(
    pattern: str, tiny: Path, caplog: pytest.LogCaptureFixture
) -> None:
    sequence = open_folder(lose(tiny, lambda stream, k: pattern.format(stream=stream, k=k)), fps=10.0)
    assert depths(sequence) == pytest.approx([1.5, 2.0])
    assert sequence.timestamps_s == pytest.approx([0.0, 0.5])  # time went on while images were lost
    assert sequence.unpaired_s == pytest.approx([0.2, 0.3])
    assert "2 of 4 colour images have no depth image" in caplog.text


def test_the_order_tells_only_where_it_is_asked(tiny: Path) -> None:
    sequence = open_folder(lose(tiny), fps=10.0, pairing=Pairing(by="order"))
    assert depths(sequence) == pytest.approx([1.5, 1.6, 1.9, 2.0])


def test_names_that_tell_nothing_are_refused(tiny: Path) -> None:
    without_lists(tiny, lambda stream, k: f"{'abcdef'[k]}" if stream == "rgb" else f"d{k}")
    with pytest.raises(DatasetError) as caught:
        open_folder(tiny, fps=30.0)
    for words in ("(a.png, d0.png)", "--pair-by order", "[see troubleshooting: pairing]"):
        assert words in str(caught.value)
    assert len(open_folder(tiny, fps=30.0, pairing=Pairing(by="order"))) == 6
    (tiny / "depth" / "d3.png").unlink()
    with pytest.raises(
        DatasetError, match=r"6 colour and 5 depth images; the order .*\[see troubleshooting: pairing\]"
    ):
        open_folder(tiny, fps=30.0, pairing=Pairing(by="order"))


def test_colour_at_twice_the_rate_of_depth_is_counted(tiny: Path, caplog: pytest.LogCaptureFixture) -> None:
    keep(tiny, "depth.txt", range(0, 6, 2))
    sequence = open_tum(tiny)
    assert len(sequence) == 3
    said = [record.getMessage() for record in caplog.records if record.levelno >= logging.WARNING]
    assert len(said) == 1
    assert said[0].startswith("tiny: 3 of 6 colour images have no depth image")
    assert said[0].endswith("[see troubleshooting: unpaired-images]")


def test_a_part_counts_what_was_left_out_of_that_part(tiny: Path) -> None:
    keep(tiny, "depth.txt", range(0, 6, 2))
    sequence = open_tum(tiny)  # images 0 2 4 of six; 1 3 5 are left out
    left_out_s = sequence.timestamps_s + 1 / 30
    assert unpaired_s(sequence) == pytest.approx(left_out_s, abs=1e-5)
    assert unpaired_s(select(sequence, "0:2")) == pytest.approx(left_out_s[:1], abs=1e-5)
    assert unpaired_s(select(sequence, "1:")) == pytest.approx(left_out_s[1:], abs=1e-5)
    assert len(unpaired_s(select(sequence, drop=["1:2"]))) == 1  # the one after the last
    backwards = select(sequence, "0:2", reverse=True)
    assert backwards.timestamps_s[0] < unpaired_s(backwards)[0] < backwards.timestamps_s[1]
    assert len(unpaired_s(open_dataset("synthetic:walking,frames=2,cache=off"))) == 0


def test_depth_that_is_stamped_late_is_measured_and_can_be_shifted(tiny: Path) -> None:
    restamp(tiny, lambda k, time: f"{float(time) + 0.026 + k / 6:.6f}", ["depth.txt"])  # 5 Hz, 30 ms late
    restamp(tiny, lambda k, time: f"{float(time) + k / 6:.6f}", ["rgb.txt"])
    with pytest.raises(DatasetError) as caught:
        open_tum(tiny)
    for words in (
        "within 0.02 s",
        "stamped 0.03 s later (median)",
        "--depth-offset -0.03",
        "--max-gap",
        "[see troubleshooting: depth-offset]",
    ):
        assert words in str(caught.value)
    for pairing in (Pairing(depth_offset_s=-0.03), Pairing(max_gap_s=0.05)):
        assert depths(open_tum(tiny, pairing=pairing)) == pytest.approx([1.5, 1.6, 1.7, 1.8, 1.9, 2.0])


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"by": "size"}, "pair-by is 'size'"),
        ({"max_gap_s": 0.0}, "max-gap is 0.0"),
        ({"max_gap_s": np.nan}, "max-gap is nan"),
        ({"depth_offset_s": np.inf}, "depth-offset is inf"),
    ],
)
def test_what_cannot_be_asked_is_said(values: dict, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        Pairing(**values)


def test_a_sequence_that_needs_no_pairing_refuses_to_be_told_how() -> None:
    with pytest.raises(ConfigError, match=r"kind 'synthetic' know by themselves .* leave time-unit"):
        open_dataset("synthetic:walking,frames=2,cache=off", pairing=Pairing(max_gap_s=0.1))
