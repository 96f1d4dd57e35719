"""Everything movable goes, unless too little would stay."""

from dataclasses import replace

import numpy as np
import pytest
from asked import ask
from flat_wall import in_box
from small_world import SCALES, SmallWorld, no_semantics, pose

from stillroom.data.map import Map
from stillroom.data.matches import Matches
from stillroom.data.motion import Motion, Stage
from stillroom.data.semantics import Box, Semantics
from stillroom.dynamics.whole_boxes import WholeBoxesConfig
from stillroom.schedule import Done

FRAME, _ = SmallWorld.of(0, 600).look(pose())
LEFT, LOW = Box(0, 0, 299, 479, "person", 0.9), Box(250, 400, 639, 479, "dog", 0.9)
STAGES = [stage for stage in Stage if stage is not Stage.RELOCALIZATION]


def judged(semantics: Semantics, keypoints: np.ndarray | None = None, stage: Stage = Stage.LOCAL_MAP) -> Motion:
    """Ask about the frame with some keypoints matched, all where not given."""
    chosen = np.arange(len(FRAME)) if keypoints is None else keypoints
    ids = np.full(len(FRAME), -1, np.int32)
    ids[chosen] = np.arange(len(chosen))
    sieve = WholeBoxesConfig().build()
    return ask(sieve, stage, FRAME, Matches.of(ids), Done(semantics), np.eye(4), Map(SCALES))


def test_what_lies_in_any_box_goes_and_all_else_stays() -> None:
    motion = judged(Semantics(480, 640, (LEFT, LOW)))
    inside = in_box(FRAME, LEFT) | in_box(FRAME, LOW)
    assert 100 < inside.sum() < len(FRAME) - 100
    np.testing.assert_array_equal(motion.is_static, ~inside)
    pixels = np.zeros((480, 640), np.bool_)
    pixels[:, :300] = True
    pixels[400:, 250:] = True
    np.testing.assert_array_equal(motion.moving, pixels)


def test_unmatched_keypoints_are_judged_too() -> None:
    outside = np.flatnonzero(~in_box(FRAME, LEFT))
    motion = judged(Semantics(480, 640, (LEFT,)), outside)
    np.testing.assert_array_equal(motion.is_static, ~in_box(FRAME, LEFT))


def test_a_mask_counts_where_there_is_one() -> None:
    mask = np.zeros((480, 640), np.bool_)
    mask[100:200] = True
    motion = judged(Semantics(480, 640, (LEFT,), mask))
    row = np.rint(FRAME.keypoints.raw_px[:, 1])
    np.testing.assert_array_equal(motion.is_static, (row < 100) | (row > 199))
    np.testing.assert_array_equal(motion.moving, mask)


def test_boxes_are_looked_up_in_the_image_as_taken() -> None:
    shifted = replace(FRAME.keypoints, px=FRAME.keypoints.px + np.float32(40.0))
    frame, nothing = replace(FRAME, keypoints=shifted), Matches.of(np.full(len(FRAME), -1, np.int32))
    sieve = WholeBoxesConfig().build()
    motion = ask(sieve, Stage.LOCAL_MAP, frame, nothing, Done(Semantics(480, 640, (LEFT,))), np.eye(4), Map(SCALES))
    np.testing.assert_array_equal(motion.is_static, ~in_box(FRAME, LEFT))


def test_where_nothing_may_move_nothing_does() -> None:
    motion = judged(no_semantics().result())
    assert motion.is_static.all()
    assert not motion.moving.any()


@pytest.mark.parametrize("stage", STAGES)
@pytest.mark.parametrize(("outside", "inside", "off"), [(40, 30, False), (39, 30, True), (0, 20, True), (0, 19, False)])
def test_it_is_off_where_too_few_matches_would_stay(stage: Stage, outside: int, inside: int, off: bool) -> None:
    """With fewer matches than that to begin with, tracking fails either way, and the people are not to be mapped."""
    is_inside = in_box(FRAME, LEFT)
    matched = np.concatenate((np.flatnonzero(~is_inside)[:outside], np.flatnonzero(is_inside)[:inside]))
    motion = judged(Semantics(480, 640, (LEFT,)), matched, stage)
    np.testing.assert_array_equal(motion.is_static, np.ones(len(FRAME), np.bool_) if off else ~is_inside)
    assert motion.moving.any() == (not off)


def test_it_is_off_while_relocalizing() -> None:
    motion = judged(Semantics(480, 640, (LEFT,)), stage=Stage.RELOCALIZATION)
    assert motion.is_static.all()
    assert not motion.moving.any()
