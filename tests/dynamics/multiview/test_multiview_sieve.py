"""The sieve on rendered and real frames, its variants, and what it remembers."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from asked import ask, remember
from building import parts
from flat_wall import before_the_wall
from small_world import CAMERA, SCALES, SmallWorld, no_semantics, pose

from stillroom.config import SlamConfig
from stillroom.data.map import Map
from stillroom.data.matches import Matches
from stillroom.data.motion import Motion, Stage
from stillroom.data.result import FrameResult, Tracked
from stillroom.data.semantics import Box, Instance, Semantics
from stillroom.datasets.open import open_dataset
from stillroom.datasets.selection import select
from stillroom.dynamics.ants.search import papers_search
from stillroom.dynamics.multiview.multiview_geometry import DYNAMIC, UNSEEN, AlongPath
from stillroom.dynamics.multiview.multiview_sieve import (
    CodeMultiViewConfig,
    MultiViewConfig,
    MultiViewSieve,
    PaperMultiViewConfig,
    without_found,
)
from stillroom.dynamics.multiview.views import KeyframesConfig, KeyframeViews
from stillroom.errors import ConfigError
from stillroom.features.orb import OrbConfig
from stillroom.geometry import se3
from stillroom.geometry.pixels import Shape, grown
from stillroom.protocols import Parts
from stillroom.schedule import Done
from stillroom.system import build

BY_GEOMETRY = MultiViewConfig(network=False)
FIGURE = Box(200, 100, 330, 400, "person", 1.0)
WORLD = SmallWorld.of(0, 600, near_m=3.0, far_m=3.0)


class Judge:
    """Counts pixels and keypoints against the renderer's truth, from when there are keyframes to be held against."""

    def __init__(self, first: int = 12) -> None:
        self.first, self.pixels, self.points, self.shares = first, np.zeros(3), np.zeros(3), []
        self.objects = np.zeros(2)

    def on_frame(self, tracked: Tracked, semantics: Semantics, result: FrameResult) -> None:
        image, motion = tracked.frame.image, tracked.motion
        self.shares.append(motion.moving.mean())
        if image.truth is None or image.index < self.first:
            return
        true, found = image.truth.movable, motion.moving
        # Twelve pixels around figures may go with them: depth ends there ragged, and masks are widened.
        near = cv2.dilate(true.view(np.uint8), np.ones((25, 25), np.uint8)).astype(bool) & ~true
        self.pixels += (true & found).sum(), (~true & ~near & found).sum(), (true & ~found).sum()
        column, row = np.rint(tracked.frame.keypoints.raw_px).astype(int).T
        rejected = ~motion.is_static
        on, beside = true[row, column], near[row, column]
        self.points += (on & rejected).sum(), (~on & ~beside & rejected).sum(), (on & ~rejected).sum()
        for box in image.truth.boxes:
            if box.label != "person":
                x0, y0, x1, y1 = (int(edge) for edge in box.xyxy_px)
                inside = np.zeros_like(true)
                inside[y0 : y1 + 1, x0 : x1 + 1] = True
                self.objects += (found & true & inside).sum(), (true & inside).sum()

    @staticmethod
    def precision(counts: np.ndarray) -> float:
        return counts[0] / max(1, counts[0] + counts[1])

    @staticmethod
    def recall(counts: np.ndarray) -> float:
        return counts[0] / max(1, counts[0] + counts[2])


def judged(spec: str, chosen: str, config: MultiViewConfig = BY_GEOMETRY) -> Judge:
    """Track a sequence with the sieve and nobody to say what may move."""
    dataset, judge = select(open_dataset(spec), chosen), Judge()
    system = build(SlamConfig(dynamics=config), dataset.camera, observer=judge)
    for place in range(len(dataset)):
        system.process(dataset.load(place))
    return judge


