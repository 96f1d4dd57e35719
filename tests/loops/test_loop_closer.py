"""Loops on a map made by hand: closed where they are right, undone where they are wrong."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from building import parts
from map_checks import check_links, check_same, contents
from ring_map import Ring, false_loop, ring
from small_world import CAMERA

from stillroom.errors import ConfigError
from stillroom.geometry import se3
from stillroom.loops.detection import DetectionConfig
from stillroom.loops.loop_closer import LoopCloser, LoopsConfig, NoLoops
from stillroom.loops.verification import Verifier


def closer_of(made: Ring, **changes: Any) -> LoopCloser:
    closing = LoopsConfig(**changes).build(parts(CAMERA, made.map), made.places)
    assert isinstance(closing, LoopCloser)
    return closing


def run(made: Ring, closer: LoopCloser) -> list[int]:
    return [k for k in range(len(made.T_true)) if closer.close(k)]


@dataclass
class Closed:
    """A ring before and after its loop was closed."""

    made: Ring
    closer: LoopCloser
    T_world_before: np.ndarray
    errors_before_m: np.ndarray
    n_closed: int
    followed: list[float]


@pytest.fixture(scope="module")
def closed() -> Closed:
    made = ring()
    followed: list[float] = []
    closer = LoopsConfig().build(
        parts(CAMERA, made.map), made.places, after=(lambda: followed.append(made.errors_m().mean()),)
    )
    assert isinstance(closer, LoopCloser)
    poses, errors_m = made.map.keyframes.T_world_cam.copy(), made.errors_m()
    return Closed(made, closer, poses, errors_m, len(run(made, closer)), followed)


def test_a_loop_is_found_and_the_whole_map_put_right(closed: Closed) -> None:
    made, world = closed.made, closed.made.map
    assert closed.n_closed == 1
    loop = closed.closer.closed[0]
    assert np.linalg.norm(made.T_true[loop.keyframe, :3, 3] - made.T_true[loop.candidate, :3, 3]) < 1.5
    assert closed.errors_before_m.mean() > 0.4
    assert made.errors_m().mean() < 0.02
    assert closed.followed == [pytest.approx(made.errors_m().mean())]
    assert world.loop_edges == [(loop.candidate, loop.keyframe)]
    check_links(world)
    # The place is one place now: keyframes of both rounds share points, and the points lie where they are.
    assert loop.candidate in world.covisibility.neighbours(loop.keyframe)
    T_true_world = made.T_true[0] @ se3.inverse(world.keyframes.T_world_cam[0])
    number = made.small.number_of()
    seen = np.flatnonzero((number >= 0) & world.points.is_alive & (world.points.n_keyframes > 2))
    off = se3.transform(T_true_world, world.points.position_m[seen]) - made.small.world.points_m[number[seen]]
    assert np.median(np.linalg.norm(off, axis=1)) < 0.03


def test_the_pose_that_verification_finds_is_the_true_one(closed: Closed) -> None:
    loop, made = closed.closer.closed[0], closed.made
    T_true = se3.inverse(made.T_true[loop.candidate]) @ made.T_true[loop.keyframe]
    error = se3.inverse(T_true) @ se3.inverse(closed.T_world_before[loop.candidate]) @ loop.T_world_cam
    assert np.linalg.norm(error[:3, 3]) < 0.02
    assert float(se3.angle_rad(error)) < 0.005
    assert len(loop.rows) >= 40
    assert (made.map.keypoints.keyframe[loop.rows] == loop.keyframe).all()


def test_the_same_loop_again_gives_the_same_map_bit_for_bit(closed: Closed) -> None:
    made = ring()
    run(made, closer_of(made))
    for name, values in contents(closed.made.map).items():
        np.testing.assert_array_equal(contents(made.map)[name], values, err_msg=name)


def test_a_loop_that_odometry_rules_out_is_refused_and_nothing_is_touched() -> None:
    made = ring()
    before = contents(made.map)
    closer = closer_of(made, drift_m=0.1, drift_m_per_m=0.001)
    assert run(made, closer) == []
    check_same(made.map, before)


def test_what_drift_cannot_have_brought_within_sight_is_not_even_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    made, looked_at = ring(), []

    def look(_: Verifier, keyframe: int, candidate: int, *rest: object) -> None:
        looked_at.append((keyframe, candidate))

    monkeypatch.setattr(Verifier, "verify", look)
    run(made, closer_of(made, drift_m=0.0, drift_rad=0.0, drift_m_per_m=0.0, drift_rad_per_m=0.0, sight_m=0.1))
    assert looked_at == []
    run(made, closer_of(made))
    assert looked_at


@pytest.mark.parametrize(("keyframe", "candidate"), [(20, 4), (29, 20)])
def test_a_wrong_loop_is_undone_to_the_last_bit(keyframe: int, candidate: int) -> None:
    made = ring(n=30, laps=0.5, drift_m=0.0, drift_rad=0.0)
    before = contents(made.map)
    closer = closer_of(made)
    assert not closer.correct(false_loop(made, keyframe, candidate))
    check_same(made.map, before)
    assert len(closer.refused) == 1
    assert not closer.closed


@pytest.mark.parametrize(
    ("config", "named"),
    [
        (LoopsConfig(max_lost_share=1.5), "loops.max_lost_share' is 1.5"),
        (LoopsConfig(min_kept_share=-0.1), "loops.min_kept_share' is -0.1"),
        (LoopsConfig(detection=DetectionConfig(consistent_keyframes=0)), "loops.detection.consistent_keyframes' is 0"),
    ],
)
def test_impossible_values_are_named(config: LoopsConfig, named: str) -> None:
    made = ring(n=4, laps=0.05)
    with pytest.raises(ConfigError, match=named):
        config.build(parts(CAMERA, made.map), made.places)


def test_switched_off_nothing_is_closed() -> None:
    made = ring(n=20, laps=0.3)
    assert isinstance(LoopsConfig(enabled=False).build(parts(CAMERA, made.map), made.places), NoLoops)
    assert not NoLoops().close(3)
