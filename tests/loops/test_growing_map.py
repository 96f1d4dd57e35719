"""Corrections while the map grows, as under the live schedule: what comes in between goes where its parent goes."""

import numpy as np
import pytest
from map_checks import check_links, contents
from ring_map import Ring, ring
from small_world import CAMERA

from stillroom.geometry import se3
from stillroom.loops.global_bundle import GlobalBundle
from stillroom.loops.moves import Places, follow_keyframes, move
from stillroom.loops.verdict import Snapshot
from stillroom.optimize.bundle import BundleConfig

ADJUST = BundleConfig().build()


def shaken(seed: int = 0) -> Ring:
    """A map without drift of which the later keyframes and all points are a little off."""
    made = ring(n=16, laps=0.3, drift_m=0.0, drift_rad=0.0, noise_px=0.0)
    rng = np.random.default_rng(seed)
    poses, points = made.map.keyframes.T_world_cam, made.map.points
    for k in range(1, len(poses)):
        poses[k] = poses[k] @ se3.exp(rng.normal(0, 0.004, 6))
    points.position_m[:] += rng.normal(0, 0.01, points.position_m.shape)
    return made


def grow(made: Ring) -> int:
    """Add a keyframe a step further than the last one, by the map's own idea of where that is, with new points."""
    world, T_step = made.map, se3.inverse(made.T_true[-2]) @ made.T_true[-1]
    T_true = made.T_true[-1] @ T_step
    made.small.id_of[:] = world.current_ids(made.small.id_of)
    keyframe = made.small.add(T_true, noise_px=0.3, flips=8)
    T_world_cam = world.keyframes.T_world_cam[keyframe - 1] @ T_step
    world.keyframes.T_world_cam[keyframe] = T_world_cam
    own = np.flatnonzero(world.points.first_keyframe == keyframe)
    world.points.position_m[own] = se3.transform(T_world_cam @ se3.inverse(T_true), world.points.position_m[own])
    made.T_true = np.concatenate((made.T_true, T_true[None]))
    return keyframe


def relative(made: Ring, keyframe: int) -> np.ndarray:
    poses = made.map.keyframes.T_world_cam
    return se3.inverse(poses[keyframe - 1]) @ poses[keyframe]


def test_full_adjustment_brings_the_map_to_rest_and_takes_newcomers_along() -> None:
    made = shaken()
    world, before = made.map, made.errors_m()
    bundle = GlobalBundle(world.alive_keyframes(), world)
    new = grow(made)
    n_points = len(world.points)
    step, first = relative(made, new), world.keyframes.T_world_cam[0].copy()
    own = world.points_of(new)
    own = own[world.points.first_keyframe[own] == new]
    seen_from_new = se3.transform(se3.inverse(world.keyframes.T_world_cam[new]), world.points.position_m[own])
    bundle.commit(bundle.solve(CAMERA, ADJUST), world)
    assert before.max() > 0.008
    assert made.errors_m()[: len(before)].max() < 0.001
    np.testing.assert_array_equal(world.keyframes.T_world_cam[0], first)
    np.testing.assert_allclose(relative(made, new), step, atol=1e-12)
    moved = se3.transform(se3.inverse(world.keyframes.T_world_cam[new]), world.points.position_m[own])
    np.testing.assert_allclose(moved, seen_from_new, atol=1e-9)
    assert len(own) > 10
    assert len(world.points) == n_points
    check_links(world)


def test_an_adjustment_that_is_told_to_stop_leaves_a_sound_map_that_is_no_worse() -> None:
    made = shaken()
    bundle = GlobalBundle(made.map.alive_keyframes(), made.map)
    new: list[int] = []

    def a_keyframe_comes() -> bool:
        if len(new) < 2:
            new.append(grow(made))
        return len(new) == 2

    result = bundle.solve(CAMERA, ADJUST, a_keyframe_comes)
    assert result.n_iterations == 1
    assert result.final_cost < result.initial_cost
    bundle.commit(result, made.map)
    assert np.isfinite(made.map.keyframes.T_world_cam).all()
    check_links(made.map)


