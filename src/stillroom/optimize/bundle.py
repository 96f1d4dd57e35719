"""Bundle adjustment: keyframes and points together, robust, with outlier rejection.

After ORB-SLAM2's local bundle adjustment (Mur-Artal and Tardós 2017, section III-B;
docs/reference.md#orb-slam2-mapping): Levenberg–Marquardt with a Schur complement over the points. Why not a library:
docs/reference.md#library-measurements.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from stillroom.bounds import bounded
from stillroom.geometry.arrays import F64, I64, Bool, Floats, Ints
from stillroom.geometry.camera import Camera
from stillroom.optimize.bundle_kernels import (
    Blocks,
    Observations,
    Order,
    evaluate,
    factor_points,
    keep_in_front,
    linearize,
    move_cameras,
    move_points,
    robust_cost,
    sort_observations,
)
from stillroom.optimize.depth_terms import MODELS, RIGHT, DepthTerms, depth_terms
from stillroom.optimize.reduced_system import reduced_system


@dataclass(frozen=True)
class BundleProblem:
    """Keyframes, points and observations.

    Attributes:
        T_cam_world: Keyframe poses (K, 4, 4).
        is_fixed: Fixed keyframes (K,) bool; with none the gauge is free.
        points_world_m: Points (P, 3) [m].
        obs_keyframe, obs_point: Indices into the above (O,), in any order.
        observed_px: u, v, u_right (O, 3) [px], undistorted; u_right is not read where its weight is 0.
        weights: Inverse variances (O, 3) [1/px²]; the third is 0 where there is no right coordinate.
        p_static: How much each observation counts (O,), 0 to 1: the probability that its point was static. It weighs
            the robust cost; whether an observation is an inlier depends on its χ² alone. All 1 by default.
    """

    T_cam_world: Floats
    is_fixed: Bool
    points_world_m: Floats
    obs_keyframe: Ints
    obs_point: Ints
    observed_px: Floats
    weights: Floats
    p_static: Floats | None = None


@dataclass(frozen=True)
class BundleResult:
    """The adjusted keyframes and points.

    Attributes:
        T_cam_world: Keyframe poses (K, 4, 4) float64.
        points_world_m: Points (P, 3) float64 [m].
        is_inlier: Which observations are inliers (O,) bool, in the problem's order.
        initial_cost, final_cost: Huber's Σpρ(χ²) of the observations that were in front of their cameras at the start.
        n_iterations: Steps tried, of both passes together.
    """

    T_cam_world: F64
    points_world_m: F64
    is_inlier: Bool
    initial_cost: float
    final_cost: float
    n_iterations: int


@dataclass(frozen=True)
class BundleConfig:
    """Bundle adjustment.

    Attributes:
        iterations_first: Iterations with Huber's kernel, at most; outliers are then removed.
        iterations_second: Iterations without it, at most.
        chi2_2d, chi2_3d: Limits on χ², and squared thresholds of Huber's kernel, without and with a right coordinate.
        first_damping: Levenberg–Marquardt's λ at the start of each pass, relative to the diagonal.
        min_relative_decrease: A pass ends when a step lowers the cost by no more than this part of it.
            The default halves the steps and leaves the poses 0.1 mm from the converged ones where noise alone leaves
            them 3 mm from the truth (random problems with 20 free keyframes).
        right_sigma: Standard deviation of a right coordinate, that is of the disparity that a depth stands for, as a
            share of that of the left one. ORB-SLAM2 has 1; structured light measures it better.
        depth_model: right, depth counts by that alone; or sensor, by the noise of the camera's sensor where that is
            known, with `right_sigma` as the least (`optimize.depth_terms`).
    """

    iterations_first: int = bounded(5, least=0)
    iterations_second: int = bounded(10, least=0)
    chi2_2d: float = bounded(5.991, above=0)
    chi2_3d: float = bounded(7.815, above=0)
    first_damping: float = bounded(1e-4, above=0)
    min_relative_decrease: float = bounded(1e-3, least=0)
    right_sigma: float = bounded(1.0, above=0)
    depth_model: str = bounded(RIGHT, one_of=MODELS)

    def build(self) -> "BundleAdjuster":
        """Return the adjuster."""
        return BundleAdjuster(self)


def _require_indices(what: str, indices: Ints, count: int) -> None:
    """Raise IndexError unless all indices lie in [0, count): the kernels would read beyond their arrays."""
    if len(indices) and not (indices.min() >= 0 and indices.max() < count):
        raise IndexError(f"an observation names a {what} outside 0 … {count - 1}")


class _Adjustment:
    """One problem in the kernels' order, its present estimate, and the scratch of its steps."""

    def __init__(self, problem: BundleProblem, camera: Camera, depth: DepthTerms) -> None:
        n_keyframes, n_points = len(problem.T_cam_world), len(problem.points_world_m)
        _require_indices("keyframe", problem.obs_keyframe, n_keyframes)
        _require_indices("point", problem.obs_point, n_points)
        self.free = np.flatnonzero(~np.asarray(problem.is_fixed, dtype=np.bool_))
        slot_of = np.full(n_keyframes, -1, dtype=np.int64)
        slot_of[self.free] = np.arange(len(self.free))
        obs_keyframe = np.asarray(problem.obs_keyframe, dtype=np.int64)
        obs_point = np.asarray(problem.obs_point, dtype=np.int64)
        self.order: I64
        starts, self.order = sort_observations(obs_point, slot_of[obs_keyframe], n_points)
        keyframes = obs_keyframe[self.order]
        self.sorted = Order(starts, slot_of[keyframes])
        self.T = np.array(problem.T_cam_world, dtype=np.float64).reshape(-1, 4, 4)
        self.points = np.array(problem.points_world_m, dtype=np.float64).reshape(-1, 3)
        self.T_trial, self.points_trial = self.T.copy(), self.points.copy()
        observed_px, weights = (
            np.ascontiguousarray(array, dtype=np.float64).reshape(-1, 3).take(self.order, axis=0)
            for array in (problem.observed_px, problem.weights)
        )
        terms = depth(observed_px, weights, camera)
        self.weights = terms.weights
        n_observations, n_free = len(self.order), len(self.free)
        self.is_active = np.ones(n_observations, dtype=np.bool_)
        self.seen = Observations(
            *self.sorted,
            keyframes,
            terms.observed_px,
            self.weights,
            self._p_static(problem),
            self.is_active,
            terms.intrinsics,
        )
        self.chi2 = np.empty(n_observations)
        self.blocks = Blocks(
            np.empty((n_free, 6, 6)),
            np.empty((n_free, 6)),
            np.empty((n_points, 6)),
            np.empty((n_points, 3)),
            np.empty((n_observations, 3, 6)),
        )
        self.factors = np.empty((n_points, 6))
        self.system = reduced_system(n_free, self.sorted)

    def _p_static(self, problem: BundleProblem) -> F64:
        if problem.p_static is None:
            return np.ones(len(self.order))
        return np.asarray(problem.p_static, dtype=np.float64)[self.order]

    def evaluate(self, T: F64, points: F64, deltas2: tuple[float, float]) -> float:
        """Return the robust cost of the active observations; leaves every observation's χ² in `chi2`."""
        return float(evaluate(T, points, self.seen, deltas2, self.chi2))

    def cost(self, deltas2: tuple[float, float]) -> float:
        """Return the same of the present `chi2`."""
        return float(robust_cost(self.chi2, self.seen, deltas2))

    def linearize(self, deltas2: tuple[float, float]) -> None:
        """Set up the normal equations at the present estimate."""
        linearize(self.T, self.points, self.seen, deltas2, self.blocks)

    def try_step(self, damping: float) -> bool:
        """Write the damped step's outcome into the trial estimate; return whether there is one."""
        factor_points(self.blocks.H_pp, damping, self.factors)
        xi = self.system.solve(self.blocks, self.factors, damping)
        if xi is None:
            return False
        move_cameras(self.T, self.free, xi, self.T_trial)
        move_points(self.points, self.sorted, self.blocks, self.factors, xi, self.points_trial)
        starts, keyframes = self.seen.starts, self.seen.keyframes
        keep_in_front(self.T, self.points, self.T_trial, self.points_trial, starts, keyframes, self.is_active)
        return True

    def accept(self) -> None:
        """Make the trial estimate the present one."""
        self.T, self.T_trial = self.T_trial, self.T
        self.points, self.points_trial = self.points_trial, self.points


