"""Detect-SLAM's moving probability: how a sighting changes it, and how matching and expansion hand it on."""

from dataclasses import replace

import numpy as np
import pytest
from building import parts
from small_world import CAMERA, SmallMap, SmallWorld, pose

from stillroom.data.frame import Frame
from stillroom.data.matches import Matches
from stillroom.data.motion import Motion, Stage
from stillroom.data.question import Question
from stillroom.data.result import Tracked, TrackingState
from stillroom.data.semantics import Box, Semantics, nothing
from stillroom.dynamics.moving_probability import (
    MovingProbability,
    MovingProbabilityConfig,
    PointProbabilities,
    expand,
)
from stillroom.schedule import Done

WORLD = SmallWorld.of(11, 700)
BOX = Box(200, 0, 419, 479, "person", 0.9)
SEEN = Semantics(480, 640, (BOX,))
NONE = nothing(480, 640)
FAR_APART = 1e-3
"""Reach of expansion in which nobody has a neighbour [px]."""


class Run:
    """A sieve that is shown one world from one place, image after image, with matches as tracking has them."""

    def __init__(self, **changes: float) -> None:
        self.small = SmallMap(WORLD)
        config = replace(MovingProbabilityConfig(reach_px=FAR_APART), **changes)
        self.sieve = MovingProbability(config, self.small.map)
        self.index = 0

    def judge(self, found: Semantics = NONE, matched: bool = True) -> tuple[Frame, np.ndarray, Motion]:
        """Show the next image; return its frame, which point of the world each keypoint is, and what is said."""
        self.index += 1
        frame, seen = WORLD.look(pose(), seed=self.index, index=self.index)
        ids = self.small.id_of[seen] if matched else np.full(len(frame), -1, dtype=np.int32)
        self.ids = ids.astype(np.int32)
        question = Question(Stage.LOCAL_MAP, frame, Matches.of(self.ids), Done(found), np.eye(4), self.small.map)
        return frame, seen, self.sieve.judge(question)

    def frame(self, found: Semantics = NONE, matched: bool = True) -> tuple[Frame, np.ndarray, Motion]:
        """Show an image that does not become a keyframe."""
        frame, seen, motion = self.judge(found, matched)
        self.sieve.remember(frame, np.eye(4), -1)
        return frame, seen, motion

    def keyframe(self, found: Semantics, matched: bool = True, points: bool = True) -> tuple[np.ndarray, Motion]:
        """Show an image that becomes a keyframe, which makes points of what is static, or of nothing."""
        frame, seen, motion = self.judge(matched=matched)
        motion = self.sieve.take_up(Tracked(frame, TrackingState.OK, pose(), self.ids, motion), found)
        kept = np.where(motion.is_static, self.ids, -1).astype(np.int32)
        world = self.small.map
        k = world.add_keyframe(frame, pose(), kept, motion.is_static, len(world.keyframes) - 1)
        new = np.flatnonzero(motion.is_static & (kept < 0)) if points else np.zeros(0, np.int64)
        self.small.id_of[seen[new]] = world.add_points(WORLD.points_m[seen[new]], world.rows(k).start + new)
        self.sieve.remember(frame, np.eye(4), k)
        return seen, motion

    def p_of(self, points: np.ndarray) -> np.ndarray:
        """The P that the sieve stores for points of the world that are in the map."""
        return self.sieve.points.of(self.small.id_of[points].astype(np.int32))[0]


def in_box(points: np.ndarray) -> np.ndarray:
    x = CAMERA.project(WORLD.points_m[points])[:, 0]
    return (np.rint(x) >= BOX.x_min_px) & (np.rint(x) <= BOX.x_max_px)


def test_sightings_change_it_by_the_papers_arithmetic() -> None:
    """Five of one kind in a row take .5 to .916 and back to .084 (docs/reference.md#detect-slam)."""
    run = Run(dynamic_above=0.99)
    expected_in, expected_out = 0.5, 0.5
    for _ in range(5):
        seen, _ = run.keyframe(SEEN)
        expected_in, expected_out = 0.7 * expected_in + 0.3, 0.7 * expected_out
        inside = in_box(seen)
        np.testing.assert_allclose(run.p_of(seen[inside]), expected_in, rtol=1e-5)
        np.testing.assert_allclose(run.p_of(seen[~inside]), expected_out, rtol=1e-5)
    assert (expected_in, expected_out) == (pytest.approx(0.916, abs=1e-3), pytest.approx(0.084, abs=1e-3))


