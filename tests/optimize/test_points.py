"""Points placed by cameras that are held still, against plain numpy and scipy."""

import numpy as np
from optimize_problems import CAMERA, INTRINSICS, chi_squares, huber_rho, limits, point_jacobian, predict
from scipy.optimize import minimize

from stillroom.geometry import se3
from stillroom.optimize.points import LONGEST_STEP_M, PointSums, add_camera, placed

LIMITS = (5.991, 7.815)
CAMERAS = [se3.exp(np.array([0.3 * k, -0.1 * k, 0.05 * k, 0.0, -0.08 * k, 0.02])) for k in range(6)]


class Seen:
    """A few points that all cameras see, with noise, some of them without a right coordinate, one match wrong."""

    def __init__(self, seed: int, n: int = 40) -> None:
        rng = np.random.default_rng(seed)
        px = np.stack((rng.uniform(150, 500, n), rng.uniform(100, 380, n)), axis=1)
        self.true_m = CAMERA.back_project(px, rng.uniform(2.0, 5.0, n))
        self.weights = np.repeat(1.2 ** -(2.0 * rng.integers(0, 8, n)), 3).reshape(n, 3)
        self.weights[rng.random(n) < 0.2, 2] = 0.0
        noise_px = self.weights[:, :1] ** -0.5 * 0.5
        self.observed = [predict(T, self.true_m) + noise_px * rng.normal(size=(n, 3)) for T in CAMERAS]
        self.observed[2][5] += 8.0
        self.p_static = rng.uniform(0.2, 1.0, n)
        self.start_m = self.true_m + rng.normal(size=(n, 3)) * 0.01

    def sums(self, at_m: np.ndarray) -> PointSums:
        sums, ids = PointSums.nothing(len(at_m)), np.arange(len(self.true_m), dtype=np.int32)
        for T, observed in zip(CAMERAS, self.observed, strict=True):
            add_camera(sums, at_m, ids, T, observed, self.weights, self.p_static, LIMITS, INTRINSICS)
        return sums

    def cost(self, point: np.ndarray, i: int) -> float:
        """Huber's cost of one point (3,), by the formula."""
        total = 0.0
        for T, observed in zip(CAMERAS, self.observed, strict=True):
            chi2 = chi_squares(T, point[None], observed[i : i + 1], self.weights[i : i + 1])
            total += self.p_static[i] * huber_rho(chi2, limits(self.weights[i : i + 1]))[0]
        return total


def test_the_sums_are_those_of_jacobians_by_central_differences() -> None:
    seen = Seen(0)
    sums = seen.sums(seen.start_m)
    for i in (0, 7, 5):
        H, b = np.zeros((3, 3)), np.zeros(3)
        for T, observed in zip(CAMERAS, seen.observed, strict=True):
            point, weight = seen.start_m[i], seen.weights[i]
            J = point_jacobian(T, point)
            error = np.where(weight > 0, predict(T, point[None])[0] - observed[i], 0.0)
            chi2, limit = (weight * error**2).sum(), limits(seen.weights[i : i + 1])[0]
            factor = seen.p_static[i] * min(1.0, np.sqrt(limit / chi2))
            H += factor * J.T @ np.diag(weight) @ J
            b += factor * J.T @ (weight * error)
        np.testing.assert_allclose(sums.H[i], H[np.triu_indices(3)], rtol=1e-5, atol=1e-4 * np.abs(H).max())
        np.testing.assert_allclose(sums.b[i], b, rtol=1e-4, atol=1e-4 * np.abs(b).max())


def test_steps_end_where_scipy_finds_the_least_cost() -> None:
    seen = Seen(1)
    points = seen.start_m
    for _ in range(30):
        points = placed(seen.sums(points), points)
    for i in (0, 5, 11, 23):
        best = minimize(lambda x, i=i: seen.cost(x, i), seen.true_m[i], method="Nelder-Mead",
                        options={"xatol": 1e-8, "fatol": 1e-10, "maxiter": 4000})  # fmt: skip
        assert seen.cost(points[i], i) <= best.fun * (1 + 1e-6)
        np.testing.assert_allclose(points[i], best.x, atol=2e-5)


def test_one_step_goes_most_of_the_way() -> None:
    seen = Seen(2)
    first = end = placed(seen.sums(seen.start_m), seen.start_m)
    for _ in range(20):
        end = placed(seen.sums(end), end)
    left_m, whole_m = (np.linalg.norm(points - end, axis=1) for points in (first, seen.start_m))
    assert np.median(left_m) < 0.1 * np.median(whole_m)


def test_what_nothing_sees_or_what_lies_elsewhere_stays() -> None:
    seen = Seen(3)
    at_m = np.concatenate((seen.start_m, [[0.0, 0.0, 3.0]]))
    at_m[4] += 0.5  # all its observations are another point's
    at_m[6] = se3.inverse(CAMERAS[0])[:3, 3] - [0.0, 0.0, 1.0]  # behind the cameras
    moved = placed(seen.sums(at_m), at_m)
    for i in (4, 6, len(at_m) - 1):
        np.testing.assert_array_equal(moved[i], at_m[i])
    assert np.linalg.norm(moved - at_m, axis=1).max() <= LONGEST_STEP_M


def test_a_point_that_one_camera_sees_without_depth_stays_as_far_as_it_is() -> None:
    seen = Seen(4)
    seen.weights[:, 2] = 0.0
    sums, ids = PointSums.nothing(len(seen.start_m)), np.arange(len(seen.start_m), dtype=np.int32)
    add_camera(sums, seen.start_m, ids, CAMERAS[0], seen.observed[0], seen.weights, seen.p_static, LIMITS, INTRINSICS)
    moved = placed(sums, seen.start_m)
    before, after = (se3.transform(CAMERAS[0], points)[:, 2] for points in (seen.start_m, moved))
    assert np.isfinite(moved).all()
    assert np.abs(after - before).max() < 0.02
