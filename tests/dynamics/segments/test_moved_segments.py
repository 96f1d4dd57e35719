"""What segments that move against the scene say: of staged things, rendered rooms with the network on, real frames."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from small_world import CAMERA, pose
from staged_things import HOME, STEP_S, Play, Thing, on, seen, share

from stillroom.data.frame import Frame
from stillroom.data.image import RgbdImage
from stillroom.data.motion import Motion, Stage
from stillroom.data.result import FrameResult, Tracked
from stillroom.data.semantics import Semantics
from stillroom.datasets.open import open_dataset
from stillroom.datasets.selection import select
from stillroom.dynamics.segment_sieve import (
    MovedSegments,
    MovedSegmentsConfig,
    SegmentPoints,
    spread,
    write_keypoints,
    write_samples,
)
from stillroom.errors import ConfigError
from stillroom.geometry.pixels import values_at
from stillroom.presets.registry import configure
from stillroom.system import build

CHAIR = Thing(200, 200, 120, 180, 2.0)
STEP_PX = 10
"""Of a chair that is pushed: 0.4 m/s at 2 m."""
SEGMENTS_ALONE = "dynamics.first.kind=whole-boxes"


def pushed(step: int) -> Thing:
    return replace(CHAIR, x=CHAIR.x + STEP_PX * step)


def pattern() -> np.ndarray:
    """Return something to be known by (640, 1280)."""
    noise = np.random.default_rng(4).integers(0, 256, (80, 160), dtype=np.uint8)
    return cv2.GaussianBlur(cv2.resize(noise, (1280, 640), interpolation=cv2.INTER_CUBIC), (0, 0), 2.0)


def painted(things: Sequence[Thing], time_s: float, shift_px: int = 0) -> tuple[Frame, Semantics]:
    """Return a frame of things with a pattern on each, which may have slid on the thing, and what is known of it."""
    frame, semantics = seen(things, time_s)
    rgb = np.zeros((480, 640, 3), np.uint8)
    for thing in things:
        rgb[thing.window] = pattern()[: thing.height, 300 - shift_px : 300 - shift_px + thing.width, None]
    image = RgbdImage(time_s, rgb, frame.image.depth_m, frame.image.index)
    return replace(frame, image=image), semantics


def show(play: Play, *things: Thing, T_world_cam: np.ndarray = HOME) -> tuple[Motion, Frame]:
    """Show the next image of painted things."""
    play.time_s += STEP_S
    frame, semantics = painted(things, play.time_s)
    return play.ask(frame, semantics, T_world_cam=T_world_cam), frame


def during(play: Play, seconds: float, *things: Thing) -> None:
    for _ in range(round(seconds / STEP_S)):
        show(play, *things)


@pytest.fixture
def play() -> Play:
    return Play(MovedSegmentsConfig().build())


@pytest.mark.parametrize("look", [show, Play.show], ids=["painted", "plain"])
def test_what_stands_is_static_however_long_it_is_looked_at(play: Play, look: Any) -> None:
    for _ in range(30):
        motion, _ = look(play, CHAIR)
        assert not motion.moving.any()
        assert motion.is_static.all()


def test_a_chair_moves_while_it_is_pushed_and_rests_when_it_is_left(play: Play) -> None:
    during(play, 2.0, CHAIR)
    shares = [share(show(play, pushed(step))[0], pushed(step)) for step in range(1, 16)]
    assert set(shares) == {0.0, 1.0}
    found = shares.index(1.0)
    assert found * STEP_S <= 0.5
    assert all(shares[found:])
    motion, frame = show(play, pushed(16))
    assert not motion.is_static[on(frame, pushed(16))].any()
    assert motion.is_static[~on(frame, pushed(16))].all()
    left = [share(show(play, pushed(16))[0], pushed(16)) for _ in range(15)]
    assert left.index(0.0) * STEP_S <= 0.8
    assert not any(left[left.index(0.0) :])


def test_a_plain_thing_is_told_by_depth_when_it_goes_fast(play: Play) -> None:
    play.during(1.0, CHAIR)
    gone = [replace(CHAIR, x=CHAIR.x + 36 * step) for step in range(1, 7)]
    shares = [share(play.show(thing)[0], thing) for thing in gone]
    assert shares[-1] == 1.0


def test_only_the_segment_that_moves_does(play: Play) -> None:
    other = Thing(450, 150, 100, 200, 1.8)
    during(play, 2.0, CHAIR, other)
    for step in range(1, 12):
        motion, _ = show(play, pushed(step), other)
    assert share(motion, pushed(11)) == 1.0
    assert share(motion, other) == 0.0


BOARD = Thing(120, 120, 360, 240, 2.0)


@pytest.mark.parametrize("step_px", [0, 6])
def test_a_board_that_slides_within_its_outline_is_known_by_its_pattern(play: Play, step_px: int) -> None:
    for step in range(12):
        play.time_s += STEP_S
        frame, semantics = painted([BOARD], play.time_s, step_px * step)
        motion = play.ask(frame, semantics)
    assert share(motion, BOARD) == float(step_px > 0)


def test_what_may_move_moves_whatever_segments_say(play: Play) -> None:
    play.during(1.0, CHAIR)
    frame, semantics = seen([CHAIR], play.time_s + STEP_S)
    mask = np.zeros((480, 640), dtype=bool)
    mask[100:200, 400:500] = True
    np.testing.assert_array_equal(play.ask(frame, replace(semantics, mask=mask)).moving, mask)
    np.testing.assert_array_equal(play.ask(frame, replace(semantics, mask=mask, clusters=None)).moving, mask)


def moving_chair(play: Play) -> tuple[Frame, Semantics]:
    during(play, 1.0, CHAIR)
    for step in range(1, 8):
        show(play, pushed(step))
    play.time_s += STEP_S
    return painted([pushed(8)], play.time_s)


def test_segments_are_tested_once_an_image_under_the_low_cost_pose(play: Play, monkeypatch: pytest.MonkeyPatch) -> None:
    frame, semantics = moving_chair(play)
    honest, asked = MovedSegments._votes, []

    def votes(self: MovedSegments, *question: object) -> np.ndarray:
        asked.append(question)
        return honest(self, *question)  # type: ignore[arg-type]

    monkeypatch.setattr(MovedSegments, "_votes", votes)
    under = [pose(0.001 * k) for k in range(3)]
    stages = (Stage.LOW_COST, Stage.MOTION_MODEL, Stage.LOCAL_MAP)
    verdicts = [play.ask(frame, semantics, stage, None, T) for stage, T in zip(stages, under, strict=True)]
    assert len(asked) == 1
    for verdict in verdicts:
        assert share(verdict, pushed(8)) == 1.0
        np.testing.assert_array_equal(verdict.is_static, verdicts[0].is_static)
    play.ask(frame, semantics, Stage.LOCAL_MAP, None, pose(0.1))
    assert len(asked) == 2, "a pose that is another one is another question"


@pytest.mark.parametrize("stage", [Stage.MOTION_MODEL, Stage.REFERENCE_KEYFRAME])
def test_under_a_guess_of_the_pose_nothing_is_asked(play: Play, stage: Stage) -> None:
    frame, semantics = moving_chair(play)
    assert not play.ask(frame, semantics, stage).moving.any()


@pytest.mark.parametrize(("turn_rad", "moves"), [(0.12, False), (0.04, True)])
def test_while_the_camera_turns_fast_nothing_is_found_to_move(play: Play, turn_rad: float, moves: bool) -> None:
    """The camera says that it turns, but the images do not: all would seem to move."""
    seeming = []
    for step in range(8):
        motion, _ = show(play, CHAIR, T_world_cam=pose(turn=(0.0, turn_rad * step, 0.0)))
        seeming.append(bool(motion.moving.any()))
    assert any(seeming) == moves


def test_what_is_remembered_follows_a_map_that_jumps(play: Play) -> None:
    during(play, 1.0, CHAIR)
    jump = pose(0.5, 0.1, turn=(0.0, 0.03, 0.0))
    play.small.map.jumps.append(jump)
    for _ in range(3):
        motion, _ = show(play, CHAIR, T_world_cam=jump @ HOME)
        assert not motion.moving.any()
    still = Play(MovedSegmentsConfig().build(), small=play.small)
    during(still, 1.0, CHAIR)
    moved = [show(still, CHAIR, T_world_cam=jump @ HOME)[0].moving.any() for _ in range(3)]
    assert any(moved), "a map that did not say so would make everything move"


def test_a_chair_that_is_pushed_while_the_map_jumps_is_found_as_if_it_had_not() -> None:
    stays, jumps = (Play(MovedSegmentsConfig().build()) for _ in range(2))
    jump = pose(0.5, 0.1, turn=(0.0, 0.6, 0.0))
    for step in range(16):
        if step == 8:
            jumps.small.map.jumps.append(jump)
        expected, _ = show(stays, pushed(step))
        motion, _ = show(jumps, pushed(step), T_world_cam=jump @ HOME if step >= 8 else HOME)
        np.testing.assert_array_equal(motion.moving, expected.moving)
        np.testing.assert_array_equal(motion.is_static, expected.is_static)
    assert share(expected, pushed(15)) == 1.0


@pytest.mark.parametrize(
    ("key", "value"), [("max_points", 0), ("min_points", 0), ("share", 0.0), ("share", 1.0), ("margin_px", -1)]
)
def test_impossible_values_are_named(key: str, value: float) -> None:
    with pytest.raises(ConfigError, match=f"^'{key}' is {value}; it must"):
        MovedSegmentsConfig(**{key: value}).build()  # type: ignore[arg-type]


def test_points_are_spread_over_each_segment() -> None:
    rng = np.random.default_rng(0)
    group = rng.permutation(np.repeat([0, 1, 3], [100, 7, 25]))
    chosen = spread(group, 24)
    assert np.all(np.diff(chosen) > 0)
    counts = np.bincount(group[chosen], minlength=4)
    assert counts.tolist() == [20, 7, 0, 13]
    for which in (0, 3):
        places = np.searchsorted(np.flatnonzero(group == which), chosen[group[chosen] == which])
        assert len(set(np.diff(places))) == 1, "evenly"
    assert len(spread(np.zeros(0, np.int64), 24)) == 0


def test_points_are_keypoints_on_segments_and_projected_samples() -> None:
    rng = np.random.default_rng(3)
    camera = replace(CAMERA, distortion=(0.1, -0.2, 0.002, -0.003, 0.05))
    labels = rng.integers(-2, 4, (480, 640)).astype(np.int16)
    raw_px = rng.uniform((-2, -2), (642, 482), (200, 2)).astype(np.float32)
    px, depth_m = camera.undistort(raw_px), np.where(rng.random(200) < 0.2, 0.0, 2.0).astype(np.float32)
    sampled_m = rng.uniform((-1, -1, 1), (1, 1, 3), (30, 3))
    cluster, chosen = rng.integers(0, 4, 30), np.flatnonzero(rng.random(30) < 0.5)
    points = SegmentPoints(np.empty(300, np.int64), np.empty((300, 2)), np.empty((300, 2)), np.empty(300))
    n = write_keypoints(raw_px, px, depth_m, labels, points)
    write_samples(sampled_m, cluster, chosen, camera.lens, n, points)
    label = values_at(labels, raw_px)
    on = (label >= 0) & (depth_m > 0)
    assert n == np.count_nonzero(on) > 50
    at = camera.project(sampled_m[chosen])
    n += len(chosen)
    np.testing.assert_array_equal(points.segment[:n], np.append(label[on], cluster[chosen]))
    np.testing.assert_allclose(points.raw_px[:n], np.vstack((raw_px[on], camera.distort(at))), rtol=1e-12)
    np.testing.assert_allclose(points.px[:n], np.vstack((px[on], at)), rtol=1e-12)
    np.testing.assert_array_equal(points.depth_m[:n], np.append(depth_m[on], sampled_m[chosen, 2]))


class Judge:
    """Counts pixels beyond the network's masks against the renderer's truth."""

    def __init__(self) -> None:
        self.right = self.wrong = self.found = self.missed = 0
        self.shares: list[float] = []

    def on_frame(self, tracked: Tracked, semantics: Semantics, result: FrameResult) -> None:
        image, motion, network = tracked.frame.image, tracked.motion, semantics.movable
        beyond = motion.moving & ~network
        self.shares.append(float(beyond.mean()))
        if image.truth is None:
            return
        true = image.truth.movable
        # Twelve pixels around movers may go with them: depth ends there ragged.
        near = cv2.dilate(true.view(np.uint8), np.ones((25, 25), np.uint8)).astype(bool)
        self.right += int((beyond & near).sum())
        self.wrong += int((beyond & ~near).sum())
        for box in image.truth.boxes:
            if box.label != "person":
                x0, y0, x1, y1 = (int(edge) for edge in box.xyxy_px)
                inside = np.zeros_like(true)
                inside[y0 : y1 + 1, x0 : x1 + 1] = True
                self.missed += int((true & inside & ~network & ~motion.moving).sum())
                self.found += int((true & inside & beyond).sum())

    @property
    def precision(self) -> float:
        return self.right / max(1, self.right + self.wrong)

    @property
    def recall(self) -> float:
        return self.found / max(1, self.found + self.missed)


def judged(spec: str, chosen: str, *overrides: str) -> Judge:
    dataset, judge = select(open_dataset(spec), chosen), Judge()
    config = configure("pspnet-slam", None, ["dense.kind=nothing", *overrides])
    system = build(config, dataset.camera, observer=judge)
    for place in range(len(dataset)):
        system.process(dataset.load(place))
    return judge


@pytest.mark.parametrize(
    ("spec", "chosen", "recall"),
    [("synthetic:pushed", "224:284:3", 0.7), ("synthetic:carried", "200:260:3", 0.75)],
)
def test_what_no_class_calls_movable_is_found_with_the_network_on(spec: str, chosen: str, recall: float) -> None:
    judge = judged(spec, chosen, SEGMENTS_ALONE)
    assert judge.precision > 0.95
    assert judge.recall > recall


@pytest.mark.slow
@pytest.mark.parametrize(
    ("spec", "chosen", "precision", "recall"),
    [("synthetic:pushed", "150:400:2", 0.95, 0.75), ("synthetic:carried", "60:420:3", 0.95, 0.8)],
)
def test_a_pushed_chair_and_a_carried_box_from_beginning_to_end(
    spec: str, chosen: str, precision: float, recall: float
) -> None:
    judge = judged(spec, chosen, SEGMENTS_ALONE)
    assert judge.precision > precision
    assert judge.recall > recall


def test_a_real_camera_that_turns_fast_finds_next_to_nothing(freiburg1: Path) -> None:
    judge = judged(str(freiburg1), "40:80", SEGMENTS_ALONE)
    assert np.mean(judge.shares) < 0.003
    heedless = judged(str(freiburg1), "40:80", SEGMENTS_ALONE, "dynamics.second.max_turn_rad_s=9")
    assert np.mean(heedless.shares) > 0.02, "depth that lags behind colour makes the room move"


def test_too_few_matches_leave_the_masks_and_then_nothing(play: Play) -> None:
    frame, semantics = moving_chair(play)
    mask = np.zeros((480, 640), dtype=bool)
    mask[:100] = True
    known = replace(semantics, mask=mask)
    moving, masked = on(frame, pushed(8)), frame.keypoints.raw_px[:, 1] < 99
    elsewhere = np.flatnonzero(~moving & ~masked & (frame.keypoints.raw_px[:, 1] > 101))

    def verdict(matched: np.ndarray, n_elsewhere: int) -> Motion:
        matched = matched.copy()
        matched[elsewhere[:n_elsewhere]] = True
        return play.ask(frame, known, matched=lambda _: matched)

    assert share(verdict(moving, 40), pushed(8)) == 1.0
    assert moving.sum() >= 10
    np.testing.assert_array_equal(verdict(moving, 35).moving, mask)
    assert masked.sum() >= 10
    none = verdict(masked, 35)
    assert not none.moving.any()
    assert none.is_static.all()
