"""Sieves in one socket: all are asked, what any finds moves, and those that would leave too little go unheard."""

import numpy as np
import pytest
from small_world import SmallMap, SmallWorld, no_semantics, pose

from stillroom.data.matches import Matches
from stillroom.data.motion import Motion, Stage
from stillroom.data.question import Question
from stillroom.data.semantics import Box, Semantics
from stillroom.dynamics.chain import Chain
from stillroom.schedule import Done

SMALL = SmallMap.of(SmallWorld.of(0), [pose()])
FRAME = SMALL.frames[0]
MATCHES = Matches.of(SMALL.id_of[SMALL.seen[0]])


class Fixed:
    """Rejects keypoints from one number to another, and pixels of as many rows."""

    def __init__(self, first: int, last: int) -> None:
        self.first, self.last, self.asked = first, last, []

    def judge(self, question: Question) -> Motion:
        self.asked.append(question.stage)
        motion = question.nothing_moves()
        motion.is_static[self.first : self.last] = False
        motion.moving[self.first : self.last] = True
        return motion


def asked_of(matches: Matches, known: Semantics | None = None) -> Question:
    semantics = no_semantics() if known is None else Done(known)
    return Question(Stage.LOCAL_MAP, FRAME, matches, semantics, np.eye(4), SMALL.map)


def judged(*sieves: Fixed, matches: Matches = MATCHES) -> Motion:
    chain = Chain(sieves, SMALL.map)
    return chain.judge(asked_of(matches))


def rejected(motion: Motion) -> list[int]:
    return np.flatnonzero(~motion.is_static).tolist()


def test_what_any_finds_moves() -> None:
    sieves = Fixed(0, 10), Fixed(5, 20), Fixed(40, 41)
    motion = judged(*sieves)
    assert rejected(motion) == [*range(20), 40]
    assert np.flatnonzero(motion.moving.all(axis=1)).tolist() == [*range(20), 40]
    assert all(sieve.asked == [Stage.LOCAL_MAP] for sieve in sieves)


def test_one_that_would_leave_too_little_goes_unheard_and_the_next_does_not() -> None:
    n = len(FRAME)
    assert len(MATCHES) == n
    too_much = Fixed(20, n - 39 + 10)
    motion = judged(Fixed(0, 10), too_much, Fixed(12, 15))
    assert rejected(motion) == [*range(10), *range(12, 15)]
    assert too_much.asked, "it has a past to keep, heard or not"
    assert not motion.moving[20:].any()
    just_enough = judged(Fixed(0, 10), Fixed(10, n - 40))
    assert rejected(just_enough) == list(range(n - 40))


def test_where_tracking_could_not_go_on_before_all_are_heard() -> None:
    few = MATCHES.keep(np.arange(len(MATCHES)) < 19)
    assert rejected(judged(Fixed(0, 10), Fixed(10, 15), matches=few)) == list(range(15))


def test_where_there_are_few_none_is_taken_away() -> None:
    few = MATCHES.keep(np.arange(len(MATCHES)) < 30)
    beside = judged(Fixed(30, 40), Fixed(29, 50), Fixed(40, 60), matches=few)
    assert rejected(beside) == list(range(30, 60)), "the second would take one of the thirty"


@pytest.mark.parametrize(
    ("n", "left", "enough"), [(90, 40, True), (90, 39, False), (30, 30, True), (30, 29, False), (19, 0, True)]
)
def test_enough_is_enough(n: int, left: int, enough: bool) -> None:
    motion = Motion.none(len(FRAME), 480, 640)
    motion.is_static[left:] = False
    question = asked_of(MATCHES.keep(np.arange(len(MATCHES)) < n))
    assert question.leaves_enough(motion) == enough


def test_a_verdict_falls_back_to_the_masks_and_then_to_nothing() -> None:
    everything = Motion(np.zeros(len(FRAME), dtype=np.bool_), np.ones((480, 640), dtype=np.bool_))
    some = Semantics(480, 640, (Box(0.0, 0.0, 100.0, 479.0, "person", 1.0),))
    masked = asked_of(MATCHES, some).enough_of(everything)
    np.testing.assert_array_equal(masked.moving, some.movable)
    np.testing.assert_array_equal(masked.is_static, ~some.movable_at(FRAME.keypoints.raw_px))
    assert not masked.is_static.all()
    all_over = Semantics(480, 640, (Box(0.0, 0.0, 639.0, 479.0, "person", 1.0),))
    nothing = asked_of(MATCHES, all_over).enough_of(everything)
    assert nothing.is_static.all()
    assert not nothing.moving.any()
    one = Motion.none(len(FRAME), 480, 640)
    assert asked_of(MATCHES, some).enough_of(one) is one
