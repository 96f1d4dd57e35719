"""The data set: any frame from seed and number alone, exact boxes, a cache that can be trusted, little memory."""

import os
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from counted_lines import n_lines

from stillroom.data.image import RgbdImage
from stillroom.data.locations import cache_folder
from stillroom.data.semantics import union_of
from stillroom.testing.dataset_contract import KnownPixel, check_dataset
from stillroom_scenes import room as room_module
from stillroom_scenes.cache import FrameCache, StoredFrame
from stillroom_scenes.config import open_synthetic
from stillroom_scenes.worlds.single import scene_of


def same(one: RgbdImage, other: RgbdImage) -> bool:
    assert one.truth is not None
    assert other.truth is not None
    return (
        np.array_equal(one.rgb, other.rgb)
        and np.array_equal(one.depth_m, other.depth_m)
        and np.array_equal(one.truth.movable, other.truth.movable)
        and one.truth.boxes == other.truth.boxes
        and (one.index, one.timestamp_s) == (other.index, other.timestamp_s)
    )


@pytest.mark.parametrize("spec", ["synthetic:walking,frames=40", "synthetic:pushed,frames=300,noise=off,room=workshop"])
def test_keeps_the_contract_of_data_sets(spec: str) -> None:
    room = open_synthetic(spec)
    truth = room.truth(3)
    row, column = 20, 320  # the wall above everyone's head
    exact_m = float(truth.depth_m[row, column])
    image = open_synthetic(spec.replace("noise=off", "") + ",noise=off,cache=off").load(3)
    assert image.depth_m[row, column] == pytest.approx(exact_m, abs=1.01e-4)
    rgb = image.rgb[row, column].tolist()
    check_dataset(room, KnownPixel(3, row, column, (rgb[0], rgb[1], rgb[2]), None, colour_tolerance=12))


def test_frames_depend_on_seed_and_number_alone() -> None:
    spec = "synthetic:walking,frames=200,cache=off"
    one = open_synthetic(spec)
    forwards = [one.load(k) for k in (0, 5, 150)]
    scene_of.cache_clear()
    other = open_synthetic(spec)
    assert all(same(other.load(k), image) for k, image in zip((150, 5, 0), forwards[::-1], strict=True))
    np.testing.assert_array_equal(one.groundtruth.T_world_cam, other.groundtruth.T_world_cam)
    reseeded = open_synthetic(spec + ",seed=1")
    assert not np.array_equal(reseeded.load(0).rgb, forwards[0].rgb)
    assert not np.allclose(reseeded.pose(50), one.pose(50))


def test_neighbouring_frames_have_different_noise() -> None:
    room = open_synthetic("synthetic:empty,path=still,frames=3,cache=off")
    first, second = room.load(0), room.load(1)
    assert (first.rgb != second.rgb).mean() > 0.5
    assert (first.depth_m != second.depth_m).mean() > 0.3
    np.testing.assert_array_equal(room.truth(0).depth_m, room.truth(1).depth_m)


def test_kept_frames_are_the_rendered_ones() -> None:
    fresh = open_synthetic("synthetic:carried,frames=90,cache=off").load(80)
    assert not (cache_folder() / "synthetic").exists()
    kept = open_synthetic("synthetic:carried,frames=90")
    assert same(kept.load(80), fresh)
    files = list((cache_folder() / "synthetic").glob("*/*"))
    assert [file.name for file in files] == ["000080.frame"]
    assert same(kept.load(80), fresh)
    assert same(open_synthetic("synthetic:carried,frames=90").load(80), fresh)


def test_a_kept_frame_is_not_rendered_again(monkeypatch: pytest.MonkeyPatch) -> None:
    room = open_synthetic("synthetic:walking,frames=30")
    before = room.load(7)

    def refuse(*_: object) -> None:
        raise AssertionError("rendered again")

    monkeypatch.setattr(room_module, "render", refuse)
    again = room.load(7)
    assert same(again, before)
    again.rgb[:] = 0
    again.depth_m[:] = 0
    assert same(room.load(7), before)
    with pytest.raises(AssertionError, match="rendered again"):
        room.load(8)


@pytest.mark.parametrize("damage", ["short", "empty", "flipped", "longer", "header", "folder"])
def test_a_damaged_file_is_rendered_again_and_mended(damage: str) -> None:
    room = open_synthetic("synthetic:walking,frames=30")
    before = room.load(2)
    file = next((cache_folder() / "synthetic").glob("*/000002.frame"))
    content = file.read_bytes()
    middle = len(content) // 2
    spoilt = {
        "short": content[:middle],
        "empty": b"",
        "flipped": content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :],
        "longer": content + b"x",
        "header": b"\0" * 16 + content[16:],
        "folder": b"",
    }[damage]
    file.unlink()
    if damage == "folder":
        file.mkdir()
    else:
        file.write_bytes(spoilt)
    assert same(room.load(2), before)
    if damage != "folder":
        assert file.read_bytes() == content
    assert not list(file.parent.glob("*.part"))