class BundleAdjuster:
    """Adjusts keyframes and points to the observations."""

    def __init__(self, config: BundleConfig | None = None) -> None:
        self.config = config or BundleConfig()

    def __call__(self, problem: BundleProblem, camera: Camera, stop: Callable[[], bool] | None = None) -> BundleResult:
        """Adjust the free keyframes and all points, and classify every observation.

        A first pass with Huber's kernel over all observations in front of their cameras; those beyond their χ² limit
        are removed; a second pass without the kernel; a final classification of every observation. Within a pass the
        estimate changes only by steps that lower that pass's cost, and a finite start never ends in NaN.

        Differs from ORB-SLAM2: damping relative to the diagonal, and a pass ends early when it has converged.

        Args:
            problem: What to adjust.
            camera: The calibration of all keyframes.
            stop: Called before each step; true ends it early, with a valid result.

        Raises:
            IndexError: An observation names a keyframe or point that does not exist.
        """
        config = self.config
        work = _Adjustment(problem, camera, depth_terms(config.depth_model, config.right_sigma, camera))
        limits = (config.chi2_2d, config.chi2_3d)
        limit = np.where(work.weights[:, 2] > 0.0, config.chi2_3d, config.chi2_2d)
        work.evaluate(work.T, work.points, limits)
        at_start = np.isfinite(work.chi2)
        work.is_active[:] = at_start
        initial_cost = work.cost(limits)
        n_iterations = self._minimize(work, config.iterations_first, limits, stop)
        work.evaluate(work.T, work.points, limits)
        work.is_active[:] = work.chi2 <= limit
        n_iterations += self._minimize(work, config.iterations_second, (np.inf, np.inf), stop)
        work.is_active[:] = at_start
        final_cost = work.evaluate(work.T, work.points, limits)
        is_inlier = np.empty(len(limit), dtype=np.bool_)
        is_inlier[work.order] = work.chi2 <= limit
        return BundleResult(work.T, work.points, is_inlier, initial_cost, final_cost, n_iterations)

    def _minimize(
        self, work: _Adjustment, iterations: int, deltas2: tuple[float, float], stop: Callable[[], bool] | None
    ) -> int:
        """Run Levenberg–Marquardt on the active observations, whose χ² is known; return how many steps were tried."""
        if not work.is_active.any():
            return 0
        damping, growth = self.config.first_damping, 2.0
        cost = work.cost(deltas2)
        stale = True
        for iteration in range(iterations):
            if stop is not None and stop():
                return iteration
            if stale:
                work.linearize(deltas2)
            solved = work.try_step(damping)
            trial = work.evaluate(work.T_trial, work.points_trial, deltas2) if solved else np.inf
            stale = trial <= cost
            if not stale:
                damping, growth = damping * growth, 2.0 * growth
                continue
            decrease, cost = cost - trial, trial
            work.accept()
            damping, growth = max(damping / 3.0, 1e-9), 2.0
            if decrease <= self.config.min_relative_decrease * cost:
                return iteration + 1
        return iterations
