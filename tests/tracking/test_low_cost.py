"""Low-cost tracking: a pose from what the last frame saw, found before tracking proper, and asked about once."""

from dataclasses import replace

import numpy as np
import pytest
from building import parts
from small_world import SmallMap, SmallWorld, no_semantics, pose

from stillroom.config import SlamConfig
from stillroom.data.matches import Matches
from stillroom.data.motion import Motion, Stage
from stillroom.data.question import Question
from stillroom.data.result import Tracked, TrackingState
from stillroom.datasets.open import open_dataset
from stillroom.dynamics.chain import KeepAllMatches
from stillroom.geometry import se3
from stillroom.presets.registry import configure
from stillroom.protocols import MatchSieve
from stillroom.system import build
from stillroom.tracking.low_cost import LowCostConfig, NoLowCostConfig

WAS, IS = pose(), pose(0.04, -0.01, 0.02, turn=(0.01, -0.02, 0.01))


class Noting(KeepAllMatches):
    """Keeps all, and what it was asked."""

    def __init__(self) -> None:
        self.asked: list[tuple[Stage, int, Matches, np.ndarray]] = []

    def judge(self, question: Question) -> Motion:
        q = question
        self.asked.append((q.stage, q.frame.image.index, q.matches, q.T_cam_world.copy()))
        return super().judge(question)


@pytest.fixture(scope="module")
def small() -> SmallMap:
    return SmallMap.of(SmallWorld.of(0), [WAS])


def last_of(small: SmallMap) -> Tracked:
    """The last frame: the keyframe itself, with all its points."""
    frame = small.frames[0]
    ids = small.id_of[small.seen[0]]
    nothing = Motion.none(len(frame), frame.image.height, frame.image.width)
    return Tracked(frame, TrackingState.OK, WAS, ids, nothing, 0)


def test_it_finds_the_pose_and_asks_the_sieve_under_it(small: SmallMap) -> None:
    frame, seen = small.world.look(IS, seed=5, index=1)
    sieve = Noting()
    quick = LowCostConfig().build(parts(), sieve)
    T_cam_world = quick.localize(frame, last_of(small), se3.inverse(WAS), no_semantics(), small.map)
    np.testing.assert_allclose(T_cam_world, se3.inverse(IS), atol=1e-4)
    ((stage, index, matches, asked_under),) = sieve.asked
    assert (stage, index) == (Stage.LOW_COST, 1)
    np.testing.assert_array_equal(asked_under, T_cam_world)
    np.testing.assert_array_equal(small.id_of[seen[matches.keypoint]], matches.point_id)
    assert len(matches) > 300


def test_what_sieve_1_dropped_is_not_used(small: SmallMap) -> None:
    frame, _ = small.world.look(IS, seed=5, index=1)
    masked = frame.keypoints.px[:, 0] < 320
    sieve = Noting()
    quick = LowCostConfig().build(parts(), sieve)
    quick.localize(frame.with_static(~masked), last_of(small), se3.inverse(WAS), no_semantics(), small.map)
    assert len(sieve.asked[0][2]) > 100
    assert not masked[sieve.asked[0][2].keypoint].any()


def test_people_who_walk_do_not_bend_the_pose_nor_are_they_shown_to_the_sieve(small: SmallMap) -> None:
    """A quarter of the keypoints has gone along with somebody."""
    frame, seen = small.world.look(IS, seed=5, index=1)
    went = frame.keypoints.px[:, 0] < 160
    px = frame.keypoints.px + np.where(went, 9.0, 0.0)[:, None].astype(np.float32)
    moved = replace(frame, keypoints=replace(frame.keypoints, px=px, raw_px=px))
    sieve = Noting()
    T_cam_world = (
        LowCostConfig()
        .build(parts(), sieve)
        .localize(moved, last_of(small), se3.inverse(WAS), no_semantics(), small.map)
    )
    np.testing.assert_allclose(T_cam_world, se3.inverse(IS), atol=2e-3)
    matches = sieve.asked[0][2]
    right = small.id_of[seen[matches.keypoint]] == matches.point_id
    assert not (went[matches.keypoint] & right).any()


@pytest.mark.parametrize("away_m", [0.08, 3.0])
def test_a_poor_guess_is_looked_around_more_widely_and_a_hopeless_one_left_as_it_is(
    small: SmallMap, away_m: float
) -> None:
    frame, _ = small.world.look(IS, seed=5, index=1)
    guess = se3.inverse(pose(away_m) @ IS)
    sieve = Noting()
    found = LowCostConfig().build(parts(), sieve).localize(frame, last_of(small), guess, no_semantics(), small.map)
    if away_m < 1.0:
        np.testing.assert_allclose(found, se3.inverse(IS), atol=1e-3)
        assert [question[0] for question in sieve.asked] == [Stage.LOW_COST]
    else:
        np.testing.assert_array_equal(found, guess)
        assert not sieve.asked, "under a guess nothing can be told"


def test_without_it_the_guess_is_the_start(small: SmallMap) -> None:
    frame, _ = small.world.look(IS, seed=5, index=1)
    sieve = Noting()
    guess = se3.inverse(pose(0.01))
    found = NoLowCostConfig().build(parts(), sieve).localize(frame, last_of(small), guess, no_semantics(), small.map)
    assert found is guess
    assert not sieve.asked


class Shared:
    """A config that gives everybody the same sieve."""

    def __init__(self) -> None:
        self.sieve = Noting()

    def build(self, seed: int) -> MatchSieve:
        return self.sieve


@pytest.mark.parametrize(
    "low_cost", [configure(name).low_cost for name in ("orb-slam2", "dynaslam")], ids=["without", "with"]
)
def test_sieve_2_is_asked_there_before_all_other_stages(low_cost: LowCostConfig | NoLowCostConfig) -> None:
    shared, dataset = Shared(), open_dataset("synthetic:empty")
    system = build(SlamConfig(dynamics=shared, low_cost=low_cost), dataset.camera)  # type: ignore[arg-type]
    for place in range(5):
        system.process(dataset.load(place))
    stages = {index: [asked[0] for asked in shared.sieve.asked if asked[1] == index] for index in range(5)}
    assert stages[0] == [Stage.LOCAL_MAP]
    assert stages[1] == [Stage.REFERENCE_KEYFRAME, Stage.LOCAL_MAP], "no velocity is known yet"
    proper = [Stage.MOTION_MODEL, Stage.LOCAL_MAP]
    for index in (2, 3, 4):
        assert stages[index] == (proper if isinstance(low_cost, NoLowCostConfig) else [Stage.LOW_COST, *proper])
    under = {asked[:2]: asked[3] for asked in shared.sieve.asked}
    if isinstance(low_cost, LowCostConfig):
        np.testing.assert_array_equal(under[Stage.LOW_COST, 4], under[Stage.MOTION_MODEL, 4])
        drift_m = under[Stage.LOW_COST, 4] @ se3.inverse(under[Stage.LOCAL_MAP, 4])
        assert np.linalg.norm(drift_m[:3, 3]) < 0.02