def test_what_lies_in_a_box_of_the_first_keyframe_makes_no_points_and_does_not_come_back() -> None:
    run = Run()
    seen, motion = run.keyframe(SEEN)
    np.testing.assert_array_equal(motion.is_static, ~in_box(seen))
    np.testing.assert_array_equal(motion.moving, SEEN.movable)
    assert (run.small.id_of[seen[in_box(seen)]] < 0).all()
    # Unmatched, seen again and again in images that no detector sees: by keypoints alone it stays known.
    for _ in range(4):
        _, seen, motion = run.frame()
        np.testing.assert_array_equal(motion.is_static, ~in_box(seen))
        assert not motion.moving.any()


def test_one_sighting_more_is_needed_than_the_detector_missed() -> None:
    run = Run()
    for _ in range(3):
        run.keyframe(SEEN)  # .5, .65, .755, .829
    assert [bool((~run.keyframe(NONE)[1].is_static).any()) for _ in range(2)] == [True, False]  # .580, .406


def test_the_background_that_was_often_seen_static_stays_in_a_box() -> None:
    run = Run()
    for _ in range(3):
        run.keyframe(NONE)  # .35, .245, .172
    seen, motion = run.keyframe(SEEN)  # .42 in the box
    assert motion.is_static.all()
    seen, motion = run.keyframe(SEEN)  # .594
    np.testing.assert_array_equal(motion.is_static, ~in_box(seen))


def test_between_keyframes_a_map_point_hands_it_on_whatever_the_last_keypoint_had() -> None:
    run = Run(dynamic_above=0.9)
    seen, _ = run.keyframe(SEEN)
    run.sieve.points.put(run.small.id_of[seen], np.full(len(seen), 0.95, np.float32))
    assert not run.judge()[2].is_static.any()
    assert run.judge(matched=False)[2].is_static.all(), "without matches the last keypoints count, which had less"


def test_a_keypoint_that_nothing_is_known_of_is_static() -> None:
    run = Run()
    _, _, motion = run.frame(matched=False)
    assert motion.is_static.all()


def test_a_box_in_an_image_that_is_no_keyframe_counts_there() -> None:
    run = Run()
    _, seen, motion = run.frame(SEEN)
    np.testing.assert_array_equal(motion.is_static, ~in_box(seen))
    np.testing.assert_array_equal(motion.moving, SEEN.movable)


def test_a_keyframe_in_which_a_detector_for_every_image_finds_nothing_is_a_sighting() -> None:
    run = Run()
    run.keyframe(NONE)
    frame, seen, _ = run.judge()
    world = run.small.map
    k = world.add_keyframe(frame, pose(), run.ids, np.ones(len(frame), np.bool_), 0)
    run.sieve.remember(frame, np.eye(4), k)
    np.testing.assert_allclose(run.p_of(seen[run.ids >= 0]), 0.5 * 0.7**2, rtol=1e-5)


def test_asking_again_changes_nothing() -> None:
    run = Run()
    run.keyframe(SEEN)
    frame, _, first = run.judge()
    question = Question(Stage.LOCAL_MAP, frame, Matches.of(run.ids), Done(SEEN), np.eye(4), run.small.map)
    again = [run.sieve.judge(question).is_static for _ in range(3)]
    np.testing.assert_array_equal(again[0], again[2])
    blind = replace(question, semantics=Done(NONE))
    np.testing.assert_array_equal(run.sieve.judge(blind).is_static, first.is_static)


def test_a_point_that_replaces_another_takes_over_what_was_known_of_it() -> None:
    points = PointProbabilities()
    points.put(np.array([2, 5]), np.array([0.9, 0.2], np.float32))
    points.follow(np.array([2, 5, 7], np.int32), np.array([3, -1, 8], np.int32))
    p_moving, is_known = points.of(np.array([2, 3, 5, 8, 100, -1], np.int32))
    np.testing.assert_allclose(p_moving, [0.9, 0.9, 0.2, 0.5, 0.5, 0.5])
    assert is_known.tolist() == [True, True, True, False, False, False]
    points.follow(np.array([2], np.int32), np.array([5], np.int32))
    assert points.of(np.array([5], np.int32))[0] == pytest.approx(0.2), "it keeps its own"


