from dataclasses import replace

import numpy as np
import pytest
from bundle_problems import bundle, bundle_chi_squares, huber_cost, with_start
from optimize_problems import CAMERA, limits, pose_distance

from stillroom.geometry import se3
from stillroom.optimize.bundle import BundleAdjuster, BundleConfig, BundleProblem, BundleResult

NO_GTSAM = "gtsam is not installed; there is no wheel of it for Windows"
TO_THE_END = {"iterations_first": 200, "min_relative_decrease": 1e-13}


def gtsam_minimum(problem: BundleProblem, use: np.ndarray, robust: bool) -> tuple[np.ndarray, np.ndarray, float]:
    """GTSAM's poses, points and Σρ; its error is half of ours, and its Huber k the square root of our δ²."""
    gtsam = pytest.importorskip("gtsam", reason=NO_GTSAM)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    mono = gtsam.Cal3_S2(CAMERA.fx, CAMERA.fy, 0.0, CAMERA.cx, CAMERA.cy)
    stereo = gtsam.Cal3_S2Stereo(CAMERA.fx, CAMERA.fy, 0.0, CAMERA.cx, CAMERA.cy, CAMERA.bf / CAMERA.fx)
    for k, T in enumerate(problem.T_cam_world):
        values.insert(gtsam.symbol("c", k), gtsam.Pose3(se3.inverse(T)))
        if problem.is_fixed[k]:
            graph.add(gtsam.NonlinearEqualityPose3(gtsam.symbol("c", k), gtsam.Pose3(se3.inverse(T))))
    for p in np.unique(problem.obs_point[use]):
        values.insert(gtsam.symbol("p", int(p)), problem.points_world_m[p])
    for o in np.flatnonzero(use):
        keys = gtsam.symbol("c", int(problem.obs_keyframe[o])), gtsam.symbol("p", int(problem.obs_point[o]))
        weight, (u, v, r) = problem.weights[o], problem.observed_px[o]
        sigmas = 1.0 / np.sqrt(weight[[0, 2, 1]] if weight[2] > 0 else weight[:2])
        noise = gtsam.noiseModel.Diagonal.Sigmas(sigmas)
        if problem.p_static is not None:
            # Half of Σpρ(χ²) is the cost of a measurement with 1/p times the variance and Huber's k times √p.
            noise = gtsam.noiseModel.Diagonal.Sigmas(sigmas / np.sqrt(problem.p_static[o]))
        if robust:
            k = float(np.sqrt(limits(weight[None])[0] * (1.0 if problem.p_static is None else problem.p_static[o])))
            noise = gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Huber.Create(k), noise)
        if weight[2] > 0:
            graph.add(gtsam.GenericStereoFactor3D(gtsam.StereoPoint2(u, r, v), noise, *keys, stereo))
        else:
            graph.add(gtsam.GenericProjectionFactorCal3_S2(np.array([u, v]), noise, *keys, mono))
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(200)
    parameters.setRelativeErrorTol(1e-14)
    parameters.setAbsoluteErrorTol(1e-12)
    found = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
    T = [se3.inverse(found.atPose3(gtsam.symbol("c", k)).matrix()) for k in range(len(problem.T_cam_world))]
    points = problem.points_world_m.copy()
    for p in np.unique(problem.obs_point[use]):
        points[p] = found.atPoint3(gtsam.symbol("p", int(p)))
    return np.stack(T), points, 2.0 * graph.error(found)


def largest_distance(T_a: np.ndarray, T_b: np.ndarray) -> float:
    return max(max(pose_distance(a, b)) for a, b in zip(T_a, T_b, strict=True))


def check_sound(result: BundleResult, problem: BundleProblem) -> None:
    assert np.isfinite(result.T_cam_world).all()
    assert np.isfinite(result.points_world_m).all()
    assert result.is_inlier.shape == problem.obs_point.shape
    assert np.isfinite([result.initial_cost, result.final_cost]).all()
    np.testing.assert_array_equal(result.T_cam_world[problem.is_fixed], problem.T_cam_world[problem.is_fixed])


