"""The life of a sieve: what asking does for every one of them, whatever the sieve itself does."""

from dataclasses import replace

import numpy as np
import pytest
from small_world import SmallMap, SmallWorld, no_semantics, pose

from stillroom.data.frame import Frame
from stillroom.data.matches import Matches
from stillroom.data.motion import Motion, Stage
from stillroom.data.question import Question
from stillroom.dynamics.asking import Asking, ImageMemory
from stillroom.geometry import se3

SMALL = SmallMap.of(SmallWorld.of(0), [pose()])
FRAME = SMALL.frames[0]
QUESTION = Question(
    Stage.LOCAL_MAP, FRAME, Matches.of(SMALL.id_of[SMALL.seen[0]]), no_semantics(), np.eye(4), SMALL.map
)


class Rude:
    """Says that everything moves, at every stage, and notes what happens to it."""

    def __init__(self, stay: int = 0) -> None:
        self.stay, self.events = stay, []

    def judge(self, question: Question) -> Motion:
        self.events.append(question.stage)
        motion = question.nothing_moves()
        motion.is_static[self.stay :] = False
        motion.moving[:] = True
        return motion

    def remember(self, frame: Frame, T_cam_world: np.ndarray, keyframe: int) -> None:
        self.events.append((frame.image.index, keyframe))

    def corrected(self, T_new_old: np.ndarray) -> None:
        self.events.append(T_new_old)


class Awkward:
    """An answer that must not be waited for."""

    def result(self) -> None:
        raise AssertionError("nobody needs to know")


def test_while_relocalizing_the_sieve_is_not_asked_and_nothing_is_awaited() -> None:
    sieve = Rude()
    motion = Asking(sieve, SMALL.map).judge(replace(QUESTION, stage=Stage.RELOCALIZATION, semantics=Awkward()))
    assert motion.is_static.all()
    assert not motion.moving.any()
    assert not sieve.events


@pytest.mark.parametrize("stage", [stage for stage in Stage if stage is not Stage.RELOCALIZATION])
def test_a_verdict_that_leaves_too_little_is_not_heard(stage: Stage) -> None:
    n = len(FRAME)
    assert n > 100
    for stay, heard in ((n // 2, True), (3, False)):
        motion = Asking(Rude(stay), SMALL.map).judge(replace(QUESTION, stage=stage))
        assert motion.is_static.all() == (not heard)
        assert motion.moving.any() == heard


def test_corrections_of_the_map_reach_the_memory_once_and_before_the_next_question() -> None:
    sieve, jump = Rude(len(FRAME)), se3.exp(np.array([0.3, 0.0, 0.1, 0.0, 0.2, 0.0]))
    small = SmallMap.of(SmallWorld.of(0), [pose()])
    asking, question = Asking(sieve, small.map), replace(QUESTION, world=small.map, stage=Stage.MOTION_MODEL)
    small.map.jumps.append(pose(9.0))  # before this sieve was ever asked: nothing here remembers it
    asking.judge(question)
    small.map.jumps.extend((jump, jump))
    asking.judge(question)
    asking.judge(question)
    first, T_new_old, second, third = sieve.events
    assert (first, second, third) == (Stage.MOTION_MODEL,) * 3
    np.testing.assert_allclose(T_new_old, jump @ jump)


def test_a_sieve_without_a_memory_needs_no_word_of_one() -> None:
    class Plain:
        def judge(self, question: Question) -> Motion:
            return question.nothing_moves()

    asking = Asking(Plain(), SMALL.map)
    asking.judge(QUESTION)
    asking.remember(FRAME, np.eye(4), 3)


def test_what_was_worked_out_holds_for_the_image_and_for_poses_that_are_near() -> None:
    memory: ImageMemory[str] = ImageMemory(0.02, 0.01)
    image, other = FRAME.image, replace(FRAME.image, index=7)
    assert memory.of(image) is None
    assert memory.keep(image, np.eye(4), "found") == "found"
    assert memory.of(image) == memory.near(image, pose(0.015)) == memory.near(image, pose(turn=(0.0, 0.008, 0.0)))
    assert memory.near(image, pose(0.03)) is memory.near(image, pose(turn=(0.0, 0.02, 0.0))) is None
    assert memory.of(image) == "found", "from whatever pose"
    assert memory.of(other) is memory.near(other, np.eye(4)) is None
    memory.forget()
    assert memory.of(image) is None