@pytest.mark.parametrize(
    ("spec", "chosen", "recall", "objects"),
    [
        ("synthetic:walking", "0:180:3", 0.95, None),
        # Who stands still or has not been seen through counts as a mover in the truth.
        ("synthetic:carried", "30:270:4", 0.7, 0.8),
        # A chair that is pushed by less than its own size stands, in part, where it stood.
        ("synthetic:pushed", "0:240:4", 0.6, 0.4),
    ],
)
def test_what_moves_is_found_without_a_detector(spec: str, chosen: str, recall: float, objects: float | None) -> None:
    judge = judged(spec, chosen)
    assert judge.precision(judge.pixels) > 0.97
    assert judge.recall(judge.pixels) > recall
    assert judge.precision(judge.points) > 0.97
    assert judge.recall(judge.points) > recall - 0.05
    if objects is not None:
        assert judge.objects[1] > 0
        assert judge.objects[0] / judge.objects[1] > objects


def test_where_nothing_moves_nothing_is_found() -> None:
    judge = judged("synthetic:loop,frames=240", "0:120:2")
    assert np.mean(judge.shares) < 0.002


def test_a_real_camera_that_turns_fast_finds_next_to_nothing(freiburg1: Path) -> None:
    judge = judged(str(freiburg1), "0:90")
    assert np.mean(judge.shares) < 0.002


@pytest.mark.parametrize("config", [PaperMultiViewConfig(network=False), CodeMultiViewConfig(network=False)])
def test_the_papers_and_the_codes_numbers_find_movers_too(config: MultiViewConfig) -> None:
    judge = judged("synthetic:walking", "0:180:3", config)
    assert judge.recall(judge.pixels) > 0.6
    ours = judged("synthetic:walking", "0:180:3")
    assert judge.precision(judge.pixels) < ours.precision(ours.pixels)


def test_the_numbers_are_those_of_the_reference() -> None:
    paper, code = PaperMultiViewConfig().test, CodeMultiViewConfig().test
    for test in (paper, code):
        assert (test.max_parallax_deg, test.window_px, test.mean_m, test.far_m) == (30.0, 20, 0.2, 7.0)
        assert test.patch_std_m**2 == pytest.approx(0.001)
        assert (test.keyframes.kept, test.keyframes.asked, test.keyframes.far_m) == (20, 5, 6.0)
        assert test.tau_per_m == test.patch_std_per_m == test.mean_per_m == 0.0
        assert not test.seen_through
    assert (paper.tau_m, code.tau_m) == (0.4, 0.6)
    assert (paper.keyframes.choice, code.keyframes.choice) == ("nearest", "farthest")
    assert (paper.parallax_of_translations, code.parallax_of_translations) == (False, True)
    assert (PaperMultiViewConfig().combination, CodeMultiViewConfig().combination) == ("geometry-first", "union")
    assert PaperMultiViewConfig().dilation_px == CodeMultiViewConfig().dilation_px == 15


# A wall, seen by a keyframe; then somebody stands before it.


def asked(
    config: MultiViewConfig, semantics: Semantics | None = None, stage: Stage = Stage.LOCAL_MAP, z_m: float = 1.5
) -> tuple[Motion, MultiViewSieve]:
    sieve, world = config.build(), Map(SCALES)
    nothing = Matches.of(np.full(0, -1, np.int32))
    for index in range(2):
        frame, _ = WORLD.look(pose(0.02 * index), index=index)
        T_world_cam = pose(0.02 * index)
        frame = before_the_wall(frame, T_world_cam, FIGURE if index else None, z_m)
        of_it = Done(semantics) if index and semantics is not None else no_semantics()
        at = stage if index else Stage.LOCAL_MAP
        motion = ask(sieve, at, frame, nothing, of_it, se3.inverse(T_world_cam), world)
        if index == 0:
            unseen = np.full(len(frame), -1, np.int32)
            keyframe = world.add_keyframe(frame, T_world_cam, unseen, motion.is_static, parent=-1)
            remember(sieve, frame, se3.inverse(T_world_cam), keyframe, world)
    return motion, sieve


def square(box: Box) -> np.ndarray:
    pixels = np.zeros((CAMERA.height, CAMERA.width), np.bool_)
    x0, y0, x1, y1 = (int(edge) for edge in box.xyxy_px)
    pixels[y0 : y1 + 1, x0 : x1 + 1] = True
    return pixels


