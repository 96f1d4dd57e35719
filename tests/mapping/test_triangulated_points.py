"""Points that two keyframes make together, against the world they look at."""

import numpy as np
import pytest
from small_world import CAMERA, SmallMap, SmallWorld, pose

from stillroom.data.sensor import Sensor
from stillroom.geometry import se3
from stillroom.mapping import new_points
from stillroom.mapping.new_points import PairLimits, by_triangulation
from stillroom.presets.registry import configure
from stillroom.system import build

SIDE = pose(0.4, 0.05, 0.0, (0.0, -0.08, 0.01))
FORWARD = pose(0.02, 0.0, 0.8)


def two_keyframes(T_world_second: np.ndarray, seed: int = 0, **look: float) -> SmallMap:
    """Two keyframes that see the same world and have no points yet."""
    small = SmallMap(SmallWorld.of(seed, 400))
    for T in (np.eye(4), T_world_second):
        small.add(T, make_points=False, **look)
    return small


def triangulated(small: SmallMap) -> tuple[np.ndarray, np.ndarray]:
    """Return the new points' ids and which points of the world they should be, checking that both views agree."""
    ids = by_triangulation(1, [0], CAMERA, small.map)
    place, rows = small.map.observations(ids)
    numbers = np.concatenate(small.seen)[rows]
    keyframes = small.map.keypoints.keyframe[rows]
    assert sorted(zip(place.tolist(), keyframes.tolist(), strict=True)) == [
        (i, k) for i in range(len(ids)) for k in (0, 1)
    ]
    assert np.all(numbers[keyframes == 0] == numbers[keyframes == 1])
    return ids, numbers[keyframes == 1]


def in_both(small: SmallMap) -> np.ndarray:
    return np.intersect1d(*small.seen)


@pytest.mark.parametrize("T_world_second", [SIDE, FORWARD], ids=["side", "forward"])
@pytest.mark.parametrize("depth_share", [0.0, 0.5, 1.0])
def test_points_lie_where_they_are(T_world_second: np.ndarray, depth_share: float) -> None:
    small = two_keyframes(T_world_second, depth_share=depth_share, flips=10)
    ids, numbers = triangulated(small)
    # Forward motion has little parallax in the middle of the image: without depth those points are left out.
    assert len(ids) > (0.5 if depth_share == 0 else 0.9) * len(in_both(small))
    np.testing.assert_allclose(small.map.points.position_m[ids], small.world.points_m[numbers], atol=0.02)
    error_m = np.linalg.norm(small.map.points.position_m[ids] - small.world.points_m[numbers], axis=1)
    assert np.median(error_m) < 1e-3
    assert np.all(small.map.points.first_keyframe[ids] == 1)
    assert np.all(small.map.points.n_keyframes[ids] == 2)
    np.testing.assert_allclose(np.linalg.norm(small.map.points.normal[ids], axis=1), 1)


def test_noise_of_a_pixel_leaves_errors_of_what_it_stands_for() -> None:
    small = two_keyframes(SIDE, depth_share=0.0, noise_px=0.5)
    ids, numbers = triangulated(small)
    z = small.world.points_m[numbers, 2]
    error_m = np.abs(small.map.points.position_m[ids, 2] - z)
    expected_m = z**2 / (CAMERA.fx * 0.4)  # depth error per pixel of disparity
    assert 0.2 < np.median(error_m / expected_m) < 2


def test_a_neighbour_nearer_than_the_stereo_baseline_is_left_out() -> None:
    assert len(triangulated(two_keyframes(pose(0.9 * CAMERA.baseline_m)))[0]) == 0
    assert len(triangulated(two_keyframes(pose(1.5 * CAMERA.baseline_m)))[0]) > 0


def test_far_points_without_parallax_need_depth() -> None:
    for depth_share, share in ((0.0, 0.0), (1.0, 0.9)):
        small = SmallMap(SmallWorld.of(0, 300, near_m=14.0, far_m=16.0))
        for T in (np.eye(4), pose(0.1)):
            small.add(T, make_points=False, depth_share=depth_share)
        ids, numbers = triangulated(small)
        assert len(ids) >= share * len(in_both(small))
        assert depth_share or len(ids) == 0
        np.testing.assert_allclose(small.map.points.position_m[ids], small.world.points_m[numbers], atol=0.01)


