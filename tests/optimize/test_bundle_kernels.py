import numpy as np
import pytest
from bundle_problems import bundle, bundle_chi_squares, dense_normal_equations, huber_cost
from optimize_problems import CAMERA, INTRINSICS, camera_jacobian, point_jacobian

from stillroom.geometry import se3
from stillroom.optimize import bundle_kernels
from stillroom.optimize.bundle import BundleProblem, _Adjustment
from stillroom.optimize.depth_terms import RightCoordinate
from stillroom.optimize.observations import point_information
from stillroom.optimize.reduced_system import DenseSystem, SparseSystem

LIMITS = (5.991, 7.815)
NO_KERNEL = (np.inf, np.inf)


@pytest.fixture
def problem() -> BundleProblem:
    """Small, with a point behind a camera, a doubled observation, an unseen point and an unseen keyframe."""
    made = bundle(1, keyframes=5, fixed=2, points=12).problem
    made.obs_point[made.obs_point == 11] = 10
    made.obs_keyframe[-1], made.obs_point[-1] = made.obs_keyframe[0], made.obs_point[0]
    lonely = int(np.flatnonzero(~made.is_fixed)[-1])
    made.obs_keyframe[made.obs_keyframe == lonely] = int(np.flatnonzero(~made.is_fixed)[0])
    k = int(made.obs_keyframe[3])
    made.points_world_m[made.obs_point[3]] = se3.transform(
        se3.inverse(made.T_cam_world[k]), np.array([[0.0, 0.1, -1.0]])
    )[0]
    return made


def some_active(work: _Adjustment) -> np.ndarray:
    work.is_active[:] = np.random.default_rng(0).random(len(work.is_active)) < 0.8
    in_problem_order = np.empty(len(work.is_active), dtype=bool)
    in_problem_order[work.order] = work.is_active
    return in_problem_order


def test_observations_are_sorted_by_point_then_by_keyframe_and_else_stay_in_order() -> None:
    rng = np.random.default_rng(3)
    points, slots = rng.integers(0, 40, 500), rng.integers(-1, 6, 500)
    starts, order = bundle_kernels.sort_observations(points, slots, 42)
    np.testing.assert_array_equal(order, np.lexsort((np.arange(500), slots, points)))
    np.testing.assert_array_equal(starts, np.searchsorted(np.sort(points), np.arange(43)))


def symmetric(lower: np.ndarray) -> np.ndarray:
    return np.tril(lower) + np.tril(lower, -1).T


def test_evaluate_matches_numpy(problem: BundleProblem) -> None:
    work = _Adjustment(problem, CAMERA, RightCoordinate())
    use = some_active(work)
    cost = work.evaluate(work.T, work.points, LIMITS)
    chi2 = bundle_chi_squares(problem, problem.T_cam_world, problem.points_world_m)
    assert np.isinf(chi2).any()
    np.testing.assert_allclose(work.chi2, chi2[work.order], rtol=1e-9)
    assert cost == pytest.approx(huber_cost(problem, problem.T_cam_world, problem.points_world_m, use), rel=1e-10)


@pytest.mark.parametrize("robust", [True, False])
def test_linearize_matches_numpy_with_numerical_jacobians(problem: BundleProblem, robust: bool) -> None:
    work = _Adjustment(problem, CAMERA, RightCoordinate())
    use = some_active(work)
    for block in work.blocks:
        block[:] = 7.0
    work.linearize(LIMITS if robust else NO_KERNEL)
    H_cc, b_c, H_pp, b_p, W = work.blocks
    H, b, begin = dense_normal_equations(problem, use, robust)
    tolerance = {"atol": 1e-6 * np.abs(H).max()}
    for f in range(len(H_cc)):
        at = slice(6 * f, 6 * f + 6)
        np.testing.assert_allclose(H_cc[f], np.tril(H[at, at]), **tolerance)
    for p, (h00, h10, h11, h20, h21, h22) in enumerate(H_pp):
        at = slice(begin + 3 * p, begin + 3 * p + 3)
        np.testing.assert_allclose([[h00, h10, h20], [h10, h11, h21], [h20, h21, h22]], H[at, at], **tolerance)
    np.testing.assert_allclose(np.concatenate((b_c.ravel(), b_p.ravel())), b, atol=1e-6 * np.abs(b).max())
    mixed = np.zeros((len(b) - begin, begin))
    points = np.asarray(problem.obs_point)[work.order]
    for o in range(len(work.order)):
        if work.seen.slots[o] >= 0:
            p, f = 3 * points[o], 6 * work.seen.slots[o]
            mixed[p : p + 3, f : f + 6] += W[o]
        if not work.is_active[o]:
            assert not W[o].any()
    np.testing.assert_allclose(mixed, H[begin:, :begin], **tolerance)