def test_points_that_mapping_fused_are_followed() -> None:
    run = Run(dynamic_above=0.99)
    seen, _ = run.keyframe(SEEN)
    old = run.small.id_of[seen[in_box(seen)][:1]].astype(np.int32)
    world = run.small.map
    frame, _ = WORLD.look(pose(), seed=99, index=99)
    k = world.add_keyframe(frame, pose(), np.full(len(frame), -1, np.int32), np.ones(len(frame), np.bool_), 0)
    new = world.add_points(WORLD.points_m[:1], np.array([world.rows(k).start]))
    world.replace_points(old, new)
    run.small.id_of[run.small.id_of == old[0]] = -1
    run.keyframe(NONE, points=False)
    p_moving, is_known = run.sieve.points.of(new)
    assert (p_moving[0], is_known[0]) == (pytest.approx(0.65), True)


@pytest.mark.parametrize("seed", [0, 1])
def test_expansion_is_the_papers_sum(seed: int) -> None:
    rng = np.random.default_rng(seed)
    px = rng.uniform(0, 100, (80, 2)).astype(np.float32)
    p_moving = rng.uniform(0, 1, 80).astype(np.float32)
    sure, unmatched = np.arange(0, 40), np.arange(50, 80)
    expected = p_moving.copy().astype(np.float64)
    for i in unmatched:
        distance = np.linalg.norm(px[sure].astype(np.float64) - px[i], axis=1)
        factor = np.where(distance <= 15.0, 0.4 * np.exp(-distance / 15.0), 0.0)
        expected[i] = np.clip(0.5 + (factor * (p_moving[sure] - 0.5)).sum(), 0.0, 1.0)
    expand(px, p_moving, sure, unmatched, 15.0, 0.4)
    np.testing.assert_allclose(p_moving, expected, atol=1e-5)
    assert np.any(expected[unmatched] != 0.5)


def half_matched(run: Run, p_moving: float) -> tuple[Frame, np.ndarray, Motion]:
    """Ask of an image in which every second keypoint is matched, all with points of one P; return which are not."""
    run.index += 1
    frame, seen = WORLD.look(pose(), seed=run.index, index=run.index)
    ids = run.small.id_of[seen].astype(np.int32)
    run.sieve.points.put(ids, np.full(len(ids), p_moving, np.float32))
    run.sieve._last = None  # nothing is handed on by keypoints
    unmatched = np.arange(len(ids)) % 2 == 0
    matches = Matches.of(np.where(unmatched, np.int32(-1), ids))
    motion = run.sieve.judge(Question(Stage.LOCAL_MAP, frame, matches, Done(NONE), np.eye(4), run.small.map))
    return frame, unmatched, motion


@pytest.mark.parametrize(("p_moving", "reaches"), [(0.76, True), (0.74, False)])
def test_expansion_reaches_from_those_of_high_confidence_only(p_moving: float, reaches: bool) -> None:
    run = Run(reach_px=40.0)
    run.keyframe(NONE)
    frame, unmatched, motion = half_matched(run, p_moving)
    assert not motion.is_static[~unmatched].any()
    px = frame.keypoints.px
    near = np.array([np.hypot(*(px[~unmatched] - one).T).min() <= 40 for one in px])
    np.testing.assert_array_equal(motion.is_static[unmatched & near], not reaches)
    assert motion.is_static[unmatched & ~near].all()
    assert (unmatched & near).sum() > 100


def test_what_is_expanded_is_not_handed_on() -> None:
    run = Run(reach_px=40.0)
    run.keyframe(NONE)
    frame, unmatched, motion = half_matched(run, 0.9)
    assert not motion.is_static[unmatched].all()
    run.sieve.remember(frame, np.eye(4), -1)
    later = run.judge(matched=False)[2]
    assert (~later.is_static).sum() == (~unmatched).sum(), "those that were matched hand it on, and no others"


def test_the_preset_is_built_of_parts() -> None:
    assert isinstance(MovingProbabilityConfig().build(parts()), MovingProbability)
