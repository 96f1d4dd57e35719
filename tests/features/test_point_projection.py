"""Where map points should appear, against OpenCV's projection and ORB-SLAM2's rules written plainly."""

import cv2
import numpy as np
import pytest

from stillroom.data.frame import ScaleLevels
from stillroom.data.sensor import Sensor
from stillroom.features.projection import PointGeometry, Projection, project_points
from stillroom.geometry import se3
from stillroom.geometry.camera import Camera

CAMERA = Camera(640, 480, 517.3, 516.5, 318.6, 255.3, (0.26, -0.95, -0.005, 0.0026, 1.16))
FACTORS = ScaleLevels().factors


def random_points(seed: int, n: int = 2000) -> PointGeometry:
    """Points all around the camera, with viewing geometries of which about half fit."""
    rng = np.random.default_rng(seed)
    points = rng.uniform([-4, -4, -1.5], [4, 4, 6.5], (n, 3))
    normals = points + rng.normal(0, 2.0, (n, 3))
    max_distance_m = np.linalg.norm(points, axis=1) * rng.uniform(0.5, 6.0, n)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return PointGeometry(points, normals, max_distance_m / FACTORS[-1], max_distance_m)


T_CAM_WORLD = se3.exp(np.array([0.3, -0.2, 0.1, 0.1, -0.2, 0.05]))


def project(points: PointGeometry, T_cam_world: np.ndarray = T_CAM_WORLD, **rest: float) -> Projection:
    return project_points(T_cam_world, CAMERA, FACTORS, points, **rest)


@pytest.mark.parametrize("seed", range(3))
def test_pixels_are_opencvs_and_rules_are_orb_slam2s(seed: int) -> None:
    points = random_points(seed)
    found = project(points)
    p_world = points.position_m
    p_cam = se3.transform(T_CAM_WORLD, p_world)
    rotation, translation = cv2.Rodrigues(T_CAM_WORLD[:3, :3])[0], T_CAM_WORLD[:3, 3]
    px = cv2.projectPoints(p_world, rotation, translation, CAMERA.K, None)[0].reshape(-1, 2)
    x_min, y_min, x_max, y_max = CAMERA.undistorted_bounds_px
    assert (x_min, y_min) != (0, 0)
    visible = (p_cam[:, 2] > 0.05) & (px[:, 0] >= x_min) & (px[:, 0] <= x_max)
    visible &= (px[:, 1] >= y_min) & (px[:, 1] <= y_max)
    ray = p_world - se3.inverse(T_CAM_WORLD)[:3, 3]
    distance_m = np.linalg.norm(ray, axis=1)
    visible &= (distance_m >= 0.8 * points.min_distance_m) & (distance_m <= 1.2 * points.max_distance_m)
    view_cos = (ray * points.normal).sum(axis=1) / distance_m
    before_angle = visible.copy()
    visible &= view_cos >= 0.5
    assert 100 < visible.sum() < before_angle.sum()
    np.testing.assert_array_equal(found.visible, visible)
    np.testing.assert_allclose(found.px[visible], px[visible], atol=1e-3)
    np.testing.assert_allclose(found.depth_m, p_cam[:, 2], atol=1e-12)
    right_px = px[visible, 0] - CAMERA.bf / p_cam[visible, 2]
    np.testing.assert_allclose(found.right_px[visible], right_px, atol=1e-3)
    np.testing.assert_allclose(found.view_cos[visible], view_cos[visible], atol=1e-6)
    level = np.ceil(np.log(points.max_distance_m / distance_m) / np.log(1.2))[visible]
    np.testing.assert_array_equal(found.octave[visible], np.clip(level, 0, len(FACTORS) - 1))
    assert len(np.unique(found.octave[visible])) == len(FACTORS)


def test_a_point_is_expected_on_the_level_where_it_was_found() -> None:
    for octave in range(8):
        max_distance_m = np.array([2.0 * FACTORS[octave] * 0.999])
        place, direction = np.array([[0.0, 0.0, 2.0]]), np.array([[0.0, 0.0, 1.0]])
        at = PointGeometry(place, direction, max_distance_m / FACTORS[-1], max_distance_m)
        assert project(at, np.eye(4)).octave[0] == octave


@pytest.mark.parametrize("seed", range(2))
def test_another_camera_expects_a_point_where_as_many_pixels_see_it(seed: int) -> None:
    """Of a map made by a camera of 500 pixels; the levels by the size of the keypoint's patch, in metres and pixels."""
    rng, map_focal_px, n = np.random.default_rng(seed), 500.0, 400
    small = ScaleLevels(focal_px=map_focal_px)
    for width, focal_px in ((640, 500.0), (640, 900.0), (1280, 1000.0), (480, 200.0)):
        camera = Camera(width, width * 3 // 4, focal_px, focal_px, width / 2, width * 3 / 8)
        own = ScaleLevels.of(camera, Sensor.RGBD, 1.2, 8)
        octave, seen_from_m, z = rng.integers(0, 8, n), rng.uniform(1.0, 4.0, n), rng.uniform(0.5, 8.0, n)
        patch_m = FACTORS[octave] * 31.0 * seen_from_m / map_focal_px
        at = np.stack((np.zeros(n), np.zeros(n), z), axis=1)
        max_distance_m = seen_from_m * FACTORS[octave]
        points = PointGeometry(at, np.tile([0.0, 0.0, 1.0], (n, 1)), max_distance_m / FACTORS[-1], max_distance_m)
        found = project_points(np.eye(4), camera, own.factors, points, reach=own.reach(small))
        in_finest_px = patch_m * focal_px / z / own.finest_px
        level = np.log(in_finest_px / 31.0) / np.log(1.2)
        slack = np.log([1.2, 0.8]) / np.log(1.2)
        np.testing.assert_array_equal(found.visible, (level > -slack[0]) & (level < 7 - slack[1]))
        assert 50 < found.visible.sum() < n
        expected = np.clip(np.ceil(level), 0, 7)[found.visible]
        np.testing.assert_array_equal(found.octave[found.visible], expected)


def test_pyramids_of_one_camera_have_the_same_reach_to_the_bit() -> None:
    for sensor in Sensor:
        own = ScaleLevels.of(CAMERA, sensor, 1.2, 8)
        assert own.reach(ScaleLevels.of(CAMERA, sensor, 1.2, 8)) == 1.0
        assert own.reach(ScaleLevels()) == ScaleLevels().reach(own) == 1.0, "where it is not known of one"


def test_the_least_viewing_cosine_is_an_option() -> None:
    points = random_points(0)
    strict, loose = project(points, min_view_cos=0.9).visible, project(points, min_view_cos=-1.0).visible
    assert np.all(loose[strict])
    assert strict.sum() < project(points).visible.sum() < loose.sum()


def test_no_points_and_one_level_are_fine() -> None:
    assert len(project(random_points(0, 0)).px) == 0
    single = project_points(T_CAM_WORLD, CAMERA, np.ones(1), random_points(0, 50))
    assert not single.octave.any()
