"""What benches know of a rendered scene: found under what shows a part of it, and the same room without people."""

from pathlib import Path

import numpy as np
import pytest

from stillroom.datasets.open import open_dataset
from stillroom.datasets.recording import rendered
from stillroom.datasets.selection import select
from stillroom.testing.tiny_sequence import write_tiny_sequence


def test_it_is_found_under_a_selection_that_is_played_backwards() -> None:
    whole = open_dataset("synthetic:walking,frames=9,cache=off")
    shown = select(whole, "2:8", drop=("4:5",), reverse=True)
    assert rendered(whole) is whole
    assert shown is not whole
    assert rendered(shown) is whole


def test_nobody_knows_the_scene_of_a_recording(tmp_path: Path) -> None:
    write_tiny_sequence(tmp_path)
    recording = open_dataset(str(tmp_path))
    assert rendered(recording) is None
    assert rendered(select(recording, "1:4")) is None


def test_without_people_the_camera_sees_the_same_room_at_the_same_times() -> None:
    room = rendered(open_dataset("synthetic:walking,frames=30,noise=off,cache=off"))
    assert room is not None
    empty = rendered(room.without_people())
    assert empty is not None
    assert (empty.timestamps_s == room.timestamps_s).all()
    truth, without = room.truth(12), empty.truth(12)
    assert (truth.T_world_cam == without.T_world_cam).all()
    assert truth.instance.any()
    assert not without.instance.any()
    still = truth.instance == 0
    np.testing.assert_array_equal(truth.depth_m[still], without.depth_m[still])


@pytest.mark.parametrize("figures", ["carried", "pushed", "empty"])
def test_no_room_is_without_people_where_it_would_be_another_or_the_same(figures: str) -> None:
    room = rendered(open_dataset(f"synthetic:{figures},frames=3,cache=off"))
    assert room is not None
    assert room.without_people() is None


def test_handled_things_are_told_from_figures_and_the_room() -> None:
    room = rendered(open_dataset("synthetic:carried,frames=3,cache=off"))
    assert room is not None
    shown = np.array([[0, 1, 100], [101, 102, 255]], dtype=np.uint8)
    assert room.handled(shown).tolist() == [[False, False, False], [True, True, True]]
