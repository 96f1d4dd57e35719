"""What boxes and clusters together say of things that stand and go before a wall."""

from dataclasses import replace

import numpy as np
import pytest
from building import parts
from small_world import SmallMap, pose
from staged_things import HOME, STEP_S, WALL, Play, Thing, empty_wall, on, seen, share

from stillroom.data.clusters import PLANE, UNKNOWN
from stillroom.data.frame import Frame
from stillroom.data.motion import Stage
from stillroom.data.semantics import Box
from stillroom.dynamics.cluster_sieve import ClusterSieveConfig

CHAIR, PERSON = Thing(60, 200, 100, 200, 2.0), Thing(300, 100)
STEP_PX = 45
"""Of one who walks: a metre and a third in a second at 1.5 m."""


def walker(step: int) -> Thing:
    return Thing(200 + STEP_PX * step, 100)


@pytest.fixture
def play() -> Play:
    return Play(ClusterSieveConfig().build(parts()))


def test_what_stands_where_it_was_empty_moves_with_all_that_lies_on_it(play: Play) -> None:
    play.during(1.0, CHAIR)
    motion, frame = play.show(CHAIR, PERSON)
    assert share(motion, PERSON) == 1.0
    assert share(motion, CHAIR) == 0.0
    there = on(frame, PERSON)
    assert there.sum() > 30
    np.testing.assert_array_equal(motion.is_static, ~there)
    # Nothing but the thing: the wall beside it is a plane.
    assert motion.moving.sum() == PERSON.width * PERSON.height


def test_what_was_there_from_the_beginning_is_static(play: Play) -> None:
    for _ in range(40):
        motion, _ = play.show(CHAIR, PERSON)
        assert not motion.moving.any()
        assert motion.is_static.all()


def test_one_who_walks_moves_in_every_image(play: Play) -> None:
    play.during(1.0)
    for step in range(7):
        motion, frame = play.show(walker(step), CHAIR)
        assert share(motion, walker(step)) == 1.0
        assert not motion.is_static[on(frame, walker(step))].any()
        assert motion.is_static[~on(frame, walker(step)) & ~on(frame, CHAIR)].all()


def test_one_who_stops_is_not_static_at_once_but_after_two_to_three_seconds(play: Play) -> None:
    play.during(3.0)
    for step in range(6):
        play.show(walker(step))
    moved = [share(play.show(walker(5))[0], walker(5)) for _ in range(40)]
    assert set(moved) == {0.0, 1.0}
    still_moving = moved.index(0.0)
    assert sum(moved) == still_moving, "once static, he stays so"
    assert 2.0 <= still_moving * STEP_S <= 3.2


def test_who_walks_on_after_a_long_stop_moves_again_within_half_a_second(play: Play) -> None:
    play.during(6.0, walker(0))
    moved = [share(play.show(walker(step))[0], walker(step)) for step in range(1, 8)]
    assert moved[5:] == [1.0, 1.0]


def test_who_comes_nearer_after_a_long_stop_moves_again_within_half_a_second(play: Play) -> None:
    # All of him stays where he was in the image, with all that was believed of him.
    play.during(6.0, PERSON)
    coming = [replace(PERSON, depth_m=1.5 - 0.1 * step) for step in range(1, 6)]
    moved = [share(play.show(thing)[0], thing) for thing in coming]
    assert moved[-1] == 1.0


def test_furniture_wrongly_blamed_recovers_in_three_images(play: Play) -> None:
    _, frame = play.during(2.0, CHAIR)
    config = play.sieve.config
    clusters = seen([CHAIR], play.time_s)[1].clusters
    play.sieve._belief.remember(frame, clusters, np.array([config.limit]), HOME)
    moved = [share(play.show(CHAIR)[0], CHAIR) for _ in range(5)]
    assert moved == [1.0, 1.0, 0.0, 0.0, 0.0]


def test_keypoints_in_a_box_go_with_the_cluster_that_moves(play: Play) -> None:
    motion, frame = play.during(2.0, PERSON, boxes=[0])
    assert motion.is_static[on(frame, PERSON)].all(), "for the boxes' own sieve he has long been there"
    limit = play.sieve.config.limit
    play.sieve._belief.remember(frame, seen([PERSON], play.time_s)[1].clusters, np.array([limit]), HOME)
    motion, frame = play.show(PERSON, boxes=[0])
    assert not motion.is_static[on(frame, PERSON)].any()