def test_factor_points_is_cholesky_and_leaves_out_what_has_none() -> None:
    rng = np.random.default_rng(2)
    J = rng.normal(size=(4, 7, 3))
    blocks = np.einsum("nki,nkj->nij", J, J)
    blocks[2] = 0.0
    blocks[3] = -np.eye(3)
    L = np.empty((4, 6))
    bundle_kernels.factor_points(blocks[:, *np.tril_indices(3)], 0.1, L)
    for p in range(2):
        i0, l10, i1, l20, l21, i2 = L[p]
        factor = np.array([[1 / i0, 0, 0], [l10, 1 / i1, 0], [l20, l21, 1 / i2]])
        np.testing.assert_allclose(factor @ factor.T, blocks[p] + 0.1 * np.diag(np.diag(blocks[p])), rtol=1e-7)
    assert np.isfinite(L[2]).all()
    assert not L[3].any()


@pytest.mark.parametrize("damping", [1e-4, 0.5])
def test_a_step_solves_the_whole_damped_system(problem: BundleProblem, damping: float) -> None:
    """Schur complement, back-substitution and updates against one dense solve of cameras and points together."""
    work = _Adjustment(problem, CAMERA, RightCoordinate())
    work.is_active[:] = True
    work.linearize(LIMITS)
    H, b, begin = dense_normal_equations(problem, np.ones(len(work.order), dtype=bool), True)
    H += np.diag(damping * np.diag(H) + 1e-9)
    S = H[:begin, :begin] - H[:begin, begin:] @ np.linalg.solve(H[begin:, begin:], H[begin:, :begin])
    rhs = -b[:begin] + H[:begin, begin:] @ np.linalg.solve(H[begin:, begin:], b[begin:])
    blocks = work.blocks
    bundle_kernels.factor_points(blocks.H_pp, damping, work.factors)
    got_S, got_rhs = np.empty((begin // 6, 6, begin // 6, 6)), np.empty((begin // 6, 6))
    scratch = np.empty((int(np.diff(work.seen.starts).max()), 3, 6))
    bundle_kernels.reduce_to_cameras(work.sorted, blocks, work.factors, damping, scratch, got_S, got_rhs)
    got = symmetric(got_S.reshape(begin, begin))
    np.testing.assert_allclose(got, S, atol=1e-5 * np.abs(S).max())
    np.testing.assert_allclose(got_rhs.ravel(), rhs, atol=1e-5 * np.abs(rhs).max())
    for system in (DenseSystem, SparseSystem):
        xi = system(begin // 6, work.sorted).solve(blocks, work.factors, damping)
        assert xi is not None
        np.testing.assert_allclose(xi.ravel(), np.linalg.solve(S, rhs), atol=1e-5)

    assert work.try_step(damping)
    whole = -np.linalg.solve(H, b)
    expected_T = problem.T_cam_world.copy()
    for f, k in enumerate(np.flatnonzero(~problem.is_fixed)):
        expected_T[k] = se3.exp(whole[6 * f : 6 * f + 6]) @ expected_T[k]
    np.testing.assert_allclose(work.T_trial, expected_T, atol=1e-5)
    expected_points = problem.points_world_m + whole[begin:].reshape(-1, 3)
    moved = np.empty_like(expected_points)
    xi = whole[:begin].reshape(-1, 6)
    bundle_kernels.move_points(work.points, work.sorted, blocks, work.factors, xi, moved)
    np.testing.assert_allclose(moved, expected_points, atol=1e-5)
    shortened = np.abs(work.points_trial - expected_points).max(axis=1) > 1e-5  # would have crossed a camera's plane
    assert np.mean(shortened) < 0.3


def test_move_points_leaves_a_point_whose_step_is_not_finite() -> None:
    points, moved = np.array([[1.0, 2.0, 3.0]]), np.empty((1, 3))
    order = bundle_kernels.Order(np.array([0, 0]), np.zeros(0, np.int64))
    none = np.zeros((0, 6))
    blocks = bundle_kernels.Blocks(
        np.zeros((0, 6, 6)), none, np.ones((1, 6)), np.full((1, 3), np.nan), np.zeros((0, 3, 6))
    )
    bundle_kernels.move_points(points, order, blocks, np.ones((1, 6)), none, moved)
    np.testing.assert_array_equal(moved, points)


def test_move_cameras_moves_only_the_free_ones() -> None:
    rng = np.random.default_rng(3)
    T = np.stack([se3.exp(rng.normal(size=6)) for _ in range(4)])
    moved, xi = T.copy(), rng.normal(size=(2, 6))
    bundle_kernels.move_cameras(T, np.array([1, 3]), xi, moved)
    np.testing.assert_array_equal(moved[[0, 2]], T[[0, 2]])
    np.testing.assert_allclose(moved[1], se3.exp(xi[0]) @ T[1], atol=1e-12)
    np.testing.assert_allclose(moved[3], se3.exp(xi[1]) @ T[3], atol=1e-12)


def test_keep_in_front_shortens_only_the_steps_that_cross_a_camera() -> None:
    rng = np.random.default_rng(4)
    T = np.stack([se3.exp(0.1 * rng.normal(size=6)) for _ in range(3)])
    T_trial = np.stack([se3.exp(0.02 * rng.normal(size=6)) @ pose for pose in T])
    points = np.column_stack((rng.normal(size=(40, 2)), rng.uniform(-0.5, 3.0, 40)))
    moved = points + np.column_stack((np.zeros((40, 2)), rng.uniform(-6.0, 1.0, 40)))
    moved[0] = points[0] + [0.0, 0.0, -1e4]
    points[0, 2], moved[1], points[1, 2] = 1.0, points[1] + [0.0, 0.0, -2.5], 2.0
    count = rng.integers(0, 4, 40)
    count[:2] = 3
    starts = np.concatenate(([0], np.cumsum(count)))
    keyframes = rng.integers(0, 3, starts[-1])
    is_active = rng.random(starts[-1]) < 0.8
    is_active[:6] = True

    def depths(poses: np.ndarray, p: int, point: np.ndarray) -> np.ndarray:
        used = np.arange(starts[p], starts[p + 1])[is_active[starts[p] : starts[p + 1]]]
        return np.array([se3.transform(poses[k], point[None])[0, 2] for k in keyframes[used]])

    expected = moved.copy()
    for p in range(40):
        front = depths(T, p, points[p]) > 1e-3
        for scale in (1.0, 0.5, 0.25, 0.125, 0.0):
            expected[p] = points[p] + scale * (moved[p] - points[p])
            if not np.any(front & (depths(T_trial, p, expected[p]) <= 1e-3)):
                break
    bundle_kernels.keep_in_front(T, points, T_trial, moved, starts, keyframes, is_active)
    np.testing.assert_allclose(moved, expected, atol=1e-12)
    np.testing.assert_array_equal(moved[0], points[0])
    assert not np.array_equal(moved[1], points[1])


def test_mixed_block_is_the_product_of_both_jacobians() -> None:
    made = bundle(5, points=10).problem
    T, point, weight = made.T_cam_world[0], made.points_world_m[0], np.array([0.5, 0.3, 0.2])
    x = se3.transform(T, point[None])[0]
    information = point_information(tuple(x), (1.0, 2.0, 3.0), weight, 1.0, INTRINSICS)
    block = np.empty((3, 6))
    bundle_kernels.mixed_block(T, *x, information, block)
    expected = point_jacobian(T, point).T @ np.diag(weight) @ camera_jacobian(T, point)
    np.testing.assert_allclose(block, expected, atol=1e-6 * np.abs(expected).max())
