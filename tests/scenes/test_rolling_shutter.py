"""A rendered rolling shutter: each row at its own time, against a slow ray caster; depth and truth in the middle."""

from dataclasses import replace

import numpy as np
import pytest
from synthetic_raycaster import cast

from stillroom.datasets.open import open_dataset
from stillroom.errors import ConfigError
from stillroom_scenes.config import open_synthetic
from stillroom_scenes.render import render, render_rows

READOUT_MS = 30.0
ROLLING = "synthetic:empty,path=rpy,frames=90,cache=off"


@pytest.mark.parametrize("index", [20, 61])
def test_each_row_is_what_a_plain_ray_caster_sees_at_its_time(index: int) -> None:
    room = open_synthetic(f"{ROLLING},readout_ms={READOUT_MS}")
    time_s = float(room.timestamps_s[index])
    rows = render_rows(room.scene, room.camera, room._way, time_s)
    still = render(room.scene, room.camera, room.pose(index), time_s)
    rng = np.random.default_rng(1)
    off, off_still = [], []
    for row in rng.integers(0, 480, 12):
        after_s = ((row + 0.5) / 480 - 0.5) * 1e-3 * READOUT_MS
        pose = room._way.poses(np.array([time_s + after_s]))[0]
        pixels = np.column_stack((rng.integers(0, 640, 60), np.full(60, row)))
        depths, _, margins = cast(room.scene.patches(time_s + after_s), room.camera, pose, pixels)
        clear = margins > 0.05
        inverse = 1.0 / depths[clear]
        off.append(np.abs(rows.inverse_depth[row, pixels[clear, 0]] - inverse) / inverse)
        off_still.append(np.abs(still.inverse_depth[row, pixels[clear, 0]] - inverse) / inverse)
    # Two rows share a pose: half a row of the readout away, less than a tenth of a pixel of the slope of a wall.
    assert np.quantile(np.concatenate(off), 0.98) < 2e-4
    assert np.quantile(np.concatenate(off_still), 0.9) > 1e-3


def test_colours_are_those_of_an_image_taken_at_the_rows_time() -> None:
    room = open_synthetic(f"synthetic:walking,path=rpy,frames=90,noise=off,cache=off,readout_ms={READOUT_MS}")
    index, time_s = 33, float(room.timestamps_s[33])
    seen = room.load(index)
    for row in (3, 120, 239, 350, 470):
        after_s = float(room.camera.rows_after_s(np.array([row]))[0])
        pose = room._way.poses(np.array([time_s + after_s]))[0]
        then = render(room.scene, room.camera, pose, time_s + after_s).rgb[row].astype(int)
        assert np.median(np.abs(seen.rgb[row].astype(int) - then)) <= 1
        assert (np.abs(seen.rgb[row].astype(int) - then).max(axis=1) < 25).mean() > 0.97


def test_depth_and_truth_are_of_the_middle_and_the_camera_says_its_readout() -> None:
    rolling, still = (open_synthetic(f"{ROLLING}{rest}") for rest in (f",readout_ms={READOUT_MS}", ""))
    assert rolling.camera == replace(still.camera, readout_s=0.030)
    for index in (0, 40):
        one, other = rolling.load(index), still.load(index)
        np.testing.assert_array_equal(one.depth_m, other.depth_m)
        assert np.abs(one.rgb.astype(int) - other.rgb).mean() > 2.0
        np.testing.assert_array_equal(rolling.truth(index).depth_m, still.truth(index).depth_m)
        np.testing.assert_array_equal(rolling.pose(index), still.pose(index))


def test_a_readout_of_nothing_is_a_global_shutter_to_the_byte() -> None:
    given, left_out = (open_synthetic(f"synthetic:walking,frames=40,cache=off{rest}") for rest in (",readout_ms=0", ""))
    assert given.name == left_out.name
    one, other = given.load(17), left_out.load(17)
    np.testing.assert_array_equal(one.rgb, other.rgb)
    assert one.truth is not None
    assert other.truth is not None
    assert one.truth.boxes == other.truth.boxes


def test_a_camera_at_rest_sees_the_same_with_either_shutter() -> None:
    rolling, still = (
        open_synthetic(f"synthetic:empty,path=still,frames=9,noise=off,cache=off{rest}")
        for rest in (",readout_ms=20", "")
    )
    differs = np.abs(rolling.load(4).rgb.astype(int) - still.load(4).rgb).max(axis=2) > 3
    assert differs.mean() < 0.002


def test_boxes_and_masks_are_of_the_colour_image() -> None:
    room = open_synthetic(f"synthetic:walking,frames=90,cache=off,readout_ms={READOUT_MS}")
    image, truth = room.load(50), room.truth(50)
    assert image.truth is not None
    mask = image.truth.movable
    overlap = (mask & truth.moving).sum() / (mask | truth.moving).sum()
    assert 0.9 < overlap < 1.0, "people are where the rows see them, which is near where they are in the middle"


def test_what_is_kept_on_disk_is_told_apart_by_the_readout() -> None:
    spec = "synthetic:empty,path=rpy,frames=40"
    first = open_synthetic(f"{spec},readout_ms=10").load(20).rgb.copy()
    assert (open_synthetic(f"{spec},readout_ms=20").load(20).rgb != first).any()
    np.testing.assert_array_equal(open_synthetic(f"{spec},readout_ms=10").load(20).rgb, first)


@pytest.mark.parametrize("value", ["-1", "34", "nan", "inf"])
def test_a_readout_that_no_camera_has_is_refused(value: str) -> None:
    with pytest.raises(ConfigError, match=r"readout_ms is .*; it must be 0 to 33\.3"):
        open_dataset(f"synthetic:empty,readout_ms={value}")


def test_the_name_tells_the_readout() -> None:
    assert open_synthetic("synthetic:empty,readout_ms=12.5,cache=off").name.endswith("_readout12.5ms")
