"""Depth by the noise of its sensor: weights by their formula, and minima against scipy's."""

from dataclasses import replace

import numpy as np
import pytest
from bundle_problems import bundle
from optimize_problems import CAMERA, pose_distance, pose_problem
from scipy.optimize import least_squares

from stillroom.geometry import se3
from stillroom.geometry.depth_noise import SENSORS, UNKNOWN
from stillroom.optimize import observations
from stillroom.optimize.bundle import BundleConfig
from stillroom.optimize.depth_terms import MeasuredDepth, RightCoordinate, depth_terms
from stillroom.optimize.pose import PoseOptimizer, PoseOptimizerConfig
from stillroom.optimize.rolling_pose import RollingPoseOptimizer

KINECT = replace(CAMERA, depth_noise="structured-light")
NO_LIMITS = PoseOptimizerConfig(rounds=4, iterations=50, chi2_2d=1e9, chi2_3d=1e9)


def sigma_m(z: np.ndarray) -> np.ndarray:
    """Nguyen, Izadi and Lovell 2012, and steps of 2.8 mm at 1 m."""
    return np.sqrt((0.0012 + 0.0019 * (z - 0.4) ** 2) ** 2 + (0.0028 * z**2) ** 2 / 12)


def test_structured_light_has_the_published_noise_and_time_of_flight_less_of_it_far_away() -> None:
    z = np.linspace(0.4, 8.0, 50)
    np.testing.assert_allclose(SENSORS["structured-light"].sigma_m(z), sigma_m(z), rtol=1e-9)
    flight = SENSORS["time-of-flight"].sigma_m(z)
    assert flight[0] > 0.001
    assert (flight[z > 2.0] < 0.4 * sigma_m(z)[z > 2.0]).all()


def test_the_third_coordinate_is_minus_the_disparity_with_the_sensors_deviation_and_the_least_one() -> None:
    p = pose_problem(1)
    is_known = p.weights[:, 2] > 0
    terms = MeasuredDepth(SENSORS["structured-light"], 0.5)(p.observed, p.weights, KINECT)
    d = p.observed[is_known, 0] - p.observed[is_known, 2]
    z = KINECT.bf / d
    variance = (KINECT.bf * sigma_m(z) / z**2) ** 2 + 0.25 / p.weights[is_known, 0]
    np.testing.assert_allclose(terms.weights[is_known, 2], 1.0 / variance, rtol=1e-9)
    np.testing.assert_allclose(terms.observed_px[is_known, 2], -d)
    assert (terms.weights[~is_known, 2] == 0.0).all()
    np.testing.assert_array_equal(terms.weights[:, :2], p.weights[:, :2])
    np.testing.assert_array_equal(terms.observed_px[:, :2], p.observed[:, :2])
    assert terms.intrinsics.tolist() == [*observations.intrinsics_of(KINECT)[:5], 0.0]


def test_without_a_known_sensor_a_depth_is_a_right_coordinate() -> None:
    p = pose_problem(2)
    for terms in (depth_terms("sensor", 0.5, CAMERA), depth_terms("right", 0.5, KINECT), RightCoordinate(0.5)):
        found = terms(p.observed, p.weights, CAMERA)
        np.testing.assert_array_equal(found.weights, p.weights * (1.0, 1.0, 4.0))
        np.testing.assert_array_equal(found.observed_px, p.observed)
        assert found.intrinsics[5] == 1.0
    assert CAMERA.depth_noise == UNKNOWN


def predicted(T: np.ndarray, points: np.ndarray) -> np.ndarray:
    x, y, z = se3.transform(T, points).T
    return np.stack((CAMERA.fx * x / z + CAMERA.cx, CAMERA.fy * y / z + CAMERA.cy, -CAMERA.bf / z), axis=1)


@pytest.mark.parametrize("seed", range(3))
def test_poses_are_scipys_minimum(seed: int) -> None:
    p = pose_problem(seed, n=80, wrong=0.0, noise=0.3)
    terms = depth_terms("sensor", 0.3, KINECT)(p.observed, p.weights, KINECT)

    def residuals(xi: np.ndarray) -> np.ndarray:
        T = se3.exp(xi) @ p.T_guess
        return (np.sqrt(terms.weights) * (predicted(T, p.points) - terms.observed_px)).ravel()

    expected = se3.exp(least_squares(residuals, np.zeros(6), xtol=1e-14, ftol=1e-14).x) @ p.T_guess
    given = p.T_guess, p.points, terms.observed_px, terms.weights, KINECT
    found = PoseOptimizer(NO_LIMITS)(*given, None, 0.0)
    assert max(pose_distance(found.T_cam_world, expected)) < 1e-6
    as_right = PoseOptimizer(NO_LIMITS)(p.T_guess, p.points, p.observed, p.weights, KINECT)
    assert max(pose_distance(as_right.T_cam_world, expected)) > 1e-4, "it makes a difference"
    rows = RollingPoseOptimizer(NO_LIMITS, np.full(6, 1e9))
    guess, points, observed, weights, camera = given
    rolling = rows(guess, np.zeros(6), points, observed, weights, np.zeros(len(points)), camera, None, 0.0)
    assert max(pose_distance(rolling.T_cam_world, expected)) < 1e-6


def test_a_bundle_is_scipys_minimum() -> None:
    problem = bundle(7, keyframes=4, fixed=1, points=25, share=0.9, wrong=0.0, noise=0.3).problem
    terms = depth_terms("sensor", 0.3, KINECT)(problem.observed_px, problem.weights, KINECT)
    free = np.flatnonzero(~problem.is_fixed)

    def residuals(step: np.ndarray) -> np.ndarray:
        T = problem.T_cam_world.copy()
        for k, xi in zip(free, step[: 6 * len(free)].reshape(-1, 6), strict=True):
            T[k] = se3.exp(xi) @ T[k]
        points = problem.points_world_m + step[6 * len(free) :].reshape(-1, 3)
        error = np.empty((len(problem.obs_point), 3))
        for k in range(len(T)):
            mine = problem.obs_keyframe == k
            error[mine] = predicted(T[k], points[problem.obs_point[mine]]) - terms.observed_px[mine]
        return (np.sqrt(terms.weights) * error).ravel()

    minimum = least_squares(residuals, np.zeros(6 * len(free) + problem.points_world_m.size), xtol=1e-12, ftol=1e-12)
    config = BundleConfig(
        iterations_first=60, iterations_second=0, chi2_2d=1e9, chi2_3d=1e9, min_relative_decrease=0.0,
        right_sigma=0.3, depth_model="sensor",
    )  # fmt: skip
    result = config.build()(problem, KINECT)
    assert result.final_cost == pytest.approx(2.0 * minimum.cost, rel=1e-6)
    as_right = replace(config, depth_model="right").build()(problem, KINECT)
    assert np.abs(as_right.T_cam_world - result.T_cam_world).max() > 1e-4
