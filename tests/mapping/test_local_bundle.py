"""Local bundle adjustment on a small map whose truth is known."""

import numpy as np
import pytest
from small_world import CAMERA, SCALES, SmallMap, SmallWorld, pose

from stillroom.data.map import Covisibility, Map
from stillroom.geometry import se3
from stillroom.mapping.local_mapper import adjust_all, adjust_locally
from stillroom.optimize.bundle import BundleConfig

POSES = [pose(0.12 * k, 0.02 * k, 0.05 * k, (0.01 * k, -0.02 * k, 0.0)) for k in range(6)]
ADJUST = BundleConfig(iterations_second=20, min_relative_decrease=1e-6).build()


def shaken(free: list[int], seed: int = 0, by: float = 1.0, **look: float) -> SmallMap:
    """A map with some keyframes (5 mm, 0.3°) and all their points (1 cm) moved away from the truth."""
    rng = np.random.default_rng(seed)
    small = SmallMap.of(SmallWorld.of(seed, 300), POSES, **look)
    keyframes = small.map.keyframes
    for k in free:
        keyframes.T_world_cam[k] = POSES[k] @ se3.exp(by * rng.normal(0, 0.005, 6))
    moved = small.map.points_seen_by(np.array(free))
    small.map.points.position_m[moved] += by * rng.normal(0, 0.01, (len(moved), 3))
    return small


def reprojection_px(small: SmallMap) -> float:
    """Root mean square over all observations."""
    world = small.map
    rows = np.flatnonzero(world.keypoints.point >= 0)
    errors = []
    for k in world.alive_keyframes():
        own = rows[world.keypoints.keyframe[rows] == k]
        p_cam = se3.transform(
            np.linalg.inv(world.keyframes.T_world_cam[k]), world.points.position_m[world.keypoints.point[own]]
        )
        errors.append(CAMERA.project(p_cam) - world.keypoints.px[own])
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))


def pose_errors_m(small: SmallMap) -> np.ndarray:
    return np.linalg.norm(small.map.keyframes.T_world_cam[:, :3, 3] - np.array(POSES)[:, :3, 3], axis=1)


@pytest.mark.parametrize("depth_share", [0.0, 0.7])
def test_a_shaken_map_comes_to_rest_at_the_truth(depth_share: float) -> None:
    small = shaken([3, 4, 5], depth_share=depth_share)
    before = small.map.keyframes.T_world_cam.copy()
    assert reprojection_px(small) > 2
    adjust_locally(5, 3, CAMERA, ADJUST, small.map)
    after = small.map.keyframes.T_world_cam
    np.testing.assert_array_equal(after[:3], before[:3])
    assert np.all(np.abs(after[3:] - before[3:]).max(axis=(1, 2)) > 1e-4)
    assert pose_errors_m(small).max() < 2e-4
    assert reprojection_px(small) < 0.05
    seen = np.flatnonzero(small.map.points.n_keyframes >= 3)
    truth = small.world.points_m[small.number_of()[seen]]
    assert np.linalg.norm(small.map.points.position_m[seen] - truth, axis=1).max() < 2e-3


def test_noise_is_averaged_and_the_error_falls() -> None:
    small = shaken([3, 4, 5], noise_px=0.7, depth_share=0.7)
    px, error_m = reprojection_px(small), pose_errors_m(small)
    adjust_locally(5, 3, CAMERA, ADJUST, small.map)
    assert reprojection_px(small) < min(0.8, px / 2)
    assert pose_errors_m(small)[3:].mean() < error_m[3:].mean() / 2


def test_only_the_strongest_neighbours_move() -> None:
    small = shaken([2, 3, 4, 5])
    before = small.map.keyframes.T_world_cam.copy()
    neighbours = small.map.covisibility.neighbours(5, 1)
    adjust_locally(5, 2, CAMERA, ADJUST, small.map)
    moved = np.abs(small.map.keyframes.T_world_cam - before).max(axis=(1, 2)) > 0
    assert np.flatnonzero(moved).tolist() == sorted([5, *neighbours])