def test_one_bad_image_does_not_make_furniture_move(play: Play) -> None:
    play.during(2.0, CHAIR)
    # Seen 25 cm nearer for once: a pose gone wrong, or a depth image.
    motion, _ = play.show(replace(CHAIR, depth_m=1.75))
    assert share(motion, CHAIR) == 0.0


@pytest.mark.parametrize("walks", [True, False], ids=["walking", "standing"])
def test_a_cluster_keeps_its_verdict_when_the_detector_fails(play: Play, walks: bool) -> None:
    play.during(3.0)
    for step in range(4):
        play.show(walker(step), boxes=[0])
    for step in range(4, 8):
        thing = walker(step if walks else 3)
        motion, frame = play.show(thing)
        assert share(motion, thing) == 1.0
        assert not motion.is_static[on(frame, thing)].any()


def test_who_stands_in_a_box_is_masked_though_he_never_moved(play: Play) -> None:
    motion, frame = play.during(4.0, PERSON, CHAIR, boxes=[0])
    assert share(motion, PERSON) == 1.0
    assert share(motion, CHAIR) == 0.0
    # What lies on him has been there all the time, and helps to track.
    assert motion.is_static[on(frame, PERSON)].all()


def test_in_a_box_planes_and_what_is_known_to_be_static_do_not_move(play: Play) -> None:
    behind = Thing(440, 120, 60, 100, 2.5)
    crowded = Box(280, 90, 520, 360, "person", 0.9)
    for _ in range(20):
        play.time_s += STEP_S
        frame, semantics = seen([PERSON, behind], play.time_s, boxes=[0])
        motion = play.ask(frame, replace(semantics, boxes=(crowded,)))
    assert share(motion, PERSON) == 1.0
    assert share(motion, behind) == 0.0
    assert motion.moving.sum() == PERSON.width * PERSON.height


def test_in_a_box_what_nothing_is_known_of_moves(play: Play) -> None:
    # The very first image: there is no past.
    behind = Thing(440, 120, 60, 100, 2.5)
    frame, semantics = seen([PERSON, behind, CHAIR], 1.0, boxes=[0])
    crowded = replace(semantics, boxes=(Box(280, 90, 520, 360, "person", 0.9),))
    motion = play.ask(frame, crowded)
    # Keypoints are the boxes' own sieve's: it trusts not even the wall.
    np.testing.assert_array_equal(motion.is_static, ~crowded.movable_at(frame.keypoints.raw_px))
    assert share(motion, PERSON) == share(motion, behind) == 1.0
    assert share(motion, CHAIR) == 0.0
    assert not motion.moving[seen([PERSON, behind], 1.0)[1].clusters.labels == PLANE].any()


def test_what_is_unknown_beside_a_moving_cluster_moves_too(play: Play) -> None:
    play.during(1.0, CHAIR)
    margin_px, rim_px = play.sieve.config.margin_px, 20
    motion, frame = play.show(CHAIR, PERSON, rim_px=rim_px)
    row, column = np.mgrid[:480, :640]
    y, x = PERSON.window
    off_px = np.maximum.reduce([y.start - row, row - y.stop + 1, x.start - column, column - x.stop + 1])
    np.testing.assert_array_equal(motion.moving, off_px <= margin_px)
    near = np.array([motion.moving[v, u] for u, v in np.rint(frame.keypoints.raw_px).astype(int)])
    assert (near & ~on(frame, PERSON)).sum() > 3
    np.testing.assert_array_equal(motion.is_static, ~near)


