"""Pieces of a map: how they begin, and what laying one onto another leaves as it was."""

import numpy as np
from small_world import CAMERA, SmallMap, SmallWorld, pose

from stillroom.data.map import Map, submaps
from stillroom.geometry import se3

FIRST = [pose(), pose(0.1), pose(0.2)]
SECOND = [pose(0.3, turn=(0, 0.1, 0)), pose(0.35, 0.1, turn=(0, 0.15, 0)), pose(0.4), pose(0.45)]


def two_pieces() -> Map:
    """The same world seen by two pieces that know nothing of each other; the second in coordinates of its own."""
    world = SmallWorld.of(0)
    small = SmallMap.of(world, FIRST)
    T_piece_true = submaps.origin(1) @ se3.inverse(SECOND[0])
    ids = np.full(len(world.points_m), -1, np.int32)
    for i, T in enumerate(SECOND):
        k = len(small.map.keyframes)
        frame, seen = world.look(T, seed=k, index=k)
        small.map.add_keyframe(frame, T_piece_true @ T, ids[seen], frame.is_static, k - 1 if i else -1)
        new = np.flatnonzero(ids[seen] < 0)
        positions_m = se3.transform(T_piece_true, world.points_m[seen[new]])
        ids[seen[new]] = small.map.add_points(positions_m, small.map.rows(k).start + new)
        small.map.refresh(ids[ids >= 0])
        small.map.connect(k)
    return small.map


def seen_from(world: Map, keyframe: int) -> np.ndarray:
    """Where a keyframe's points lie in its own camera."""
    ids = world.points_of(keyframe)
    return se3.transform(se3.inverse(world.keyframes.T_world_cam[keyframe]), world.points.position_m[ids[ids >= 0]])


def test_a_keyframe_without_a_parent_begins_a_piece_and_children_belong_to_it() -> None:
    world = two_pieces()
    assert world.keyframes.submap.tolist() == [0, 0, 0, 1, 1, 1, 1]
    assert world.n_submaps == 2
    assert submaps.unjoined(world).tolist() == [0, 1]
    ids = world.points_seen_by(np.array([4, 5]))
    assert set(submaps.of_points(ids, world).tolist()) == {1}
    assert world.covisibility.neighbours(4)
    assert min(world.covisibility.neighbours(4)) >= 3


def test_pieces_lie_far_apart_each_in_its_region() -> None:
    origins = np.array([submaps.origin(k)[:3, 3] for k in range(100)])
    apart_m = np.linalg.norm(origins[:, None] - origins[None], axis=2) + 1e9 * np.eye(100)
    assert apart_m.min() >= 500.0
    assert np.array_equal(submaps.origin(0), np.eye(4))
    for k in (0, 5, 40):
        assert submaps.lies_in(k, origins + 20.0).tolist() == [other == k for other in range(100)]


def test_the_main_piece_has_most_keyframes_and_of_equals_is_the_oldest() -> None:
    world = two_pieces()
    assert submaps.main(world) == 1
    world.remove_keyframe(6)
    assert submaps.main(world) == 0
    assert submaps.main(Map(world.scales)) == submaps.NONE


def test_of_a_map_that_is_gone_on_in_only_the_new_keyframes_count() -> None:
    world = two_pieces()
    assert submaps.main(world, since=3) == submaps.main(world, since=7) == 1
    world.remove_keyframe(6)
    assert submaps.main(world, since=2) == 1
    assert submaps.main(world, since=6) == submaps.main(world, since=7) == 0


def test_joining_moves_a_piece_rigidly_and_nothing_else() -> None:
    world = two_pieces()
    world.remove_keyframe(5)
    world.refresh_geometry(np.flatnonzero(world.points.is_alive))
    before = world.keyframes.T_world_cam.copy()
    points_before = world.points.position_m.copy()
    views = {k: seen_from(world, k) for k in (0, 1, 2, 3, 4, 6)}
    cosines = normals_towards(world)
    T = pose(1.0, 2.0, 3.0, turn=(0.3, -0.2, 0.5)) @ se3.inverse(submaps.origin(1))
    T_culled = world.keyframe_pose(5)
    submaps.join(1, 0, T, 1.0, 2, world)
    assert submaps.unjoined(world).tolist() == [0]
    assert world.keyframes.parent.tolist() == [-1, 0, 1, 2, 3, 4, 5]
    np.testing.assert_allclose(world.keyframes.T_world_cam[[3, 4, 6]], T @ before[[3, 4, 6]], atol=1e-9)
    np.testing.assert_array_equal(world.keyframes.T_world_cam[:3], before[:3])
    np.testing.assert_allclose(world.keyframe_pose(5), T @ T_culled, atol=1e-9)
    for keyframe, view in views.items():
        np.testing.assert_allclose(seen_from(world, keyframe), view, atol=1e-9)
    first = world.keyframes.submap[world.points.first_keyframe] == 0
    stayed = world.points.first_keyframe < 3
    assert first.all()
    np.testing.assert_array_equal(world.points.position_m[stayed], points_before[stayed])
    np.testing.assert_allclose(normals_towards(world), cosines, atol=1e-9)


def normals_towards(world: Map) -> np.ndarray:
    """Cosine between each point's normal and the way to the keyframe that saw it first."""
    ids = np.flatnonzero(world.points.is_alive)
    rows = world.oldest_observations(ids)
    centres_m = world.keyframes.T_world_cam[world.keypoints.keyframe[rows], :3, 3]
    towards = world.points.position_m[ids] - centres_m
    return (towards * world.points.normal[ids]).sum(axis=1) / np.linalg.norm(towards, axis=1)


def test_ids_of_pieces_are_never_used_again() -> None:
    world = two_pieces()
    submaps.join(1, 0, np.eye(4), 1.0, 2, world)
    frame, _ = SmallWorld.of(1).look(pose())
    assert frame.camera == CAMERA
    keyframe = world.add_keyframe(frame, pose(), np.full(len(frame), -1, np.int32), frame.is_static, -1)
    assert world.keyframes.submap[keyframe] == 2