def test_who_came_is_found_to_the_pixel() -> None:
    motion, _ = asked(replace(BY_GEOMETRY, dilation_px=0))
    wrong = motion.moving ^ square(FIGURE)
    edge = cv2.morphologyEx(square(FIGURE).view(np.uint8), cv2.MORPH_GRADIENT, np.ones((7, 7), np.uint8))
    assert not (wrong & (edge == 0)).any()


@pytest.mark.parametrize("stage", [Stage.MOTION_MODEL, Stage.REFERENCE_KEYFRAME])
def test_geometry_waits_for_a_pose(stage: Stage) -> None:
    motion, _ = asked(BY_GEOMETRY, stage=stage)
    assert motion.is_static.all()
    assert not motion.moving.any()


@pytest.mark.parametrize("away_m", [0.0, 0.01, 0.3])
def test_what_low_cost_tracking_found_holds_as_long_as_its_pose_does(away_m: float) -> None:
    sieve, world, nothing = BY_GEOMETRY.build(), Map(SCALES), Matches.of(np.full(0, -1, np.int32))
    empty, _ = WORLD.look(pose(), index=0)
    empty = before_the_wall(empty, pose(), None, 1.5)
    ask(sieve, Stage.LOCAL_MAP, empty, nothing, no_semantics(), np.eye(4), world)
    keyframe = world.add_keyframe(empty, np.eye(4), np.full(len(empty), -1, np.int32), empty.is_static, parent=-1)
    remember(sieve, empty, np.eye(4), keyframe, world)
    frame, _ = WORLD.look(pose(), index=1)
    frame = before_the_wall(frame, pose(), FIGURE, 1.5)
    quick = ask(sieve, Stage.LOW_COST, frame, nothing, no_semantics(), np.eye(4), world)
    assert quick.moving.any(), "geometry is asked there"
    later = ask(sieve, Stage.MOTION_MODEL, frame, nothing, no_semantics(), pose(away_m), world)
    assert later.moving.any() == (away_m < 0.05)
    asked_anew, sieve.geometry.mask = [], lambda *question: asked_anew.append(question)  # type: ignore[method-assign]
    final = ask(sieve, Stage.LOCAL_MAP, frame, nothing, no_semantics(), pose(away_m), world)
    assert len(asked_anew) == (away_m > 0.05)
    np.testing.assert_array_equal(final.moving, later.moving)


def test_network_geometry_and_both() -> None:
    elsewhere = Box(400, 100, 500, 300, "person", 1.0)
    semantics = Semantics(CAMERA.height, CAMERA.width, (elsewhere,))
    n, _ = asked(MultiViewConfig(geometry=False, dilation_px=0), semantics)
    np.testing.assert_array_equal(n.moving, square(elsewhere))
    g, _ = asked(MultiViewConfig(network=False, dilation_px=0), semantics)
    both, _ = asked(MultiViewConfig(dilation_px=0), semantics)
    np.testing.assert_array_equal(both.moving, n.moving | g.moving)
    assert g.moving.any()
    assert not (g.moving & n.moving).any()
    wide, _ = asked(MultiViewConfig(), semantics)
    # The segmenter has grown its own mask.
    np.testing.assert_array_equal(wide.moving, n.moving | grown(g.moving, MultiViewConfig().dilation_px, Shape.ELLIPSE))


def test_geometrys_mask_stands_for_a_networks_of_the_same_thing() -> None:
    network = np.zeros((60, 80), np.bool_)
    network[10:30, 10:30] = True  # found by both
    network[10:30, 50:60] = True  # by the network alone
    found = np.zeros_like(network)
    found[12:28, 14:26] = True
    known = Semantics(60, 80, mask=network)
    kept = without_found(known, found, 0.3)
    expected = network.copy()
    expected[:, :40] = False
    np.testing.assert_array_equal(kept, expected)
    np.testing.assert_array_equal(without_found(known, np.zeros_like(found), 0.3), network)