@pytest.mark.parametrize("seed", range(5))
def test_the_first_pass_finds_gtsams_huber_minimum(seed: int) -> None:
    # Points seen five times or so: one seen twice, once wrongly, has a local minimum at every camera's plane.
    problem = bundle(seed, share=0.9).problem
    result = BundleConfig(iterations_second=0, **TO_THE_END).build()(problem, CAMERA)
    everything = np.ones(len(problem.obs_point), dtype=bool)
    T, points, cost = gtsam_minimum(problem, everything, robust=True)
    # Same convention, same minimum. The cost is flat there, so poses agree to about the root of the cost's agreement.
    assert huber_cost(problem, T, points) == pytest.approx(cost, rel=1e-9)
    assert result.final_cost == pytest.approx(cost, rel=1e-6)
    assert result.final_cost == pytest.approx(huber_cost(problem, result.T_cam_world, result.points_world_m), rel=1e-9)
    assert result.initial_cost == pytest.approx(
        huber_cost(problem, problem.T_cam_world, problem.points_world_m), rel=1e-9
    )
    assert largest_distance(result.T_cam_world, T) < 1e-4


@pytest.mark.parametrize("seed", range(3))
def test_observations_weigh_as_much_as_their_points_are_likely_to_be_static(seed: int) -> None:
    plain = bundle(seed, share=0.9).problem
    problem = replace(plain, p_static=np.random.default_rng(seed).uniform(0.1, 1.0, len(plain.obs_point)))
    adjust = BundleConfig(iterations_second=0, **TO_THE_END).build()
    result = adjust(problem, CAMERA)
    T, _, cost = gtsam_minimum(problem, np.ones(len(problem.obs_point), dtype=bool), robust=True)
    assert result.final_cost == pytest.approx(cost, rel=1e-6)
    assert largest_distance(result.T_cam_world, T) < 1e-4
    without, ones = adjust(plain, CAMERA), adjust(replace(plain, p_static=np.ones(len(plain.obs_point))), CAMERA)
    np.testing.assert_array_equal(without.T_cam_world, ones.T_cam_world)
    np.testing.assert_array_equal(without.points_world_m, ones.points_world_m)
    assert largest_distance(result.T_cam_world, without.T_cam_world) > 1e-4, "it makes a difference"


@pytest.mark.parametrize("seed", range(3))
def test_a_smaller_deviation_of_right_coordinates_is_a_larger_weight(seed: int) -> None:
    plain = bundle(seed, share=0.9).problem
    heavier = replace(plain, weights=plain.weights * (1.0, 1.0, 4.0))
    result = BundleConfig(right_sigma=0.5).build()(plain, CAMERA)
    expected = BundleConfig().build()(heavier, CAMERA)
    np.testing.assert_array_equal(result.T_cam_world, expected.T_cam_world)
    np.testing.assert_array_equal(result.is_inlier, expected.is_inlier)
    assert largest_distance(result.T_cam_world, BundleConfig().build()(plain, CAMERA).T_cam_world) > 1e-5


@pytest.mark.parametrize("seed", range(5))
def test_the_result_is_gtsams_least_squares_minimum_of_the_kept_observations(seed: int) -> None:
    problem = bundle(50 + seed).problem
    config = BundleConfig(iterations_second=200, **TO_THE_END)
    first = replace(config, iterations_second=0).build()(problem, CAMERA)
    result = config.build()(problem, CAMERA)
    T, _, cost = gtsam_minimum(
        with_start(problem, first.T_cam_world, first.points_world_m), first.is_inlier, robust=False
    )
    chi2 = bundle_chi_squares(problem, result.T_cam_world, result.points_world_m)
    assert chi2[first.is_inlier].sum() == pytest.approx(cost, rel=1e-6)
    assert largest_distance(result.T_cam_world, T) < 1e-4
    np.testing.assert_array_equal(result.is_inlier, chi2 <= limits(problem.weights))


def test_the_defaults_stop_far_within_the_uncertainty() -> None:
    made = bundle(3, keyframes=12, fixed=4, points=300)
    quick = BundleAdjuster()(made.problem, CAMERA)
    exact = BundleConfig(iterations_second=200, **TO_THE_END).build()(made.problem, CAMERA)
    uncertainty = largest_distance(exact.T_cam_world, made.T_true)
    assert quick.n_iterations <= 15 < exact.n_iterations
    assert largest_distance(quick.T_cam_world, exact.T_cam_world) < 0.1 * uncertainty
    assert np.mean(quick.is_inlier == exact.is_inlier) > 0.99


