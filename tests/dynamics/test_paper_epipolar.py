"""The constraint of section 2.2: pairs in a box go where they are off the line that pairs outside boxes draw."""

from dataclasses import replace

import numpy as np
import pytest
from building import parts
from small_world import no_semantics, pose
from two_looks import CROWD, Pair, static_pair

from stillroom.data.motion import Stage
from stillroom.data.semantics import Box, Semantics
from stillroom.dynamics.paper_epipolar import PRINTED, PaperEpipolarConfig

PAIR = static_pair()
INSIDE = np.flatnonzero(PAIR.inside)
MOVED = INSIDE[::4]


def expected(moved: np.ndarray) -> np.ndarray:
    is_static = np.ones(len(PAIR.frame), np.bool_)
    is_static[moved] = False
    return is_static


def test_the_pair_is_worth_asking_about() -> None:
    assert len(MOVED) > 30
    assert len(PAIR.frame) - len(INSIDE) > 200


def test_what_moved_in_a_box_goes_and_what_stood_still_stays() -> None:
    motion = PAIR.moved(MOVED, 6.0).ask()
    np.testing.assert_array_equal(motion.is_static, expected(MOVED))
    np.testing.assert_array_equal(motion.moving, CROWD.movable)
    assert PAIR.ask().is_static.all()


@pytest.mark.parametrize(
    ("by_px", "motion_model", "keyframe"),
    [(0.8, True, True), (1.2, False, True), (1.8, False, True), (2.2, False, False)],
)
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_the_threshold_is_tighter_in_the_motion_model_stage(
    by_px: float, motion_model: bool, keyframe: bool, side: float
) -> None:
    pair = PAIR.moved(MOVED, side * by_px)
    for stage, stays in ((Stage.MOTION_MODEL, motion_model), (Stage.REFERENCE_KEYFRAME, keyframe)):
        np.testing.assert_array_equal(pair.ask(stage).is_static, expected(MOVED[:0] if stays else MOVED))


def test_the_distance_is_that_in_the_present_image() -> None:
    """The camera went forward: all is larger now, and what is too far from its line now was nearer to it before."""
    pair = static_pair(pose(0.02, 0.01, 0.6))
    moved = np.flatnonzero(pair.inside)[::4]
    assert pair.moved(moved, 0.8).ask().is_static.all()
    np.testing.assert_array_equal(np.flatnonzero(~pair.moved(moved, 1.2).ask().is_static), moved)


def test_outside_the_boxes_nothing_is_judged_and_nothing_misleads() -> None:
    """A tenth of the pairs outside moved as well, unseen by any detector: the robust estimate does without them."""
    outside = np.flatnonzero(~PAIR.inside)[::10]
    motion = PAIR.moved(outside, 8.0).moved(MOVED, 6.0).ask()
    np.testing.assert_array_equal(motion.is_static, expected(MOVED))


