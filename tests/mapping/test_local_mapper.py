"""Local mapping as a whole: a camera walks past a small world and the map stays true."""

from dataclasses import replace

import numpy as np
import pytest
from building import parts
from small_world import CAMERA, SCALES, SmallWorld, pose

from stillroom.data.map import Map
from stillroom.data.motion import Motion
from stillroom.data.result import Tracked, TrackingState
from stillroom.geometry import se3
from stillroom.mapping.local_mapper import LocalMapper, LocalMapperConfig

WORLD = SmallWorld.of(0, 700)
PATH = [pose(0.08 * k, 0.02 * np.sin(k), 0.03 * k, (0.0, -0.015 * k, 0.01 * k)) for k in range(10)]


def walked(
    config: LocalMapperConfig, moving: float = 0.0, missed: float = 0.0
) -> tuple[Map, LocalMapper, list[np.ndarray]]:
    """Insert and refine a keyframe at each pose of the path, each matched with what the one before it sees.

    Args:
        config: The mapper's.
        moving: Share of the keypoints that a sieve takes for moving.
        missed: Share of the keypoints whose point tracking did not find.
    """
    rng = np.random.default_rng(0)
    world = Map(SCALES)
    mapper = config.build(parts(CAMERA, world))
    seen: list[np.ndarray] = []
    id_of = np.full(len(WORLD.points_m), -1, np.int32)
    for k, T_world_cam in enumerate(PATH):
        frame, numbers = WORLD.look(T_world_cam, seed=k, index=k, noise_px=0.4, flips=15, depth_share=0.7)
        motion = Motion(rng.random(len(frame)) >= moving, Motion.none(0, 480, 640).moving)
        guess = T_world_cam @ se3.exp(rng.normal(0, 0.002, 6)) if k else T_world_cam
        point_ids = np.where(motion.is_static, world.current_ids(id_of[numbers]), -1).astype(np.int32)
        point_ids[rng.random(len(frame)) < missed] = -1
        tracked = Tracked(frame, TrackingState.OK, guess, point_ids, motion, k - 1)
        keyframe = mapper.insert(tracked)
        assert keyframe == k
        mapper.refine(keyframe)
        seen.append(numbers)
        id_of[:] = -1
        id_of[numbers] = world.points_of(keyframe)
    return world, mapper, seen


@pytest.mark.parametrize("cull", [True, False])
def test_the_map_stays_true_along_a_path(cull: bool) -> None:
    world, _, seen = walked(LocalMapperConfig(cull_keyframes=cull))
    if not cull:
        assert len(world.alive_keyframes()) == len(PATH)
    for k in range(len(PATH)):
        T_true_found = np.linalg.inv(PATH[k]) @ world.keyframe_pose(k)
        assert np.linalg.norm(T_true_found[:3, 3]) < 0.006
        assert se3.angle_rad(T_true_found) < 0.003
    numbers = np.concatenate(seen)
    rows = np.flatnonzero(world.keypoints.point >= 0)
    truth = WORLD.points_m[numbers[rows]]
    error_m = np.linalg.norm(world.points.position_m[world.keypoints.point[rows]] - truth, axis=1)
    assert np.median(error_m / truth[:, 2]) < 0.004
    assert np.mean(error_m > 0.05 * truth[:, 2]) < 0.02


@pytest.mark.parametrize("missed", [0.0, 0.3])
def test_the_map_has_each_point_of_the_world_about_once(missed: float) -> None:
    world, _, seen = walked(LocalMapperConfig(cull_keyframes=False), missed=missed)
    numbers = np.concatenate(seen)
    rows = np.flatnonzero(world.keypoints.point >= 0)
    pairs = np.unique(np.column_stack((numbers[rows], world.keypoints.point[rows])), axis=0)
    _, ids_per_number = np.unique(pairs[:, 0], return_counts=True)
    assert np.mean(ids_per_number == 1) > 0.97
    visible_often = np.bincount(numbers, minlength=len(WORLD.points_m)) >= 5
    assert np.isin(np.flatnonzero(visible_often), pairs[:, 0]).mean() > 0.97


def test_keypoints_that_moved_are_in_no_point() -> None:
    world, _, _ = walked(LocalMapperConfig(), moving=0.4)
    table = world.keypoints
    assert 0.3 < np.mean(~table.is_static) < 0.5
    assert (table.point[~table.is_static] == -1).all()
    assert (table.point[table.is_static] >= 0).sum() > 1000