def test_geometry_stands_for_one_of_two_people_who_touch_where_they_are_told_apart() -> None:
    left, right = np.zeros((2, 60, 80), np.bool_)
    left[10:30, 10:30] = True
    right[10:30, 30:50] = True
    together = left | right
    told_apart = Semantics(60, 80, mask=together, instances=(Instance.of(left, "person"), Instance.of(right, "person")))
    np.testing.assert_array_equal(without_found(told_apart, left, 0.6), right)
    np.testing.assert_array_equal(without_found(Semantics(60, 80, mask=together), left, 0.6), together)


def test_the_past_is_bounded_and_of_keyframes_only() -> None:
    config = KeyframesConfig(kept=3)
    views, world = KeyframeViews(config), Map(SCALES)
    nothing = np.zeros((CAMERA.height, CAMERA.width), np.bool_)
    for index in range(12):
        frame, _ = WORLD.look(pose(), index=index)
        frame = before_the_wall(frame, pose())
        keyframe = -1
        if index % 2 == 0:
            unseen = np.full(len(frame), -1, np.int32)
            keyframe = world.add_keyframe(frame, pose(), unseen, np.ones(len(frame), np.bool_), parent=-1)
        views.note(frame, np.eye(4), nothing, keyframe)
        if index == 4:
            after_three = views.n_bytes
    assert len(views) == 3
    assert views.n_bytes <= 1.05 * after_three < 4e6
    assert views.ask(np.eye(4), Map(SCALES)) is None  # another map knows none of them


@pytest.mark.parametrize(("choice", "chosen"), [("nearest", [5, 6, 7]), ("farthest", [0, 1, 2]), ("spread", [0, 4, 7])])
def test_keyframes_are_chosen_by_pose_or_over_time(choice: str, chosen: list[int]) -> None:
    views, world = KeyframeViews(KeyframesConfig(asked=3, choice=choice)), Map(SCALES)
    nothing = np.zeros((CAMERA.height, CAMERA.width), np.bool_)
    for index in range(9):
        # The last looks away and never counts.
        T_world_cam = pose(0.1 * index, turn=(0.0, 1.2, 0.0)) if index == 8 else pose(0.1 * index)
        frame, _ = WORLD.look(T_world_cam, index=index)
        frame = before_the_wall(frame, pose(0.1 * index))
        unseen = np.full(len(frame), -1, np.int32)
        keyframe = world.add_keyframe(frame, T_world_cam, unseen, np.ones(len(frame), np.bool_), parent=-1)
        views.note(frame, se3.inverse(T_world_cam), nothing, keyframe)
    asked_views = views.ask(pose(0.75), world)
    assert asked_views is not None
    np.testing.assert_allclose(asked_views.T_world_cam[:, 0, 3], 0.1 * np.array(chosen))


def test_depth_is_displaced_when_the_camera_turns() -> None:
    views = KeyframeViews(KeyframesConfig(apart_s=0.02))
    nothing = np.zeros((CAMERA.height, CAMERA.width), np.bool_)
    first, _ = WORLD.look(pose(), index=0)
    second, _ = WORLD.look(pose(), index=3)
    assert views.displaced_px(first, np.eye(4)) == 0.0
    views.note(first, np.eye(4), nothing)
    T_cam_world = se3.exp(np.array([0.3, 0.0, 0.0, 0.0, 0.1, 0.0]))  # 0.1 rad in 0.1 s: 1 rad/s
    assert views.displaced_px(second, T_cam_world) == pytest.approx(0.02 * CAMERA.fx * 1.0)
    views.note(second, T_cam_world, nothing)
    assert views.displaced_px(second, T_cam_world) == pytest.approx(0.02 * CAMERA.fx * 1.0)


def test_a_map_that_jumps_is_no_turn_of_the_camera() -> None:
    views, jump = KeyframeViews(KeyframesConfig(apart_s=0.02)), pose(0.7, -0.2, 0.4, turn=(0.1, 0.5, -0.2))
    views.follow(jump)
    first, _ = WORLD.look(pose(), index=0)
    second, _ = WORLD.look(pose(), index=3)
    views.note(first, np.eye(4), np.zeros((CAMERA.height, CAMERA.width), np.bool_))
    turned = se3.inverse(pose(0.3, turn=(0.0, 0.1, 0.0)))
    before_px = views.displaced_px(second, turned)
    assert before_px == pytest.approx(0.02 * CAMERA.fx * 1.0)
    views.follow(jump)
    assert views.displaced_px(second, turned @ se3.inverse(jump)) == pytest.approx(before_px, rel=1e-6)
    assert views.displaced_px(second, turned) > 4 * before_px


