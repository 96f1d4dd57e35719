"""What a frame needs does not grow with the length of the run."""

import tracemalloc
from collections.abc import Callable

import cv2
import numpy as np
import pytest
from larger_map import add_far_copies

from stillroom.data.image import RgbdImage
from stillroom.data.result import FrameResult
from stillroom.evaluation.timing import peak_memory_mb
from stillroom.presets.registry import configure
from stillroom.system import System, build
from stillroom_scenes.config import open_synthetic
from stillroom_scenes.room import SyntheticRoom

cv2.setNumThreads(1)


def run(system: System, room: SyntheticRoom, frames: range) -> list[FrameResult]:
    """Track frames, one after the other."""
    return [system.process(room.load(index)) for index in frames]


def peak_bytes(system: System, image: RgbdImage) -> tuple[FrameResult, int]:
    """Track a frame; return the result, and how much memory was held at most beyond what was held before."""
    tracemalloc.reset_peak()
    before, _ = tracemalloc.get_traced_memory()
    result = system.process(image)
    return result, tracemalloc.get_traced_memory()[1] - before


def map_bytes(system: System) -> int:
    """Return what the rows in use of the map's tables take."""
    tables = system.map.keyframes, system.map.keypoints, system.map.points
    return sum(view.nbytes for table in tables for view in table.views.values())


def test_what_lies_elsewhere_in_the_map_is_not_looked_at() -> None:
    """The map of forty frames with one copy of it far away, and with 150: more points than 10,000 frames make.

    What projects all points makes arrays larger than any other of a frame. `benchmarks/long_run.py` prints the time.
    """
    room = open_synthetic("synthetic:building,rooms=3,frames=600,cache=off")
    poses, peaks, n_points = [], [], []
    for copies in (1, 150):
        system = build(configure("orb-slam2", overrides=["loops.enabled=false"]), room.camera)
        run(system, room, range(40))
        add_far_copies(system.map, copies)
        n_points.append(len(system.map.points))
        run(system, room, range(40, 50))
        tracemalloc.start()
        outcome = [peak_bytes(system, room.load(index)) for index in range(50, 70)]
        tracemalloc.stop()
        poses.append([result.T_world_cam for result, _ in outcome])
        peaks.append(np.array([n_bytes for _, n_bytes in outcome]))
    few, many = n_points
    assert many > 300_000
    np.testing.assert_array_equal(poses[0], poses[1])
    assert np.all(peaks[1] - peaks[0] < many - few), (peaks, "a byte for each point of the map, or more")


@pytest.mark.slow
def test_walking_where_one_has_been_makes_the_map_no_larger() -> None:
    """Two rounds of 300 frames through one room: the second finds the first's points again."""
    room = open_synthetic("synthetic:rooms,rooms=1,frames=600,cache=off")
    system = build(configure("orb-slam2"), room.camera)
    sizes = []
    for half in (range(300), range(300, 600)):
        outcome = run(system, room, half)
        assert all(result.T_world_cam is not None for result in outcome)
        alive = system.map.alive_keyframes()
        seen_by = system.map.points.n_keyframes[system.map.points.is_alive]
        sizes.append((len(alive), int(system.map.points.is_alive.sum()), float(seen_by.mean())))
    (first, first_points, first_seen), (second, second_points, second_seen) = sizes
    assert second < 1.6 * first, sizes
    assert second_points < 1.6 * first_points, sizes
    assert second_seen < 1.8 * first_seen, sizes


@pytest.mark.slow
def test_ten_thousand_frames_are_tracked_and_the_map_stays_small(
    record_property: Callable[[str, object], None],
) -> None:
    """A walk through six rooms and back, five times and more."""
    room = open_synthetic("synthetic:rooms,cache=off")
    assert len(room) == 10_000
    system = build(configure("orb-slam2"), room.camera)
    outcome = run(system, room, range(len(room)))
    record_property("bytes of map a keyframe", map_bytes(system) / len(system.map.keyframes))
    record_property("peak memory MB", peak_memory_mb())
    assert sum(result.T_world_cam is None for result in outcome) == 0
    assert map_bytes(system) / len(system.map.keyframes) < 300_000