@pytest.mark.parametrize("seed", range(3))
def test_poses_and_points_get_better_and_wrong_observations_leave(seed: int) -> None:
    made = bundle(80 + seed, keyframes=10, fixed=3, points=200, noise=0.2)
    result = BundleAdjuster()(made.problem, CAMERA)
    check_sound(result, made.problem)
    assert result.final_cost < 0.5 * result.initial_cost
    before = largest_distance(made.problem.T_cam_world, made.T_true)
    assert largest_distance(result.T_cam_world, made.T_true) < 0.3 * before
    error = np.linalg.norm(result.points_world_m - made.points_true, axis=1)
    error_before = np.linalg.norm(made.problem.points_world_m - made.points_true, axis=1)
    assert np.median(error) < 0.7 * np.median(error_before)
    assert np.mean(result.is_inlier[made.is_wrong]) < 0.02
    assert np.mean(result.is_inlier[~made.is_wrong]) > 0.9


@pytest.mark.parametrize("seed", [5, 11])
def test_no_point_gets_stuck_behind_a_camera(seed: int) -> None:
    """Plain steps carry a wrongly observed point through a camera here, to a minimum at twice the cost."""
    made = bundle(seed)
    adjust = BundleConfig(iterations_second=0, **TO_THE_END).build()
    from_the_truth = adjust(with_start(made.problem, made.T_true, made.points_true), CAMERA)
    assert adjust(made.problem, CAMERA).final_cost == pytest.approx(from_the_truth.final_cost, rel=1e-6)


def test_exact_observations_give_exact_poses_and_points() -> None:
    made = bundle(5, wrong=0.0, noise=0.0)
    result = BundleConfig(min_relative_decrease=0.0).build()(made.problem, CAMERA)
    seen_twice = np.bincount(made.problem.obs_point, minlength=80) >= 2
    assert largest_distance(result.T_cam_world, made.T_true) < 1e-8
    np.testing.assert_allclose(result.points_world_m[seen_twice], made.points_true[seen_twice], atol=1e-7)
    assert result.is_inlier.all()


def test_the_order_of_observations_does_not_matter() -> None:
    problem = bundle(6).problem
    shuffled = np.random.default_rng(0).permutation(len(problem.obs_point))
    other = replace(
        problem,
        obs_keyframe=problem.obs_keyframe[shuffled],
        obs_point=problem.obs_point[shuffled],
        observed_px=problem.observed_px[shuffled],
        weights=problem.weights[shuffled],
    )
    a, b = BundleAdjuster()(problem, CAMERA), BundleAdjuster()(other, CAMERA)
    np.testing.assert_array_equal(a.T_cam_world, BundleAdjuster()(problem, CAMERA).T_cam_world)
    np.testing.assert_allclose(a.T_cam_world, b.T_cam_world, atol=1e-9)
    np.testing.assert_array_equal(a.is_inlier[shuffled], b.is_inlier)


@pytest.mark.parametrize("seed", range(3))
def test_the_input_is_left_as_it_was(seed: int) -> None:
    problem = bundle(seed).problem
    T, points = problem.T_cam_world.copy(), problem.points_world_m.copy()
    BundleAdjuster()(problem, CAMERA)
    np.testing.assert_array_equal(problem.T_cam_world, T)
    np.testing.assert_array_equal(problem.points_world_m, points)


@pytest.mark.parametrize(("keyframes", "fixed", "points"), [(0, 0, 0), (3, 1, 0), (3, 3, 10), (3, 0, 10)])
def test_nothing_observed_changes_nothing(keyframes: int, fixed: int, points: int) -> None:
    problem = BundleProblem(
        np.stack([np.eye(4)] * keyframes) if keyframes else np.zeros((0, 4, 4)),
        np.arange(keyframes) < fixed,
        np.ones((points, 3)),
        np.zeros(0, np.int32),
        np.zeros(0, np.int32),
        np.zeros((0, 3)),
        np.zeros((0, 3)),
    )
    result = BundleAdjuster()(problem, CAMERA)
    check_sound(result, problem)
    np.testing.assert_array_equal(result.T_cam_world, problem.T_cam_world)
    np.testing.assert_array_equal(result.points_world_m, problem.points_world_m)
    assert result.initial_cost == result.final_cost == result.n_iterations == 0