@pytest.mark.parametrize(
    ("config", "said"),
    [
        (MultiViewConfig(combination="both"), "combination' is 'both'"),
        (MultiViewConfig(test=replace(BY_GEOMETRY.test, growing_stride=0)), "growing_stride' is 0"),
        (
            MultiViewConfig(test=replace(BY_GEOMETRY.test, keyframes=KeyframesConfig(choice="best"))),
            "choice' is 'best'; it must be one of nearest, farthest, spread",
        ),
    ],
)
def test_impossible_values_are_named(config: MultiViewConfig, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        config.build()


@pytest.mark.parametrize("config", [MultiViewConfig(), PaperMultiViewConfig(), CodeMultiViewConfig()])
def test_every_point_is_tested_by_default(config: MultiViewConfig) -> None:
    assert config.search == "all"
    assert config.ants == papers_search()


def test_the_ants_verdicts_equal_the_exhaustive_tests_on_what_they_visit() -> None:
    """On real projections into rendered frames: the same test, on fewer points."""
    dataset = select(open_dataset("synthetic:walking"), "0:150:5")
    config = PaperMultiViewConfig(network=False)
    geometry, along = config.test.build(), AlongPath(config.ants.build(3))
    world, orb = Map(SCALES), OrbConfig().build(parts(dataset.camera))
    poses = dataset.groundtruth.T_world_cam
    shares, n_dynamic, n_found = [], 0, 0
    for place in range(len(dataset)):
        frame, T_world_cam = orb.extract(dataset.load(place)), poses[5 * place]
        seen = [geometry.points_in_view(frame, se3.inverse(T_world_cam), world) for _ in range(2)]
        nothing_there = np.zeros(frame.image.gray.shape, np.bool_)
        if seen[0] is not None and seen[1] is not None:
            geometry.test(seen[0], seen[0].in_view)
            along.test(geometry, seen[1])
            visited = seen[1].in_view[along.found.is_tested]
            np.testing.assert_array_equal(seen[1].verdict[visited], seen[0].verdict[visited])
            left = np.setdiff1d(np.arange(len(seen[0].verdict)), visited)
            assert np.all(seen[1].verdict[left] == UNSEEN)
            shares.append(along.found.share_tested)
            n_dynamic += np.count_nonzero(seen[0].verdict == DYNAMIC)
            n_found += np.count_nonzero(seen[1].verdict == DYNAMIC)
            along.remember()
            assert along.found is None
        unseen, every = np.full(len(frame), -1, np.int32), np.ones(len(frame), np.bool_)
        keyframe = world.add_keyframe(frame, T_world_cam, unseen, every, parent=-1)
        geometry.views.note(frame, se3.inverse(T_world_cam), nothing_there, keyframe)
    assert len(shares) > 20
    assert np.mean(shares) < 0.8
    assert n_dynamic > 100
    assert 0.3 < n_found / n_dynamic < 1.0


def test_the_colony_finds_movers_in_the_sieve_too() -> None:
    config = PaperMultiViewConfig(network=False, search="reverse-ants")
    along, every = (
        judged("synthetic:walking", "0:180:3", config),
        judged("synthetic:walking", "0:180:3", replace(config, search="all")),
    )
    assert 0.25 < along.recall(along.pixels) < every.recall(every.pixels)
    assert along.precision(along.pixels) > 0.9


def test_the_seed_is_the_ants() -> None:
    config = MultiViewConfig(search="reverse-ants")
    world = Map(SCALES)
    paths = [config.build(Parts(CAMERA, world, seed))._along._ants.path._draws for seed in (1, 1, 2)]
    np.testing.assert_array_equal(paths[0], paths[1])
    assert not np.array_equal(paths[0], paths[2])
    assert MultiViewConfig().build()._along is None