def test_undoing_keeps_what_came_since_and_moves_it_along() -> None:
    made = ring(n=16, laps=0.3, drift_m=0.0, drift_rad=0.0)
    world = made.map
    before, snapshot = contents(world), Snapshot(world)
    # What a wrong loop does: it moves half the map, joins points that are not one, and drops observations.
    T_wrong = se3.exp(np.array([0.5, 0.1, 0.0, 0.1, 0.2, 0.0]))
    old = Places.of(world)
    move(range(8, 16), T_wrong, 1.0, world)
    follow_keyframes(np.arange(len(world.points)), old, world)
    world.replace_points(np.arange(0, 40, 2), np.arange(1, 41, 2))
    world.remove_observations(np.arange(200, 300))
    world.loop_edges.append((3, 9))
    new = grow(made)
    step, own = relative(made, new), world.points_of(new).copy()
    snapshot.restore(world)
    for name, values in before.items():
        if name.split(".")[0] in ("keyframes", "keypoints") and not name.endswith(("is_unsaved", "next_row", "point")):
            np.testing.assert_array_equal(contents(world)[name][: len(values)], values, err_msg=name)
    assert world.points.is_alive[: len(before["points.is_alive"])].all()
    n_rows = len(before["keypoints.point"])
    np.testing.assert_array_equal(world.keypoints.point[:n_rows], before["keypoints.point"])
    np.testing.assert_allclose(relative(made, new), step, atol=1e-12)
    np.testing.assert_array_equal(world.points_of(new), own)
    assert made.map.loop_edges == []
    check_links(world)
    # The newcomer's own points lie where it sees them.
    fresh = np.flatnonzero(world.points.first_keyframe[own] == new)
    seen = se3.transform(se3.inverse(world.keyframes.T_world_cam[new]), world.points.position_m[own[fresh]])
    rows = world.rows(new)
    assert len(fresh) > 10
    np.testing.assert_allclose(CAMERA.project(seen), world.keypoints.px[rows][fresh], atol=3.0)


@pytest.mark.parametrize("point_share", [0.0, 1.0])
def test_points_go_with_the_keyframe_that_saw_them_first(point_share: float) -> None:
    made = ring(n=10, laps=0.2, drift_m=0.0, drift_rad=0.0)
    world = made.map
    ids = np.arange(int(point_share * len(world.points)))
    old, places = world.points.position_m.copy(), Places.of(world)
    T_moved = se3.exp(np.array([0.3, 0, 0.1, 0, 0.4, 0]))
    move([3, 4], T_moved, 1.0, world)
    follow_keyframes(ids, places, world)
    for point in range(len(world.points)):
        goes = point in ids and world.points.first_keyframe[point] in (3, 4)
        expected = se3.transform(T_moved, old[point][None])[0] if goes else old[point]
        np.testing.assert_allclose(world.points.position_m[point], expected, atol=1e-12)


def test_an_adjustment_in_place_moves_what_it_is_asked_to_and_nothing_else() -> None:
    made = ring(n=16, laps=0.3, drift_m=0.0, drift_rad=0.0, noise_px=0.0)
    rng, world = np.random.default_rng(1), made.map
    asked, poses = np.array([6, 7, 8]), made.map.keyframes.T_world_cam
    for k in asked:
        poses[k] = poses[k] @ se3.exp(rng.normal(0, 0.004, 6))
    before, errors_m = poses.copy(), made.errors_m()
    bundle = GlobalBundle(asked, world, in_place=True)
    bundle.commit(bundle.solve(CAMERA, ADJUST), world)
    others = np.setdiff1d(np.arange(16), asked)
    np.testing.assert_array_equal(poses[others], before[others])
    assert errors_m[asked].min() > 0.002
    assert made.errors_m()[asked].max() < 0.0005
    check_links(world)