@pytest.mark.parametrize(
    ("way", "share_failing", "goes"),
    [
        ("place", 0.4, False),
        ("place", 0.5, False),
        ("place", 0.65, True),
        ("line", 0.5, False),
        ("line", 0.65, True),
        ("unknown depth", 1.0, False),
    ],
)
def test_a_cluster_goes_whole_when_more_than_half_of_its_pairs_fail(way: str, share_failing: float, goes: bool) -> None:
    # A first image: earlier ones say nothing. The thing lies on the wall, so that its pairs can hold.
    first = pose(0.25, -0.1, turn=(0.01, -0.02, 0.03))
    play = Play(ClusterSieveConfig().build(parts()), small=SmallMap.of(WALL, [first, HOME]))
    thing = Thing(200, 80, 250, 300, 3.0)
    frame, semantics = seen([thing], 1.0)
    rng = np.random.default_rng(3)
    _, points = empty_wall()
    there = np.flatnonzero(on(frame, thing) & (play.small.map.points.first_keyframe[play.small.id_of[points]] == 0))
    pairs = rng.permutation(there)[:40]
    failing = pairs[: round(40 * share_failing)]
    frame = spoilt(frame, failing, way)
    chosen = np.isin(np.arange(len(frame)), pairs) | ~on(frame, thing)
    motion = play.ask(frame, semantics, matched=lambda _: chosen)
    assert share(motion, thing) == float(goes)
    assert len(there) > 60, "there are keypoints without a pair on it too"
    np.testing.assert_array_equal(motion.is_static[on(frame, thing)], not goes)
    assert motion.is_static[~on(frame, thing)].all()


def spoilt(frame: Frame, keypoints: np.ndarray, way: str) -> Frame:
    """Let keypoints (K,) lie 20 cm nearer than their map points, or without depth, and then maybe aside too."""
    kp = frame.keypoints
    depth_m, px = kp.depth_m.copy(), kp.px.copy()
    if way == "place":
        depth_m[keypoints] -= 0.2
    else:
        depth_m[keypoints] = 0.0
    if way == "line":
        # The lines of these two cameras go up to the right.
        aside_px = frame.scales.factors[kp.octave[keypoints], None] * np.array([4.0, 10.0])
        px[keypoints] += aside_px.astype(np.float32)
    return replace(frame, keypoints=replace(kp, px=px, depth_m=depth_m))


def test_a_few_pairs_say_nothing(play: Play) -> None:
    thing = Thing(200, 80, 250, 300, 3.0)
    frame, semantics = seen([thing], 1.0)
    pairs = np.flatnonzero(on(frame, thing))[: play.sieve.config.min_pairs - 1]
    chosen = np.isin(np.arange(len(frame)), pairs) | ~on(frame, thing)
    motion = play.ask(spoilt(frame, pairs, "place"), semantics, matched=lambda _: chosen)
    assert not motion.moving.any()


def test_nothing_is_rejected_while_relocalizing(play: Play) -> None:
    play.during(1.0)
    motion, _ = play.show(PERSON, boxes=[0], stage=Stage.RELOCALIZATION)
    assert motion.is_static.all()
    assert not motion.moving.any()


@pytest.mark.parametrize("stage", [Stage.MOTION_MODEL, Stage.REFERENCE_KEYFRAME, Stage.RELOCALIZATION])
def test_only_the_last_stage_is_remembered(stage: Stage) -> None:
    plays = [Play(ClusterSieveConfig().build(parts())) for _ in range(2)]
    for one in plays:
        one.during(1.0, CHAIR)
    # One is asked in passing, and sees the chair nearer, under poses that will not hold.
    for k in range(8):
        frame, semantics = seen([replace(CHAIR, depth_m=1.7), PERSON], plays[0].time_s + STEP_S / 2)
        plays[0].ask(frame, semantics, stage, T_world_cam=pose(0.05 * k))
    for _ in range(8):
        first, second = (one.show(CHAIR, PERSON)[0] for one in plays)
        np.testing.assert_array_equal(first.moving, second.moving)
        np.testing.assert_array_equal(first.is_static, second.is_static)
        assert share(first, PERSON) == 1.0


def test_the_same_image_under_a_better_pose_is_judged_anew() -> None:
    plays = [Play(ClusterSieveConfig().build(parts())) for _ in range(2)]
    for one in plays:
        one.during(1.0, CHAIR)
    frame, semantics = seen([CHAIR], plays[0].time_s + STEP_S)
    wrong = plays[0].ask(frame, semantics, Stage.MOTION_MODEL, T_world_cam=pose(0.0, 0.0, -0.4))
    first, second = (one.ask(frame, semantics) for one in plays)
    assert (share(wrong, CHAIR), share(first, CHAIR), share(second, CHAIR)) == (1.0, 0.0, 0.0)
    beliefs = [one.sieve._belief._last.belief for one in plays]
    np.testing.assert_array_equal(*beliefs)