def test_the_origin_stays_though_it_is_a_neighbour() -> None:
    small = shaken([1, 2, 3, 4, 5])
    assert 0 in small.map.covisibility.neighbours(5)
    adjust_locally(5, 20, CAMERA, ADJUST, small.map)
    np.testing.assert_array_equal(small.map.keyframes.T_world_cam[0], POSES[0])
    assert pose_errors_m(small).max() < 2e-4
    noisy = shaken([3, 4, 5], noise_px=0.5)
    noisy.map.covisibility = Covisibility()
    noisy.map.covisibility.connect(5, np.array([90, 0, 0, 0, 80, 0], np.int32))
    before = noisy.map.keyframes.T_world_cam.copy()
    adjust_locally(5, 3, CAMERA, ADJUST, noisy.map)  # 1, 2 and 3 hold still because they are no neighbours
    moved = np.abs(noisy.map.keyframes.T_world_cam - before).max(axis=(1, 2)) > 0
    assert np.flatnonzero(moved).tolist() == [4, 5]


def test_without_anyone_else_the_oldest_holds_still() -> None:
    small = shaken([1, 2], by=0.0)
    for k in (0, 3, 4, 5):
        rows = small.map.rows(k)
        small.map.remove_observations(np.arange(rows.start, rows.stop))
    small.map.keyframes.T_world_cam[2] = POSES[2] @ se3.exp(np.full(6, 0.004))
    before = small.map.keyframes.T_world_cam.copy()
    small.map.connect(2)
    adjust_locally(2, 20, CAMERA, ADJUST, small.map)
    np.testing.assert_array_equal(small.map.keyframes.T_world_cam[[0, 1, 3, 4, 5]], before[[0, 1, 3, 4, 5]])
    assert pose_errors_m(small)[2] < 1e-4


def test_wrong_observations_are_unlinked_and_right_ones_are_not() -> None:
    small = shaken([3, 4, 5], noise_px=0.3, by=0.2)
    table = small.map.keypoints
    # Points of four views or more: what is wrong then shows, and the point outlives it.
    many = np.flatnonzero(small.map.points.n_keyframes >= 4)
    rows = small.map.observations(many)[1]
    of_newest = rows[table.keyframe[rows] == 5]
    wrong = of_newest[::9]
    points = table.point[wrong].copy()
    table.px[wrong] += np.random.default_rng(0).choice([-40, 40], (len(wrong), 2))
    n_before = int((table.point >= 0).sum())
    adjust_locally(5, 3, CAMERA, ADJUST, small.map)
    assert len(wrong) > 10
    assert (table.point[wrong] == -1).all()
    assert small.map.points.is_alive[points].all()
    assert n_before - (table.point >= 0).sum() < 1.3 * len(wrong)
    assert pose_errors_m(small).max() < 3e-3


def test_viewing_geometry_follows_the_points() -> None:
    small = shaken([3, 4, 5])
    adjust_locally(5, 3, CAMERA, ADJUST, small.map)
    normals, largest = small.map.points.normal.copy(), small.map.points.max_distance_m.copy()
    seen = small.map.points_seen_by(np.array([3, 4, 5]))
    small.map.refresh_geometry(seen)
    np.testing.assert_array_equal(small.map.points.normal[seen], normals[seen])
    np.testing.assert_array_equal(small.map.points.max_distance_m[seen], largest[seen])


def test_the_whole_map_is_adjusted_at_once_and_only_the_first_keyframe_holds_still() -> None:
    small = shaken([1, 2, 3, 4, 5])
    adjust_all(CAMERA, ADJUST, small.map)
    np.testing.assert_array_equal(small.map.keyframes.T_world_cam[0], POSES[0])
    assert pose_errors_m(small).max() < 2e-4
    assert reprojection_px(small) < 0.05
    adjust_all(CAMERA, ADJUST, Map(SCALES))  # nothing in it: nothing happens


def test_a_keyframe_that_sees_nothing_changes_nothing() -> None:
    small = shaken([4])
    rows = small.map.rows(5)
    small.map.remove_observations(np.arange(rows.start, rows.stop))
    small.map.covisibility.remove(5)
    before = small.map.keyframes.T_world_cam.copy()
    adjust_locally(5, 3, CAMERA, ADJUST, small.map)
    np.testing.assert_array_equal(small.map.keyframes.T_world_cam, before)
