"""The paper's rule: pairs in a box go when they lie too far from the line that pairs outside the boxes draw."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from asked import ask
from building import parts
from flat_wall import in_box
from small_world import CAMERA, SCALES, SmallWorld, no_semantics, pose

from stillroom.data.frame import Frame
from stillroom.data.map import Map
from stillroom.data.matches import Matches
from stillroom.data.motion import Motion, Stage
from stillroom.data.semantics import Box, Semantics
from stillroom.dynamics.paper_epipolar import PaperEpipolarConfig, PaperEpipolarSieve
from stillroom.geometry import se3
from stillroom.schedule import Done

WORLD = SmallWorld.of(3, 700, near_m=1.2)
THEN, NOW = pose(), pose(0.12, -0.05, 0.03, turn=(0.01, -0.02, 0.015))
BOX = Box(200, 0, 419, 479, "person", 0.9)
CROWD = Semantics(480, 640, (BOX,))


@dataclass(frozen=True)
class Pair:
    """Two looks at one world: the present frame, and where its keypoints were before."""

    frame: Frame
    matches: Matches
    T_world_now: np.ndarray

    @property
    def inside(self) -> np.ndarray:
        """Which keypoints lie in the box."""
        return in_box(self.frame, BOX)

    def moved(self, keypoints: np.ndarray, by_px: float) -> "Pair":
        """Shift keypoints (K,) at right angles to their epipolar lines."""
        px = self.frame.keypoints.px.copy()
        px[keypoints] += (by_px * normals(self.matches.reference_px[keypoints], self.T_world_now)).astype(np.float32)
        return replace(self, frame=replace(self.frame, keypoints=replace(self.frame.keypoints, px=px)))

    def ask(
        self,
        stage: Stage = Stage.MOTION_MODEL,
        sieve: PaperEpipolarSieve | None = None,
        matches: Matches | None = None,
        semantics: Semantics = CROWD,
    ) -> Motion:
        sieve = sieve or PaperEpipolarConfig().build(parts())
        matches = matches or self.matches
        return ask(sieve, stage, self.frame, matches, Done(semantics), np.eye(4), Map(SCALES))


def normals(then_px: np.ndarray, T_world_now: np.ndarray) -> np.ndarray:
    """Unit normals (N, 2) of the epipolar lines in the present image: each through two places of its point's ray."""
    T_now_then = np.linalg.inv(T_world_now) @ THEN
    ends = [
        CAMERA.project(se3.transform(T_now_then, CAMERA.back_project(then_px, np.full(len(then_px), z_m))))
        for z_m in (1.0, 9.0)
    ]
    along = ends[1] - ends[0]
    return np.stack((-along[:, 1], along[:, 0]), axis=1) / np.linalg.norm(along, axis=1, keepdims=True)


def static_pair(T_world_now: np.ndarray = NOW) -> Pair:
    """All stands still, without noise."""
    before, before_seen = WORLD.look(THEN, seed=1, index=6)
    now, now_seen = WORLD.look(T_world_now, seed=2, index=7)
    place = {int(point): k for k, point in enumerate(before_seen)}
    known = np.array([int(point) in place for point in now_seen])
    columns = {name: getattr(now.keypoints, name)[known] for name in vars(now.keypoints)}
    now = replace(now, keypoints=replace(now.keypoints, **columns), is_static=now.is_static[known])
    reference_px = before.keypoints.px[[place[int(point)] for point in now_seen[known]]]
    number = np.arange(len(now), dtype=np.int32)
    return Pair(now, Matches(number, number, reference_px), T_world_now)


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