def test_with_all_keyframes_fixed_the_points_are_triangulated() -> None:
    made = bundle(7, fixed=6, wrong=0.0, noise=0.2)
    result = BundleAdjuster()(made.problem, CAMERA)
    check_sound(result, made.problem)
    error = np.linalg.norm(result.points_world_m - made.points_true, axis=1)
    assert np.median(error) < 0.7 * np.median(np.linalg.norm(made.problem.points_world_m - made.points_true, axis=1))


def test_with_no_keyframe_fixed_the_cost_still_falls() -> None:
    made = bundle(8, fixed=0)
    result = BundleAdjuster()(made.problem, CAMERA)
    check_sound(result, made.problem)
    assert result.final_cost < 0.5 * result.initial_cost


def test_points_behind_every_camera_are_outliers_and_stay() -> None:
    made = bundle(9, wrong=0.0)
    behind = made.problem.obs_point < 20
    made.problem.points_world_m[:20, 2] -= 20.0
    before = made.problem.points_world_m[:20].copy()
    result = BundleAdjuster()(made.problem, CAMERA)
    check_sound(result, made.problem)
    assert not result.is_inlier[behind].any()
    assert np.mean(result.is_inlier[~behind]) > 0.9
    np.testing.assert_array_equal(result.points_world_m[:20], before)


def test_everything_behind_changes_nothing() -> None:
    problem = bundle(10).problem
    problem.points_world_m[:, 2] -= 20.0
    result = BundleAdjuster()(problem, CAMERA)
    check_sound(result, problem)
    np.testing.assert_array_equal(result.points_world_m, problem.points_world_m)
    assert not result.is_inlier.any()


def test_a_point_seen_once_without_depth_is_harmless() -> None:
    made = bundle(11, wrong=0.0)
    first = np.flatnonzero(made.problem.obs_point == 0)
    made.problem.obs_point[first[1:]] = 1
    made.problem.observed_px[first[1:]] = made.problem.observed_px[first[1:]] + 500.0  # nonsense for point 1
    made.problem.weights[first[0], 2] = 0.0
    result = BundleAdjuster()(made.problem, CAMERA)
    check_sound(result, made.problem)
    assert result.is_inlier[first[0]]
    assert np.linalg.norm(result.points_world_m[0] - made.problem.points_world_m[0]) < 0.2


def test_numbers_that_are_not_finite_stay_outside() -> None:
    problem = bundle(12, wrong=0.0).problem
    problem.observed_px[0, 0] = np.nan
    problem.observed_px[problem.weights[:, 2] == 0, 2] = np.nan  # there is no right coordinate: must not be read
    problem.weights[1] = np.nan
    result = BundleAdjuster()(problem, CAMERA)
    check_sound(result, problem)
    assert not result.is_inlier[:2].any()
    assert np.mean(result.is_inlier[2:]) > 0.9


@pytest.mark.parametrize("seed", range(10))
def test_a_start_far_off_never_ends_worse_and_never_in_nan(seed: int) -> None:
    problem = bundle(seed, rough=30.0, wrong=0.3).problem
    result = BundleConfig(iterations_second=0).build()(problem, CAMERA)
    check_sound(result, problem)
    assert result.final_cost <= result.initial_cost
    check_sound(BundleAdjuster()(problem, CAMERA), problem)


def test_an_index_out_of_range_is_refused() -> None:
    problem = bundle(13).problem
    problem.obs_keyframe[0] = 6
    with pytest.raises(IndexError, match="keyframe"):
        BundleAdjuster()(problem, CAMERA)
    problem.obs_keyframe[0] = 0
    problem.obs_point[0] = -1
    with pytest.raises(IndexError, match="point"):
        BundleAdjuster()(problem, CAMERA)