def test_the_matrix_comes_from_outside_the_boxes() -> None:
    """All in the box moves as one, in greater number than what stands still outside: it is not to be believed."""
    few = np.flatnonzero(~PAIR.inside)[: len(INSIDE) // 3]
    chosen = np.sort(np.concatenate((INSIDE, few)))
    motion = PAIR.moved(INSIDE, 5.0).ask(matches=PAIR.matches.keep(np.isin(PAIR.matches.keypoint, chosen)))
    np.testing.assert_array_equal(motion.is_static, expected(INSIDE))


def test_what_is_not_matched_is_not_judged() -> None:
    """The letter of the paper, and what is wrong with it."""
    half = PAIR.matches.keep(~np.isin(PAIR.matches.keypoint, MOVED[::2]))
    motion = PAIR.moved(MOVED, 6.0).ask(matches=half)
    np.testing.assert_array_equal(motion.is_static, expected(MOVED[1::2]))


def test_what_the_first_stage_removed_stays_removed_in_this_frame_only() -> None:
    sieve, moved = PaperEpipolarConfig().build(parts()), PAIR.moved(MOVED, 6.0)
    np.testing.assert_array_equal(moved.ask(Stage.MOTION_MODEL, sieve).is_static, expected(MOVED))
    unknown = replace(PAIR.matches, reference_px=np.full_like(PAIR.matches.reference_px, np.nan))
    np.testing.assert_array_equal(moved.ask(Stage.LOCAL_MAP, sieve, unknown).is_static, expected(MOVED))
    image = replace(PAIR.frame.image, index=PAIR.frame.image.index + 1)
    later = replace(PAIR, frame=replace(PAIR.frame, image=image))
    assert later.ask(Stage.LOCAL_MAP, sieve, unknown).is_static.all()


def test_a_verdict_given_is_not_changed_by_the_next_stage() -> None:
    sieve = PaperEpipolarConfig().build(parts())
    first = PAIR.ask(Stage.MOTION_MODEL, sieve)
    PAIR.moved(MOVED, 6.0).ask(Stage.REFERENCE_KEYFRAME, sieve)
    assert first.is_static.all()


@pytest.mark.parametrize(("outside", "still_inside", "off"), [(35, 5, False), (35, 4, True), (60, 0, False)])
def test_it_is_off_where_too_few_matches_would_stay(outside: int, still_inside: int, off: bool) -> None:
    still = np.setdiff1d(INSIDE, MOVED)[:still_inside]
    chosen = np.concatenate((np.flatnonzero(~PAIR.inside)[:outside], still, MOVED))
    matches = PAIR.matches.keep(np.isin(PAIR.matches.keypoint, chosen))
    motion = PAIR.moved(MOVED, 6.0).ask(matches=matches)
    np.testing.assert_array_equal(motion.is_static, expected(MOVED[:0] if off else MOVED))


def test_fewer_than_fifteen_pairs_outside_draw_no_lines() -> None:
    chosen = np.concatenate((np.flatnonzero(~PAIR.inside)[:14], INSIDE))
    matches = PAIR.matches.keep(np.isin(PAIR.matches.keypoint, chosen))
    assert PAIR.moved(MOVED, 6.0).ask(matches=matches).is_static.all()


def test_it_is_off_while_relocalizing() -> None:
    motion = PAIR.moved(MOVED, 6.0).ask(Stage.RELOCALIZATION)
    assert motion.is_static.all()
    assert not motion.moving.any()


def test_where_nothing_may_move_nothing_does() -> None:
    motion = PAIR.moved(MOVED, 6.0).ask(semantics=no_semantics().result())
    assert motion.is_static.all()
    assert not motion.moving.any()


LEFT = Box(0, 0, 199, 479, "person", 0.9)
BESIDE = Semantics(480, 640, (LEFT,))


def in_the_left(pair: Pair) -> np.ndarray:
    """Which pairs were in the box on the left in the first look (N,)."""
    x, y = pair.matches.reference_px.T
    return (x >= LEFT.x_min_px) & (x <= LEFT.x_max_px) & (y >= LEFT.y_min_px) & (y <= LEFT.y_max_px)


@pytest.mark.parametrize("keyframe", [-1, 4])
@pytest.mark.parametrize("remembers", [False, True])
def test_the_matrix_comes_from_outside_the_boxes_of_both_images(keyframe: int, remembers: bool) -> None:
    """Who was on the left has left his box, and moves with so many points that all lines would be his."""
    left, inside = in_the_left(PAIR), PAIR.inside
    others = np.flatnonzero(~left & ~inside)[:20]
    chosen = np.concatenate((np.flatnonzero(left), others, INSIDE))
    pair = PAIR.moved(np.flatnonzero(left & ~inside), 9.0)
    matches = replace(pair.matches.keep(np.isin(pair.matches.keypoint, chosen)), keyframe=keyframe)
    sieve = PaperEpipolarConfig().build(parts())
    if remembers:
        first = replace(pair.frame, image=replace(pair.frame.image, index=pair.frame.image.index - 1))
        replace(pair, frame=first).ask(sieve=sieve, semantics=BESIDE)
        sieve.remember(first, np.eye(4), keyframe)
    stage = Stage.MOTION_MODEL if keyframe < 0 else Stage.REFERENCE_KEYFRAME
    motion = pair.ask(stage, sieve, matches)
    if remembers:
        assert motion.is_static.all(), "what stands still in the box is judged by what stands still outside"
    else:
        assert np.count_nonzero(~motion.is_static[INSIDE]) > 0.3 * len(INSIDE), "judged by who left"


def test_equation_2_as_printed_rejects_nothing() -> None:
    """The same pairs, ten pixels off: the corrected distance finds all of them."""
    sieves = [PaperEpipolarConfig(distance=kind).build(parts()) for kind in ("corrected", PRINTED)]
    corrected, printed = (PAIR.moved(MOVED, 10.0).ask(sieve=sieve) for sieve in sieves)
    np.testing.assert_array_equal(corrected.is_static, expected(MOVED))
    assert printed.is_static.all()