def test_where_depth_tells_more_than_parallax_depth_is_used() -> None:
    # A step forwards gives hardly any parallax; a third of a pixel would throw triangulated points about.
    small = two_keyframes(pose(0.02, 0.0, 0.15), noise_px=0.3)
    ids, numbers = triangulated(small)
    assert len(ids) > 0.8 * len(in_both(small))
    error_m = np.linalg.norm(small.map.points.position_m[ids] - small.world.points_m[numbers], axis=1)
    assert np.percentile(error_m / small.world.points_m[numbers, 2], 90) < 2 / CAMERA.fx


def test_new_points_know_both_views() -> None:
    small = two_keyframes(SIDE, flips=10)
    ids, _ = triangulated(small)
    normals = small.map.points.normal[ids].copy()
    small.map.refresh(ids)
    np.testing.assert_array_equal(small.map.points.normal[ids], normals)


def test_of_two_depths_the_nearer_one_is_used() -> None:
    small = two_keyframes(FORWARD)
    small.map.keypoints.depth_m[small.map.rows(0)] *= 1.001  # the farther view's depth is a little wrong
    ids, numbers = triangulated(small)
    np.testing.assert_allclose(small.map.points.position_m[ids], small.world.points_m[numbers], atol=1e-3)


@pytest.mark.parametrize(("levels", "is_fair"), [((0, 3), True), ((3, 0), True), ((0, 4), False), ((4, 0), False)])
def test_levels_that_contradict_the_distances_are_refused(levels: tuple[int, int], is_fair: bool) -> None:
    # Sideways all distances stay alike; 1.5 · 1.2 is what the sizes may differ, 1.2³ = 1.73 and 1.2⁴ = 2.07.
    small = two_keyframes(SIDE, depth_share=0.0)
    for k, level in enumerate(levels):
        small.map.keypoints.octave[small.map.rows(k)] = level
    share = len(triangulated(small)[0]) / len(in_both(small))
    assert share > 0.7 if is_fair else share < 0.05


def test_a_point_that_halves_its_distance_may_climb_four_levels() -> None:
    # 1.2⁴ = 2.07: half as far, twice as large. Points stand at 4 m, the camera walks 2 m towards them.
    small = SmallMap(SmallWorld.of(0, 400, near_m=4.0, far_m=4.1))
    for T in (np.eye(4), pose(0.3, 0.0, 2.0)):
        small.add(T, make_points=False, depth_share=0.0)
    octave = small.map.keypoints.octave
    octave[small.map.rows(0)], octave[small.map.rows(1)] = 1, 5
    assert len(triangulated(small)[0]) > 0.7 * len(in_both(small))
    small = SmallMap(SmallWorld.of(0, 400, near_m=4.0, far_m=4.1))
    for T in (np.eye(4), pose(0.3, 0.0, 2.0)):
        small.add(T, make_points=False, depth_share=0.0)
    octave = small.map.keypoints.octave
    octave[small.map.rows(0)], octave[small.map.rows(1)] = 5, 1
    assert len(triangulated(small)[0]) == 0


def test_moving_keypoints_and_those_that_see_a_point_take_no_part() -> None:
    small = two_keyframes(SIDE)
    rows = small.map.rows(1)
    small.map.keypoints.is_static[rows.start : rows.start + 50] = False
    taken = np.arange(rows.start + 50, rows.start + 80)
    old = small.map.add_points(np.zeros((30, 3)), taken)
    ids, numbers = triangulated(small)
    assert not np.isin(numbers, small.seen[1][:80]).any()
    np.testing.assert_array_equal(small.map.keypoints.point[taken], old)
    assert len(ids) > 100


def test_what_meets_behind_a_camera_or_off_its_depth_is_no_point() -> None:
    swapped = two_keyframes(pose(0.4), depth_share=0.0)
    T = swapped.map.keyframes.T_world_cam
    T[:2] = T[1::-1]  # each camera stands where the other one was: rays meet behind them
    assert len(triangulated(swapped)[0]) == 0
    lying = two_keyframes(SIDE)
    table, rows = lying.map.keypoints, lying.map.rows(1)
    table.right_px[rows] += 12.0  # disparity that contradicts the parallax
    rows_of_new = lying.map.observations(triangulated(lying)[0])[1]
    believed = rows_of_new[rows_of_new >= rows.start]
    assert np.all(table.right_px[believed] < 0)  # where it lies outside the image nothing contradicts
    assert len(believed) < 5


