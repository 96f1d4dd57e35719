"""What a frame costs does not grow with the length of the run."""

import time
from collections.abc import Callable, Iterator

import cv2
import numpy as np
import pytest
from larger_map import add_far_copies

from stillroom.data.result import FrameResult
from stillroom.evaluation.timing import peak_memory_mb
from stillroom.methods.registry import configure
from stillroom.system import Slam, build
from stillroom_scenes.config import open_synthetic
from stillroom_scenes.room import SyntheticRoom

cv2.setNumThreads(1)


def run(slam: Slam, room: SyntheticRoom, frames: range) -> Iterator[tuple[FrameResult, float]]:
    """Track frames; yield each result with the thread's time [s] that it took, rendering left out."""
    for index in frames:
        image = room.load(index)
        begin = time.thread_time()
        result = slam.process(image)
        yield result, time.thread_time() - begin


def map_bytes(slam: Slam) -> int:
    """Return what the rows in use of the map's tables take."""
    tables = slam.map.keyframes, slam.map.keypoints, slam.map.points
    return sum(view.nbytes for table in tables for view in table.views.values())


def test_what_lies_elsewhere_in_the_map_costs_nothing(record_property: Callable[[str, object], None]) -> None:
    """The map of forty frames with one copy of it far away, and with 150: more points than 10,000 frames make."""
    room = open_synthetic("synthetic:building,rooms=3,frames=600,cache=off")
    spent: dict[int, np.ndarray] = {}
    poses = {}
    for copies in (1, 150):
        slam = build(configure("orb-slam2", overrides=["loops.enabled=false"]), room.camera)
        list(run(slam, room, range(40)))
        add_far_copies(slam.map, copies)
        outcome = list(run(slam, room, range(40, 90)))
        poses[copies] = [result.T_world_cam for result, _ in outcome]
        spent[copies] = np.array([seconds for _, seconds in outcome])
    assert len(slam.map.points) > 300_000
    np.testing.assert_array_equal(poses[1], poses[150])
    # The same work frame by frame, so that frame is compared with frame.
    growth = float(np.median(spent[150] / spent[1]))
    record_property("times the cost in a map 75 times as large", growth)
    # A search through the whole map would cost 75 times as much; what is left is what other programs do to the caches.
    assert growth < 1.6, growth


@pytest.mark.slow
def test_walking_where_one_has_been_makes_the_map_no_larger() -> None:
    """Two rounds of 300 frames through one room: the second finds the first's points again."""
    room = open_synthetic("synthetic:rooms,rooms=1,frames=600,cache=off")
    slam = build(configure("orb-slam2"), room.camera)
    sizes = []
    for half in (range(300), range(300, 600)):
        outcome = list(run(slam, room, half))
        assert all(result.T_world_cam is not None for result, _ in outcome)
        alive = slam.map.alive_keyframes()
        seen_by = slam.map.points.n_keyframes[slam.map.points.is_alive]
        sizes.append((len(alive), int(slam.map.points.is_alive.sum()), float(seen_by.mean())))
    (first, first_points, first_seen), (second, second_points, second_seen) = sizes
    assert second < 1.6 * first, sizes
    assert second_points < 1.6 * first_points, sizes
    assert second_seen < 1.8 * first_seen, sizes


@pytest.mark.slow
def test_ten_thousand_frames_cost_the_same_to_the_last(record_property: Callable[[str, object], None]) -> None:
    """A walk through six rooms and back, five times and more."""
    room = open_synthetic("synthetic:rooms,cache=off")
    assert len(room) == 10_000
    slam = build(configure("orb-slam2"), room.camera)
    outcome = list(run(slam, room, range(len(room))))
    mean_ms = 1e3 * np.array([seconds for _, seconds in outcome]).reshape(10, 1000).mean(axis=1)
    record_property("ms a frame, by thousands", np.round(mean_ms, 1).tolist())
    record_property("bytes of map a keyframe", map_bytes(slam) / len(slam.map.keyframes))
    record_property("peak memory MB", peak_memory_mb())
    assert sum(result.T_world_cam is None for result, _ in outcome) == 0
    assert mean_ms[-1] <= 1.2 * mean_ms[1], mean_ms
    assert map_bytes(slam) / len(slam.map.keyframes) < 300_000
