"""The rule of `zhang-slam`: an object moves when enough of its own points say so."""

from dataclasses import replace

import numpy as np
import pytest
from building import parts
from sliding_tiles import HEIGHT, WIDTH, Patch, TwoImages
from small_world import CAMERA, SCALES

from stillroom.data.map import Map
from stillroom.data.matches import Matches
from stillroom.data.motion import Stage
from stillroom.data.semantics import Semantics
from stillroom.dynamics.moving_objects import MovingObjects, MovingObjectsConfig

WALKS, STANDS = Patch(100, 120, dx=4, dy=6), Patch(400, 120)


def boxed(*things: Patch) -> Semantics:
    return Semantics(HEIGHT, WIDTH, tuple(thing.box for thing in things))


def sieve(**changes: object) -> MovingObjects:
    return replace(MovingObjectsConfig(), **changes).build(parts())


def test_objects_are_judged_one_by_one() -> None:
    show = TwoImages([WALKS, STANDS], boxed(WALKS, STANDS))
    motion = show.ask(sieve())
    np.testing.assert_array_equal(motion.is_static, ~WALKS.on(show.now))
    np.testing.assert_array_equal(motion.moving, WALKS.mask())


def test_what_is_in_no_box_stays() -> None:
    motion = TwoImages([WALKS, STANDS], boxed(STANDS)).ask(sieve())
    assert motion.is_static.all()
    assert not motion.moving.any()


def test_without_a_last_image_nobody_is_shown_to_stand() -> None:
    show = TwoImages([STANDS], boxed(STANDS))
    np.testing.assert_array_equal(show.ask(sieve(), with_last=False).is_static, ~STANDS.on(show.now))


def test_too_few_points_cannot_say_that_it_stands() -> None:
    small = Patch(420, 200, 40, 40)
    show = TwoImages([small], boxed(small))
    n = int(small.on(show.now).sum())
    for least, stays in ((n, True), (n + 1, False)):
        assert show.ask(sieve(min_points=least)).is_static[small.on(show.now)].all() == stays


def with_map(
    show: TwoImages, thing: Patch | None = None, share: float = 1.0, away_m: float = 0.0
) -> tuple[Matches, Map]:
    """Match all keypoints with a map that has a share of those on a thing further away."""
    kp, world = show.now.keypoints, Map(SCALES)
    points_m = CAMERA.back_project(kp.px, kp.depth_m)
    if thing is not None:
        on_it = np.flatnonzero(thing.on(show.now))
        points_m[on_it[: round(share * len(on_it))], 2] += away_m
    world.add_keyframe(show.now, np.eye(4), np.full(len(kp), -1, np.int32), show.now.is_static, -1)
    return Matches.of(world.add_points(points_m, np.arange(len(kp)))), world


@pytest.mark.parametrize(
    ("share", "away_m", "moves"), [(0.25, 0.2, True), (0.15, 0.2, False), (1.0, 0.07, True), (1.0, 0.05, False)]
)
def test_a_share_of_its_points_away_from_the_map_is_enough(share: float, away_m: float, moves: bool) -> None:
    """At 2 m the tolerance is 6 cm; a fifth of the points must say so."""
    show = TwoImages([STANDS], boxed(STANDS))
    matches, world = with_map(show, STANDS, share, away_m)
    assert show.ask(sieve(), matches, world).moving.any() == moves


def test_the_map_is_not_asked_under_a_predicted_pose() -> None:
    show = TwoImages([STANDS], boxed(STANDS))
    matches, world = with_map(show, STANDS, 1.0, 0.3)
    assert not show.ask(sieve(), matches, world, Stage.MOTION_MODEL).moving.any()
    assert show.ask(sieve(), matches, world, Stage.LOCAL_MAP).moving.any()


def test_what_is_seen_behind_who_walks_stays() -> None:
    """The upper half of the box shows the room: it is further away, and slides with the camera."""
    walks = replace(WALKS, y=240, height=200)
    box = replace(walks, y=120, height=320)
    depth_m = np.full((HEIGHT, WIDTH), 3.0, dtype=np.float32)
    depth_m[walks.window] = 2.0
    show = TwoImages([walks], boxed(box), depth_m)
    motion = show.ask(sieve())
    np.testing.assert_array_equal(motion.moving, box.mask())
    assert not motion.is_static[walks.on(show.now)].any()
    above = box.on(show.now, 12) & (show.now.keypoints.raw_px[:, 1] < 220)
    assert motion.is_static[above].mean() > 0.8


def test_what_is_behind_one_is_not_behind_another_who_stands_there() -> None:
    """Two walk, one far behind the other, and their boxes overlap: he is not the background of the nearer one."""
    far, near = Patch(100, 40, 200, 200, dy=6), Patch(100, 240, 200, 200, dy=6)
    depth_m = np.full((HEIGHT, WIDTH), 5.0, dtype=np.float32)
    depth_m[far.window], depth_m[near.window] = 3.0, 1.5
    around = replace(near, y=40, height=400)
    show = TwoImages([far, near], boxed(around, far), depth_m)
    assert not show.ask(sieve()).is_static[around.on(show.now)].any()