def some_pairs(T_world_second: np.ndarray, depth_share: float) -> tuple[SmallMap, np.ndarray, np.ndarray]:
    """Two keyframes' rows (M,) that see one point of the world each, a tenth of them wrongly paired."""
    small = two_keyframes(T_world_second, depth_share=depth_share, noise_px=0.5)
    _, first, second = np.intersect1d(*small.seen, return_indices=True)
    second[::10] = np.roll(second[::10], 1)
    return small, first, small.map.rows(1).start + second


def columns(small: SmallMap) -> new_points._Seen:
    table = small.map.keypoints
    return new_points._Seen(table.px, table.depth_m, table.right_px, table.octave)


LENS = (CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy, CAMERA.bf)


@pytest.mark.parametrize("depth_share", [0.0, 0.5, 1.0])
def test_the_way_is_that_of_the_larger_parallax(depth_share: float) -> None:
    small, first, second = some_pairs(FORWARD, depth_share)
    poses, table = small.map.keyframes.T_world_cam, small.map.keypoints
    ways = new_points.choose_ways(first, second, columns(small), (poses[0], poses[1]), LENS, 0.9998)
    rays = [CAMERA.back_project(table.px[rows], np.ones(len(rows))) for rows in (first, second)]
    a, b = (r @ T[:3, :3].T / np.linalg.norm(r, axis=1, keepdims=True) for r, T in zip(rays, poses, strict=True))
    cosine = (a * b).sum(axis=1)
    half = CAMERA.baseline_m / 2
    depths = [table.depth_m[rows].astype(np.float64) for rows in (first, second)]
    stereo = [np.where(d > 0, np.cos(2 * np.arctan2(half, np.where(d > 0, d, 1))), 2.0) for d in depths]
    for i, way in enumerate(ways.tolist()):
        mine, theirs = stereo[0][i], stereo[1][i]
        has_depth = min(mine, theirs) < 1
        if 0 < cosine[i] < (min(mine, theirs) if has_depth else 0.9998):
            assert way == new_points.BY_RAYS
        elif not has_depth:
            assert way == new_points.BY_NOTHING
        else:
            assert way == (new_points.BY_SECOND if theirs <= mine else new_points.BY_FIRST)
    assert len(np.unique(ways)) > 1


def test_what_does_not_project_to_where_it_was_seen_is_no_point() -> None:
    small, first, second = some_pairs(SIDE, 0.5)
    world, table = small.map, small.map.keypoints
    positions_m = small.world.points_m[small.seen[0][first]].copy()
    positions_m[::7, 2] *= -1
    T_cam_world = se3.inverse(world.keyframes.T_world_cam[1])
    good = np.ones(len(first), dtype=bool)
    new_points.check(positions_m, second, columns(small), T_cam_world, LENS, world.scales.inverse_variances, good)
    cam = se3.transform(T_cam_world, positions_m)
    px, right_px = CAMERA.project(cam), table.right_px[second]
    error2 = ((px - table.px[second]) ** 2).sum(axis=1)
    error2 += np.where(right_px >= 0, (px[:, 0] - CAMERA.bf / cam[:, 2] - right_px) ** 2, 0)
    limit = np.where(right_px >= 0, 7.815, 5.991) / world.scales.inverse_variances[table.octave[second]]
    np.testing.assert_array_equal(good, (cam[:, 2] > 0) & (error2 <= limit))
    assert 0.1 < good.mean() < 0.9


def test_levels_must_fit_the_distances() -> None:
    rng = np.random.default_rng(0)
    factors, first, second = 1.2 ** np.arange(8), *rng.integers(0, 8, (2, 300)).astype(np.int32)
    positions_m, there = rng.uniform(1, 4, (300, 3)), pose(0.8)
    good = np.ones(300, dtype=bool)
    new_points.check_scales(positions_m, first, second, np.eye(4), there, factors, 1.8, good)
    near, far = (np.linalg.norm(positions_m - T[:3, 3], axis=1) for T in (np.eye(4), there))
    quotient = far / near / (factors[first] / factors[second])
    np.testing.assert_array_equal(good, (quotient < 1.8) & (quotient > 1 / 1.8))
    assert 0.2 < good.mean() < 0.9


