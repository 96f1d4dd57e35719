"""The three searches on a small world: whoever is matched must be who it is."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from small_world import SmallMap, SmallWorld, pose

from stillroom.data.frame import Frame, Keypoints
from stillroom.data.matches import Matches
from stillroom.geometry import se3
from stillroom.tracking.correspondences import targets_of, with_keyframe, with_last_frame, with_points

NEXT = pose(0.03, -0.01, 0.02, (0.01, 0.02, -0.01))


@pytest.fixture
def small() -> SmallMap:
    return SmallMap.of(SmallWorld.of(0, 500), [np.eye(4)])


def next_frame(small: SmallMap, T_world_cam: np.ndarray = NEXT, **look: float) -> tuple[Frame, np.ndarray]:
    return small.world.look(T_world_cam, seed=99, index=1, **{"noise_px": 0.5, "flips": 20, **look})


def n_right(small: SmallMap, matches: Matches, seen: np.ndarray) -> int:
    """Count the matches, all of which must be right and none twice."""
    np.testing.assert_array_equal(small.number_of()[matches.point_id], seen[matches.keypoint])
    assert len(np.unique(matches.point_id)) == len(np.unique(matches.keypoint)) == len(matches)
    return len(matches)


def on_level(frame: Frame, octave: int) -> Frame:
    """The same frame with all keypoints on one level."""
    return replace(frame, keypoints=replace(frame.keypoints, octave=np.full(len(frame), octave, np.int32)))


def both(first: Frame, second: Frame) -> Frame:
    """A frame with the keypoints of two."""
    pairs = zip(first.keypoints.__dict__.values(), second.keypoints.__dict__.values(), strict=True)
    keypoints = Keypoints(*(np.concatenate(pair) for pair in pairs))
    return replace(first, keypoints=keypoints, is_static=np.ones(len(keypoints), bool))


def with_wrong_turns(frame: Frame, some: np.ndarray) -> Frame:
    """The same frame with the orientation of some keypoints (N,) turned away, each by another angle."""
    turn_rad = np.where(some, np.linspace(1.0, 5.0, len(frame)), 0.0)
    angle_rad = np.angle(np.exp(1j * (frame.keypoints.angle_rad + turn_rad))).astype(np.float32)
    return replace(frame, keypoints=replace(frame.keypoints, angle_rad=angle_rad))


def common(small: SmallMap, seen: np.ndarray) -> np.ndarray:
    return np.intersect1d(small.seen[0], seen)


def test_targets_are_the_frames_keypoints(small: SmallMap) -> None:
    frame, _ = next_frame(small)
    usable = np.arange(len(frame)) % 3 == 0
    targets = targets_of(frame, usable)
    assert targets.px is frame.keypoints.px
    assert targets.descriptors is frame.keypoints.descriptors
    np.testing.assert_array_equal(targets.usable, usable)


class TestWithLastFrame:
    def find(self, small: SmallMap, frame: Frame, T_world_cam: np.ndarray = NEXT, radius_px: float = 15) -> Matches:
        return with_last_frame(frame, small.tracked(0), np.linalg.inv(T_world_cam), small.map, radius_px)

    def test_the_last_frames_points_are_found(self, small: SmallMap) -> None:
        frame, seen = next_frame(small)
        matches = self.find(small, frame)
        assert n_right(small, matches, seen) > 0.95 * len(common(small, seen))
        where = dict(zip(small.seen[0].tolist(), small.frames[0].keypoints.px, strict=True))
        expected = [where[number] for number in seen[matches.keypoint].tolist()]
        np.testing.assert_array_equal(matches.reference_px, expected)

    def test_points_are_looked_for_where_they_are_predicted(self, small: SmallMap) -> None:
        frame, seen = next_frame(small)
        astray = NEXT @ se3.exp(np.array([0, 0, 0, 0, 0.06, 0]))  # 31 px
        small.frames[0], frame = on_level(small.frames[0], 0), on_level(frame, 0)
        assert len(self.find(small, frame, astray)) < 5
        assert n_right(small, self.find(small, frame, astray, 50), seen) > 0.9 * len(common(small, seen))
        # On level 5 a pixel is 2.5 times as large, and so is the window.
        small.frames[0], frame = on_level(small.frames[0], 5), on_level(frame, 5)
        assert n_right(small, self.find(small, frame, astray), seen) > 0.6 * len(common(small, seen))

    def test_points_have_moved_with_the_map(self, small: SmallMap) -> None:
        frame, seen = next_frame(small)
        move = se3.exp(np.array([0.5, 0.2, 0.1, 0.3, 0.1, -0.2]))
        small.map.points.position_m[:] = se3.transform(move, small.map.points.position_m)
        small.map.keyframes.T_world_cam[0] = move @ small.map.keyframes.T_world_cam[0]
        matches = self.find(small, frame, move @ NEXT)
        assert n_right(small, matches, seen) > 0.95 * len(common(small, seen))

    @pytest.mark.parametrize(("z", "levels"), [(0.3, {4, 5, 6, 7}), (-0.3, {0, 1, 2, 3, 4}), (0.05, {3, 4, 5})])
    def test_the_level_follows_from_the_direction_of_travel(self, small: SmallMap, z: float, levels: set[int]) -> None:
        # Closer makes things larger: then a point is on the same level or a coarser one. 7.7 cm is the baseline.
        there = pose(z=z)
        small.frames[0] = on_level(small.frames[0], 4)
        frame, seen = next_frame(small, there)
        for octave in range(8):
            matches = self.find(small, on_level(frame, octave), there)
            share = n_right(small, matches, seen) / len(common(small, seen))
            assert share > 0.9 if octave in levels else share == 0

    def test_moving_keypoints_and_points_behind_the_camera_are_left_out(self, small: SmallMap) -> None:
        frame, seen = next_frame(small)
        frame = frame.with_static(np.arange(len(frame)) % 2 == 0)
        matches = self.find(small, frame)
        assert np.all(matches.keypoint % 2 == 0)
        assert n_right(small, matches, seen) > 0.4 * len(common(small, seen))
        turned = pose(turn=(0, np.pi, 0))
        assert len(self.find(small, next_frame(small)[0], turned, 1000)) == 0

    def test_a_wrong_turn_of_a_match_is_noticed(self, small: SmallMap) -> None:
        frame, _ = next_frame(small)
        matches = self.find(small, with_wrong_turns(frame, np.arange(len(frame)) % 10 == 3))
        assert len(matches) > 200
        assert set((matches.keypoint % 10).tolist()) == set(range(10)) - {3}

    def test_points_that_were_joined_since_are_looked_for_once(self, small: SmallMap) -> None:
        # A corner that is found on two levels makes two points at first; mapping finds out that they are one.
        frame, _ = next_frame(small)
        fine, coarse = on_level(frame, 1), on_level(frame, 6)
        frame = both(fine, coarse)
        last = small.tracked(0)
        last = replace(
            last,
            frame=both(on_level(last.frame, 1), on_level(last.frame, 6)),
            point_ids=np.concatenate((last.point_ids, last.point_ids)),
        )
        matches = with_last_frame(frame, last, np.linalg.inv(NEXT), small.map, 15)
        assert len(matches) > 200
        assert len(np.unique(matches.point_id)) == len(matches)

    def test_a_last_frame_without_points_gives_no_matches(self, small: SmallMap) -> None:
        frame, _ = next_frame(small)
        last = replace(small.tracked(0), point_ids=np.full(len(small.frames[0]), -1, np.int32))
        assert len(with_last_frame(frame, last, np.eye(4), small.map, 15)) == 0


class TestWithKeyframe:
    def test_the_keyframes_points_are_found_from_anywhere(self, small: SmallMap) -> None:
        frame, seen = next_frame(small, pose(0.5, 0.1, -0.4, (0.1, -0.1, 0.0)))
        matches = with_keyframe(frame, 0, small.map)
        assert n_right(small, matches, seen) > 0.95 * len(common(small, seen))
        kp = small.frames[0].keypoints
        where = dict(zip(small.map.points_of(0).tolist(), kp.px.tolist(), strict=True))
        assert matches.reference_px.tolist() == [where[point] for point in matches.point_id.tolist()]

    def test_moving_keypoints_and_wrong_turns_are_left_out(self, small: SmallMap) -> None:
        frame, _ = next_frame(small)
        frame = with_wrong_turns(frame, np.arange(len(frame)) % 10 == 3)
        frame = frame.with_static(np.arange(len(frame)) % 10 != 5)
        left = set((with_keyframe(frame, 0, small.map).keypoint % 10).tolist())
        assert left == set(range(10)) - {3, 5}

    def test_a_keyframe_that_sees_nothing_gives_no_matches(self, small: SmallMap) -> None:
        frame, _ = next_frame(small)
        small.map.remove_points(small.map.points_of(0)[small.map.points_of(0) >= 0])
        assert len(with_keyframe(frame, 0, small.map)) == 0
        assert len(with_keyframe(frame.with_static(np.zeros(len(frame))), 0, small.map)) == 0


class TestWithPoints:
    def find(self, small: SmallMap, frame: Frame, free: np.ndarray, **rest: float) -> tuple[Matches, np.ndarray]:
        ids = small.id_of[small.id_of >= 0]
        return with_points(frame, ids, free, np.linalg.inv(NEXT), small.map, **{"widen": 1.0, **rest})

    def test_points_are_found_and_all_that_are_in_view_should_be(self, small: SmallMap) -> None:
        frame, seen = next_frame(small)
        matches, visible = self.find(small, frame, np.ones(len(frame), bool))
        assert n_right(small, matches, seen) > 0.9 * len(common(small, seen))
        assert set(small.number_of()[visible].tolist()) == set(common(small, seen).tolist())
        assert np.isnan(matches.reference_px).all()
        assert matches.reference_px.shape == (len(matches), 2)

    def test_only_free_static_keypoints_are_matched(self, small: SmallMap) -> None:
        frame, _ = next_frame(small)
        number = np.arange(len(frame)) % 6
        matches, _ = self.find(small, frame.with_static(number != 1), number != 2)
        assert set((matches.keypoint % 6).tolist()) == {0, 3, 4, 5}

    def test_the_window_is_wider_for_points_seen_from_the_side_and_on_coarse_levels(self, small: SmallMap) -> None:
        # Head-on 2.5 px on the finest level, else 4 px, times `widen` and the level's factor.
        frame, seen = next_frame(small, np.eye(4), noise_px=0.0, flips=0)
        world, known = small.map, np.flatnonzero(small.id_of >= 0)
        ids = small.id_of[known]
        distance_m = np.linalg.norm(small.world.points_m[known], axis=1)
        away = small.world.points_m[known] / distance_m[:, None]
        sideways = np.cross(away, [0.0, 1.0, 0.0])
        sideways /= np.linalg.norm(sideways, axis=1, keepdims=True)
        for (tilt_rad, window_px), octave, widen, (factor, is_found) in itertools.product(
            ((0.0, 2.5), (0.2, 4.0)), (0, 3), (1.0, 3.0), ((0.98, True), (1.02, False))
        ):
            world.points.normal[ids] = np.cos(tilt_rad) * away + np.sin(tilt_rad) * sideways
            world.points.max_distance_m[ids] = distance_m * 1.2**octave * 0.999
            shift_px = np.array([factor * window_px * widen * 1.2**octave, 0], np.float32)
            kp = on_level(frame, octave).keypoints
            kp = replace(kp, px=kp.px + shift_px, right_px=np.full_like(kp.right_px, -1))
            moved = replace(frame, keypoints=kp)
            matches, _ = with_points(moved, ids, np.ones(len(frame), bool), np.eye(4), world, widen)
            n = np.sum(small.number_of()[matches.point_id] == seen[matches.keypoint])
            assert n > 300 if is_found else n < 3

    def test_of_two_that_look_alike_neither_is_taken(self, small: SmallMap) -> None:
        frame, _ = next_frame(small)
        twice = both(frame, frame)
        matches, visible = self.find(small, twice, np.ones(len(twice), bool))
        assert len(matches) < 0.1 * len(visible)
        matches, _ = self.find(small, twice, np.ones(len(twice), bool), ratio=1.0)
        assert len(matches) > 0.8 * len(visible)

    def test_nothing_to_look_for(self, small: SmallMap) -> None:
        frame, _ = next_frame(small)
        matches, visible = with_points(
            frame, np.zeros(0, np.int32), np.ones(len(frame), bool), np.eye(4), small.map, 1.0
        )
        assert len(matches) == len(visible) == 0