def test_a_cache_that_cannot_be_written_costs_nothing_but_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blocked = tmp_path / "blocked"
    blocked.write_text("a file where the folder should be")
    monkeypatch.setenv("XDG_CACHE_HOME", str(blocked))
    room = open_synthetic("synthetic:walking,frames=5")
    assert same(room.load(1), open_synthetic("synthetic:walking,frames=5,cache=off").load(1))


def test_another_spec_has_another_place_in_the_cache() -> None:
    for choice in ("frames=5", "frames=6", "frames=5,seed=1", "frames=5,noise=off", "frames=5,fps=10"):
        open_synthetic(f"synthetic:empty,{choice}").load(0)
    assert len(list((cache_folder() / "synthetic").iterdir())) == 5


def tiny_frame(value: int) -> StoredFrame:
    shape = (10, 10)
    return StoredFrame(
        np.full((*shape, 3), value, np.uint8), np.full(shape, value, np.uint16), np.full(shape, value, np.uint8)
    )


def test_the_cache_keeps_to_its_budget() -> None:
    budget = 20 * 616
    for key in ("oldest", "older", "newest"):
        cache = FrameCache(key, budget)
        for index in range(30):
            cache.keep(index, tiny_frame(index))
        place = cache_folder() / "synthetic" / key
        assert len(list(place.iterdir())) == 10, "half the budget is one sequence's share"
        stamp = {"oldest": 1000, "older": 2000, "newest": 3000}[key]
        os.utime(place, (stamp, stamp))
    FrameCache("next", budget)
    assert sorted(place.name for place in (cache_folder() / "synthetic").iterdir()) == ["newest"]
    assert FrameCache("newest", budget).read(3) is not None
    assert FrameCache("newest", budget).read(25) is None


def test_boxes_are_tight_round_what_shows() -> None:
    room = open_synthetic("synthetic:carried,frames=420,cache=off")
    labels = set()
    for index in (0, 60, 150, 200, 300, 400):
        image, truth = room.load(index), room.truth(index)
        assert image.truth is not None
        np.testing.assert_array_equal(image.truth.movable, truth.moving)
        for instance in image.truth.instances:
            np.testing.assert_array_equal(instance.mask, truth.instance == instance.track_id)
        told_apart = union_of(image.truth.instances, *truth.moving.shape)
        np.testing.assert_array_equal(told_apart, truth.moving)
        covered = np.zeros_like(truth.moving)
        for box in image.truth.boxes:
            labels.add(box.label)
            row, column = np.nonzero(truth.instance == box.track_id)
            assert box.xyxy_px == (column.min(), row.min(), column.max(), row.max())
            assert box.confidence == 1.0
            covered |= truth.instance == box.track_id
        assert (truth.moving & ~covered).sum() < 150 * 3
        assert not (covered & ~truth.moving).any()
    assert labels == {"person", "box"}


def test_an_object_counts_as_moving_only_while_it_is_handled() -> None:
    room = open_synthetic("synthetic:pushed,frames=600,cache=off")
    (chair,) = room.scene.objects
    handled = [chair.is_moving(float(t)) for t in room.timestamps_s]
    first, last = handled.index(True), len(handled) - 1 - handled[::-1].index(True)
    assert 30 < first < last < 500
    for index in (first - 10, (first + last) // 2, last + 10):
        truth = room.truth(index)
        shown = truth.instance == chair.instance
        assert shown.sum() > 500
        assert truth.moving[shown].all() == handled[index]
        assert truth.moving[shown].any() == handled[index]
    before, after = chair.place(room.timestamps_s[first - 1]), chair.place(room.timestamps_s[last + 1])
    assert np.linalg.norm(after[:3, 3] - before[:3, 3]) > 1.0
    np.testing.assert_array_equal(after, chair.place(room.timestamps_s[-1]))


def test_ten_thousand_frames_cost_no_more_lines_and_no_more_memory_than_a_hundred() -> None:
    lines, peaks = [], []
    for frames in (100, 100, 10_000):  # the first makes what all of them share
        tracemalloc.start()

        def look(frames: int = frames) -> None:
            room = open_synthetic(f"synthetic:walking,frames={frames},cache=off")
            for index in np.linspace(0, frames - 1, 8).astype(int).tolist():
                room.load(index)

        lines.append(n_lines(look))
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert lines[2] < 1.2 * lines[1]
    assert peaks[2] < peaks[1] + 1_000_000
    assert len(open_synthetic("synthetic:walking,frames=10000,cache=off").groundtruth) == 10_000