def test_the_sieve_before_tracking_counts_as_well() -> None:
    world = Map(SCALES)
    frame, _ = WORLD.look(pose())
    frame = frame.with_static(np.arange(len(frame)) % 2)
    tracked = Tracked(
        frame, TrackingState.OK, pose(), np.full(len(frame), -1, np.int32), Motion.none(len(frame), 480, 640)
    )
    LocalMapperConfig().build(parts(CAMERA, world)).insert(tracked)
    np.testing.assert_array_equal(world.keypoints.is_static, frame.is_static)
    assert (world.points_of(0)[::2] == -1).all()


def test_points_that_no_later_keyframe_sees_leave_the_map() -> None:
    world = Map(SCALES)
    mapper = LocalMapperConfig(cull_keyframes=False).build(parts(CAMERA, world))
    known = np.full(len(WORLD.points_m), -1, np.int32)
    ghosts: np.ndarray = np.zeros(0, int)
    for k in range(11):
        frame, numbers = WORLD.look(pose(0.03 * k), seed=k, index=k)
        if k == 1:  # in one frame a third of the keypoints look at something that is never seen again
            ghost = np.arange(len(frame)) % 3 == 0
            descriptors = frame.keypoints.descriptors.copy()
            descriptors[ghost] = np.random.default_rng(0).integers(0, 256, (ghost.sum(), 32))
            frame = replace(frame, keypoints=replace(frame.keypoints, descriptors=descriptors))
        point_ids = world.current_ids(known[numbers])
        if k == 1:
            point_ids[ghost] = -1
        motion = Motion.none(len(frame), 480, 640)
        mapper.insert(Tracked(frame, TrackingState.OK, pose(0.03 * k), point_ids, motion, k - 1))
        if k == 1:
            ghosts = world.points_of(1)[ghost & (world.points_of(1) >= 0)].copy()
        mapper.refine(k)
        if k != 1:
            known[numbers] = world.points_of(k)
    assert len(ghosts) > 30
    assert world.points.is_alive[ghosts].mean() < 0.05
    assert world.points.is_alive[world.points_of(10)[world.points_of(10) >= 0]].all()


def test_in_the_end_the_whole_map_comes_to_rest_unless_it_is_too_large() -> None:
    shake = se3.exp(np.array([0.004, -0.003, 0.005, 0.002, -0.002, 0.001]))
    found_m = {}
    for most in (len(PATH), 0):
        world, mapper, _ = walked(LocalMapperConfig(cull_keyframes=False, max_final_keyframes=most))
        world.keyframes.T_world_cam[2] = PATH[2] @ shake
        mapper.finish()
        found_m[most] = np.linalg.norm(world.keyframe_pose(2)[:3, 3] - PATH[2][:3, 3])
    assert found_m[len(PATH)] < 0.003
    assert found_m[0] > 0.006


@pytest.mark.parametrize("has_loop", [True, False])
def test_a_larger_map_comes_to_rest_as_well_where_a_loop_was_closed(has_loop: bool) -> None:
    config = LocalMapperConfig(cull_keyframes=False, max_final_keyframes=0, max_final_keyframes_looped=len(PATH))
    world, mapper, _ = walked(config)
    world.loop_edges[:] = [(0, len(PATH) - 1)] if has_loop else []
    # A bend of the whole way, as it is left after a loop: no two neighbours are off by much.
    for k in range(1, len(PATH)):
        world.keyframes.T_world_cam[k] = PATH[k] @ se3.exp(k / len(PATH) * np.array([0.02, -0.01, 0.01, 0, 0.01, 0]))
    mapper.finish()
    off_m = max(np.linalg.norm(world.keyframe_pose(k)[:3, 3] - PATH[k][:3, 3]) for k in range(len(PATH)))
    assert off_m < 0.003 if has_loop else off_m > 0.015


def test_a_map_that_was_only_looked_at_stays_as_it_is() -> None:
    world, _, _ = walked(LocalMapperConfig(cull_keyframes=False))
    world.keyframes.T_world_cam[2] = PATH[2] @ se3.exp(np.full(6, 0.004))
    before = world.keyframes.T_world_cam.copy()
    LocalMapperConfig().build(parts(CAMERA, world)).finish()
    np.testing.assert_array_equal(world.keyframes.T_world_cam, before)
