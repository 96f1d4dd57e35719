"""The map's linked lists against dictionaries, through long random lives."""

import numpy as np
import pytest
from naive_map import NaiveMap
from small_world import SCALES, SmallWorld, pose

from stillroom.data.map import Map

WORLD = SmallWorld.of(0, 60)


class Life:
    """A map and its naive twin, to which the same things happen."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.map, self.naive = Map(SCALES), NaiveMap()
        for _ in range(3):
            self.add_keyframe()

    def add_keyframe(self) -> None:
        k = len(self.map.keyframes)
        frame, _ = WORLD.look(pose(), seed=k, depth_share=0.6)
        point_ids = np.full(len(frame), -1, np.int32)
        alive = self.some(sorted(self.naive.alive), 25)
        point_ids[self.rng.permutation(len(frame))[: len(alive)]] = alive
        is_static = self.rng.random(len(frame)) < 0.8
        self.map.add_keyframe(frame, pose(x=k), point_ids, is_static, k - 1)
        start = len(self.naive.row_keyframe)
        self.naive.row_keyframe += [k] * len(frame)
        self.naive.row_has_depth += (frame.keypoints.right_px >= 0).tolist()
        seen = np.flatnonzero((point_ids >= 0) & is_static)
        self.naive.observe(point_ids[seen].tolist(), (start + seen).tolist())

    def some(self, of: list[int], at_most: int) -> list[int]:
        return self.rng.permutation(of)[: self.rng.integers(0, at_most + 1)].astype(int).tolist()

    def rows(self, at_most: int) -> list[int]:
        return self.some([r for r, k in enumerate(self.naive.row_keyframe) if self.map.keyframes.is_alive[k]], at_most)

    def add_points(self) -> None:
        rows = [row for row in self.rows(20) if row not in self.naive.sees]
        ids = self.map.add_points(self.rng.random((len(rows), 3)), np.array(rows, dtype=np.int64))
        self.naive.add_points(ids.tolist(), rows)

    def observe(self) -> None:
        rows = self.rows(40)
        if self.naive.alive:
            points = self.rng.choice(sorted(self.naive.alive), len(rows)).tolist()
            assert self.map.observe(np.array(points, int), np.array(rows, int)) == self.naive.observe(points, rows)

    def remove_observations(self) -> None:
        rows = self.rows(10)
        self.map.remove_observations(np.array(rows, int))
        self.naive.remove_observations(rows)

    def remove_points(self) -> None:
        points = self.some(sorted(self.naive.rows_of), 4)  # dead ones too
        self.map.remove_points(np.array(points, int))
        self.naive.remove_points(points)

    def replace_points(self) -> None:
        chosen = self.some(sorted(self.naive.alive), 12)
        olds, kept = chosen[: len(chosen) // 2], chosen[len(chosen) // 2 :]
        if olds:
            news = self.rng.choice(kept, len(olds)).astype(int).tolist()  # one may take the place of several
            self.map.replace_points(np.array(olds), np.array(news))
            self.naive.replace_points(olds, news)

    def remove_keyframe(self) -> None:
        alive = self.map.alive_keyframes()
        if len(alive) > 3:
            k = int(self.rng.choice(alive[1:]))
            self.map.remove_keyframe(k)
            self.naive.remove_observations([r for r, own in enumerate(self.naive.row_keyframe) if own == k])

    def find(self) -> None:
        for point in self.some(sorted(self.naive.alive), 5):
            self.map.points.n_found[point] += 1
            self.naive.n_found[point] += 1

    def check(self) -> None:
        world, naive = self.map, self.naive
        expected = np.full(len(world.keypoints), -1)
        expected[list(naive.sees)] = list(naive.sees.values())
        np.testing.assert_array_equal(world.keypoints.point, expected)
        everyone = np.arange(len(world.points))
        np.testing.assert_array_equal(world.points.is_alive, [p in naive.alive for p in everyone])
        np.testing.assert_array_equal(world.points.n_keyframes, [len(naive.rows_of[p]) for p in everyone])
        np.testing.assert_array_equal(world.points.n_observations, [naive.n_observations(p) for p in everyone])
        np.testing.assert_array_equal(world.points.n_found, [naive.n_found[p] for p in everyone])
        np.testing.assert_array_equal(
            world.current_ids(everyone.astype(np.int32)), [naive.current(p) for p in everyone]
        )
        asked = self.rng.permutation(everyone)
        place, rows = world.observations(asked)
        pairs = [(i, row) for i, p in enumerate(asked.tolist()) for row in naive.rows_of[p]]
        assert list(zip(place.tolist(), rows.tolist(), strict=True)) == pairs
        oldest = [naive.rows_of[p][-1] if naive.rows_of[p] else -1 for p in asked.tolist()]
        np.testing.assert_array_equal(world.oldest_observations(asked), oldest)
        for point in naive.alive:
            keyframes = world.keypoints.keyframe[naive.rows_of[point]]
            assert len(np.unique(keyframes)) == len(keyframes)
        self.check_questions()

    def check_questions(self) -> None:
        world, naive = self.map, self.naive
        some = np.array([-1, *self.some(sorted(naive.alive), 20)], np.int32)
        counts = np.zeros(len(world.keyframes), int)
        for point in some[some >= 0].tolist():
            for row in naive.rows_of[point]:
                counts[naive.row_keyframe[row]] += 1
        np.testing.assert_array_equal(world.count_shared(some), counts)
        keyframes = self.some(list(range(len(world.keyframes))), 4)
        seen = {point for row, point in naive.sees.items() if naive.row_keyframe[row] in keyframes}
        assert world.points_seen_by(np.array(keyframes)).tolist() == sorted(seen)


@pytest.mark.parametrize("seed", range(8))
def test_the_links_are_those_of_the_naive_map_through_a_random_life(seed: int) -> None:
    life = Life(seed)
    deeds = {
        life.add_keyframe: 1,
        life.add_points: 4,
        life.observe: 5,
        life.remove_observations: 3,
        life.remove_points: 1,
        life.replace_points: 2,
        life.remove_keyframe: 0.6,
        life.find: 2,
    }
    chances = np.array(list(deeds.values())) / sum(deeds.values())
    for step in range(150):
        list(deeds)[life.rng.choice(len(deeds), p=chances)]()
        if step % 5 == 0:
            life.check()
    life.check()
    assert len(life.naive.replaced_by) > 10
    assert len(life.naive.alive) > 20
    assert not life.map.keyframes.is_alive.all()


def test_a_point_with_one_observation_left_goes() -> None:
    life = Life(0)
    ids = life.map.add_points(np.zeros((2, 3)), np.array([0, 1]))
    far = int(life.map.rows(1).start)
    life.map.keypoints.right_px[[0, 1, far, far + 1]] = -1, 5, -1, 5  # both views of a point with depth, or neither
    life.map.points.n_observations[ids] = 1, 2
    life.map.observe(ids, np.array([far, far + 1]))
    assert life.map.points.n_observations[ids].tolist() == [2, 4]
    life.map.remove_observations(np.array([far, far + 1]))
    assert not life.map.points.is_alive[ids].any()
    assert life.map.keypoints.point[[0, 1, far, far + 1]].tolist() == [-1] * 4


def test_moving_keypoints_see_nothing() -> None:
    world = Map(SCALES)
    frame, _ = WORLD.look(pose())
    world.add_keyframe(frame, pose(), np.full(len(frame), -1, np.int32), frame.is_static, -1)
    ids = world.add_points(np.zeros((6, 3)), np.arange(6))
    is_static = np.ones(len(frame), bool)
    is_static[[0, 3]] = False
    point_ids = np.full(len(frame), -1, np.int32)
    point_ids[:6] = ids
    k = world.add_keyframe(frame, pose(), point_ids, is_static, 0)
    assert world.points_of(k)[:6].tolist() == [-1, ids[1], ids[2], -1, ids[4], ids[5]]
    np.testing.assert_array_equal(world.keypoints.is_static[world.rows(k)], is_static)