@pytest.mark.parametrize("stage", [Stage.MOTION_MODEL, Stage.REFERENCE_KEYFRAME])
def test_each_stage_knows_of_the_past(play: Play, stage: Stage) -> None:
    play.during(1.0, CHAIR)
    motion, frame = play.show(CHAIR, PERSON, stage=stage)
    assert share(motion, PERSON) == 1.0
    assert share(motion, CHAIR) == 0.0
    np.testing.assert_array_equal(motion.is_static, ~on(frame, PERSON))


@pytest.mark.parametrize(("n_left", "off"), [(39, True), (40, False)])
def test_it_is_off_where_too_few_matches_would_stay(play: Play, n_left: int, off: bool) -> None:
    play.during(1.0)

    def matched(frame: Frame) -> np.ndarray:
        on_wall = np.flatnonzero(~on(frame, PERSON))[:n_left]
        return on(frame, PERSON) | np.isin(np.arange(len(frame)), on_wall)

    motion, frame = play.show(PERSON, matched=matched)
    assert motion.moving.any() == (not off)
    assert motion.is_static[on(frame, PERSON)].all() == off


def test_where_there_were_too_few_matches_from_the_start_it_stays_on(play: Play) -> None:
    play.during(1.0)
    motion, frame = play.show(PERSON, matched=lambda frame: np.arange(len(frame)) < 10)
    assert not motion.is_static[on(frame, PERSON)].any()


def test_without_clusters_the_boxes_decide_alone() -> None:
    config = ClusterSieveConfig()
    whole, boxes = Play(config.build(parts())), Play(config.boxes.build())
    for step in range(12):
        frame, semantics = seen([PERSON] if step > 8 else [CHAIR], 1.0 + step * STEP_S, boxes=[0])
        first, second = (play.ask(frame, replace(semantics, clusters=None)) for play in (whole, boxes))
        np.testing.assert_array_equal(first.is_static, second.is_static)
        np.testing.assert_array_equal(first.moving, second.moving)
    assert not first.is_static[on(frame, PERSON)].any()


def test_the_scene_has_what_it_is_asked_about() -> None:
    frame, semantics = seen([CHAIR, PERSON], 1.0, boxes=[1], rim_px=10)
    labels = semantics.clusters.labels
    assert {int(label) for label in np.unique(labels)} == {PLANE, UNKNOWN, 0, 1}
    assert semantics.clusters.box.tolist() == [-1, 0]
    assert on(frame, CHAIR).sum() > 20
    assert np.all(frame.keypoints.depth_m[on(frame, PERSON)] == np.float32(PERSON.depth_m))


@pytest.mark.parametrize(("limit_rad_s", "moves"), [(1e3, True), (0.5, False)])
def test_while_the_camera_turns_fast_nothing_is_evidence_for_motion(limit_rad_s: float, moves: bool) -> None:
    """By the pose the camera turned by 0.1 rad in a tenth of a second; depth lags behind, and shows no turn."""
    play = Play(ClusterSieveConfig(max_turn_rad_s=limit_rad_s).build(parts()))
    play.during(2.0)
    turned = pose(turn=(0.0, 0.1, 0.0))
    motion, _ = play.show(CHAIR, T_world_cam=turned)
    assert bool(motion.moving.any()) == moves


def test_a_slow_turn_hides_nobody() -> None:
    play = Play(ClusterSieveConfig(max_turn_rad_s=0.5).build(parts()))
    play.during(2.0, CHAIR)
    assert share(play.show(CHAIR, PERSON)[0], PERSON) == 1.0


def test_keypoints_count_as_much_as_their_cluster_is_likely_to_stay() -> None:
    config = ClusterSieveConfig(weighted=True)
    play = Play(config.build(parts()))
    assert Play(ClusterSieveConfig().build(parts())).show(CHAIR)[0].p_static is None
    for _ in range(40):
        motion, frame = play.show(CHAIR)
    assert motion.p_static is not None
    assert motion.p_static.dtype == np.float32
    stays = on(frame, CHAIR)
    # Seen where it is for longer than the history reaches: log-odds at their least.
    np.testing.assert_allclose(motion.p_static[stays], 1.0 / (1.0 + np.exp(-config.limit)), rtol=1e-6)
    np.testing.assert_array_equal(motion.p_static[~stays], 1.0)  # the wall is no cluster
    motion, frame = play.show(CHAIR, PERSON)
    assert motion.p_static is not None
    assert motion.p_static[on(frame, PERSON)].max() < 0.5
