"""Sets of points, against Python's own: whatever was asked before, however the map has grown, from any thread."""

import threading

import numpy as np
from small_world import SmallMap, SmallWorld, pose

from stillroom.data.map import Map
from stillroom.data.map.map import Marks

POSES = [pose(0.3 * k) for k in range(8)]


def seen(world: Map, keyframes: list[int]) -> list[int]:
    return sorted({int(point) for k in keyframes for point in world.points_of(k) if point >= 0})


def test_points_seen_by_keyframes_are_their_union_in_order() -> None:
    small = SmallMap.of(SmallWorld.of(1, 300), POSES)
    rng = np.random.default_rng(0)
    for _ in range(20):
        chosen = rng.choice(len(POSES), int(rng.integers(1, 6)), replace=False)
        assert small.map.points_seen_by(chosen).tolist() == seen(small.map, chosen.tolist())
    assert small.map.points_seen_by(np.array([])).tolist() == []
    before = small.map.points_seen_by(np.array([3]))
    small.map.add_points(np.zeros((50_000, 3)), np.zeros(50_000, dtype=np.int64))
    np.testing.assert_array_equal(small.map.points_seen_by(np.array([3])), before)


def test_points_without_others_keep_their_order() -> None:
    small = SmallMap.of(SmallWorld.of(2, 300), POSES)
    rng = np.random.default_rng(1)
    for _ in range(20):
        ids = rng.permutation(len(small.map.points))[:120].astype(np.int32)
        others = rng.integers(-1, len(small.map.points), 90).astype(np.int32)
        expected = [point for point in ids.tolist() if point not in set(others.tolist())]
        assert small.map.without(ids, others).tolist() == expected
    assert small.map.without(ids, np.array([-1], dtype=np.int32)).tolist() == ids.tolist()


def test_threads_do_not_disturb_each_other() -> None:
    small = SmallMap.of(SmallWorld.of(3, 400), POSES)
    wrong: list[int] = []

    def ask(keyframe: int) -> None:
        expected = seen(small.map, [keyframe, 0])
        wrong.extend(
            keyframe for _ in range(300) if small.map.points_seen_by(np.array([keyframe, 0])).tolist() != expected
        )

    threads = [threading.Thread(target=ask, args=(k,)) for k in (1, 4, 7)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong
    marks, others = Marks(), []
    asking = threading.Thread(target=lambda: others.append(marks.fresh(10)[0]))
    asking.start()
    asking.join()
    assert others[0] is not marks.fresh(10)[0]