def far_look_alikes(n: int = 300) -> SmallWorld:
    """Far points in pairs that look the same and lie on one row of the image, 12 to 60 pixels apart."""
    rng = np.random.default_rng(5)
    left = np.stack((rng.uniform(20, 500, n), rng.uniform(20, 460, n)), axis=1)
    px = np.concatenate((left, left + np.stack((rng.uniform(12, 60, n), np.zeros(n)), axis=1)))
    z = rng.uniform(5.0, 7.0, 2 * n)
    descriptors, angle_rad = rng.integers(0, 256, (n, 32), dtype=np.uint8), rng.uniform(-np.pi, np.pi, n)
    return SmallWorld(CAMERA.back_project(px, z), np.tile(descriptors, (2, 1)), np.tile(angle_rad, 2), 2.0 * z)


def far_pairs(limits: PairLimits, angle_rad: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Which points that a short way makes of far look-alikes are right (M,), and their depth (M,) [m], truly 5 to 7.

    A right pair has about .75° of parallax, a wrong one often more.
    """
    world = far_look_alikes()
    world.angle_rad = world.angle_rad if angle_rad is None else angle_rad
    small = SmallMap(world)
    for T in (np.eye(4), pose(0.08)):
        small.add(T, make_points=False, depth_share=0.0, noise_px=0.3, flips=10)
    ids = by_triangulation(1, [0], CAMERA, small.map, limits)
    assert len(ids) > 50
    _, rows = small.map.observations(ids)
    numbers = np.concatenate(small.seen)[rows]
    is_second = small.map.keypoints.keyframe[rows] == 1
    return numbers[is_second] == numbers[~is_second], small.map.points.position_m[ids, 2]


def test_where_all_is_far_little_parallax_tells_more_than_wrong_pairs_do() -> None:
    is_right, depth_m = far_pairs(PairLimits())
    assert is_right.mean() < 0.1
    assert np.median(depth_m) < 3.0, "ORB-SLAM2's least parallax keeps wrong pairs alone, which stand too near"
    is_right, depth_m = far_pairs(PairLimits(largest_cosine=0.99995))
    assert is_right.mean() > 0.5
    assert np.median(depth_m) > 4.0


def test_pairs_whose_orientations_differ_are_no_points() -> None:
    angle_rad = np.repeat((0.0, 1.0), 300)  # of two that look the same, one is turned
    limits = PairLimits(largest_cosine=0.99995, most_turned_rad=np.radians(20.0))
    assert far_pairs(limits, angle_rad)[0].all()
    assert not far_pairs(PairLimits(largest_cosine=0.99995), angle_rad)[0].all()


@pytest.mark.parametrize("roll_rad", [0.0, 1.2, -3.0])
def test_orientations_are_compared_less_the_cameras_roll(roll_rad: float) -> None:
    small = two_keyframes(pose(0.4, 0.0, 0.0, (0.0, 0.0, roll_rad)), depth_share=0.0)
    rows = small.map.rows(1)
    small.map.keypoints.angle_rad[rows.start : rows.stop] -= roll_rad  # a camera that rolls sees all turned back
    n = len(by_triangulation(1, [0], CAMERA, small.map, PairLimits(most_turned_rad=0.1)))
    again = two_keyframes(pose(0.4, 0.0, 0.0, (0.0, 0.0, roll_rad)), depth_share=0.0)
    assert n == len(triangulated(again)[0]) > 50


def test_only_a_single_camera_locates_points_by_so_little_parallax() -> None:
    for sensor, cosine, turned_deg in ((Sensor.RGBD, 0.9998, 180.0), (Sensor.MONOCULAR, 0.99995, 20.0)):
        mapping = build(configure("orb-slam2"), CAMERA, sensor=sensor).mapper.config
        assert (mapping.largest_cosine, mapping.most_turned_deg) == (cosine, turned_deg)
