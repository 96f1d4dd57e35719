"""The similarity between two cameras that see the same points, each in its own map of another scale.

ORB-SLAM2's OptimizeSim3 (Mur-Artal et al. 2015, section VI-B; docs/reference.md#orb-slam2-loops): reprojection errors
in both images, over the seven degrees of freedom of Sim(3). Differs: where both know a point, its two depths count as
well. Two cameras at nearly the same place, as at the end of a loop, see the same whatever the scale; depths tell it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stillroom.bounds import bounded
from stillroom.geometry import sim3, twists
from stillroom.geometry.arrays import F64, Bool, Floats
from stillroom.geometry.camera import Camera
from stillroom.optimize.observations import MIN_DEPTH_M

CHI2 = 9.21
"""99 % at two degrees of freedom: the limit on the squared error of a pair in either image (ORB-SLAM2)."""
_DAMPING = 1e-6
_FLOOR = 1e-12


@dataclass(frozen=True)
class SharedPoints:
    """N points that the first camera sees, and the second one knows the place of; some also the other way round.

    Attributes:
        of_second_m: Points (N, 3) as the second camera's map knows them, in that camera's coordinates.
        first_px: Where the first camera sees them (N, 2) [px].
        first_weights: Inverse variances of that (N,) [1/px²].
        of_first_m: The points (N, 3) as the first camera's map knows them, in that camera's coordinates.
        second_px: Where the second camera sees them (N, 2) [px].
        second_weights: Inverse variances of that (N,) [1/px²]; 0 where the second does not see, or the first map does
            not know, the point.
    """

    of_second_m: Floats
    first_px: Floats
    first_weights: Floats
    of_first_m: Floats
    second_px: Floats
    second_weights: Floats


@dataclass(frozen=True)
class SimilarityEstimate:
    """A similarity, and what agrees with it.

    Attributes:
        S_first_second: It takes points of the second camera to the first (4, 4).
        is_inlier: Points (N,) whose errors are within the limit in both images.
    """

    S_first_second: F64
    is_inlier: Bool


@dataclass(frozen=True)
class SimilarityConfig:
    """Optimisation of a similarity.

    Attributes:
        first_iterations, iterations: Steps with all points, and then with those that agree.
        depth_sigma: Standard deviation of the ratio of a point's two depths, which weighs them against pixels.
    """

    first_iterations: int = bounded(5, least=0)
    iterations: int = bounded(10, least=1)
    depth_sigma: float = bounded(0.05, above=0)

    def build(self) -> "SimilarityOptimizer":
        """Return the optimiser."""
        return SimilarityOptimizer(self)


class SimilarityOptimizer:
    """Levenberg–Marquardt on Sim(3) with Huber's kernel."""

    def __init__(self, config: SimilarityConfig | None = None) -> None:
        self.config = config or SimilarityConfig()

    def __call__(self, S_first_second: Floats, points: SharedPoints, camera: Camera) -> SimilarityEstimate:
        """Minimise the errors in both images, from a first guess (4, 4) on; the same camera took both."""
        S = np.array(S_first_second, dtype=np.float64)
        used: Bool = np.ones(len(points.first_weights), dtype=np.bool_)
        for n_steps in (self.config.first_iterations, self.config.iterations):
            S = _minimized(S, points, used, camera, n_steps, self.config.depth_sigma)
            used = np.asarray((chi2(S, points, camera) <= CHI2).all(axis=0))
        return SimilarityEstimate(S, used)


def chi2(S_first_second: F64, points: SharedPoints, camera: Camera) -> F64:
    """Return the weighted squared errors (2, N) in the first and the second image; infinite behind a camera."""
    return np.stack([term.chi2 for term in _terms(S_first_second, points, camera, 1.0)[:2]])


def _minimized(S: F64, points: SharedPoints, used: Bool, camera: Camera, n_steps: int, depth_sigma: float) -> F64:
    damping, growth = _DAMPING, 2.0
    terms = _terms(S, points, camera, depth_sigma)
    cost = _cost(terms, used)
    for _ in range(n_steps):
        H, gradient = _normal_equations(terms, used)
        H[np.diag_indices(7)] += damping * np.diag(H) + _FLOOR
        trial = S @ sim3.exp(np.linalg.solve(H, -gradient)[None])[0]
        trial_terms = _terms(trial, points, camera, depth_sigma)
        trial_cost = _cost(trial_terms, used)
        if not trial_cost <= cost:
            damping, growth = damping * growth, 2.0 * growth
            continue
        S, terms, cost = trial, trial_terms, trial_cost
        damping, growth = damping / 3.0, 2.0
    return S


@dataclass(frozen=True)
class _Term:
    """Errors (N, D) of one kind, their derivatives (N, D, 7) by ξ in S exp(ξ), and weights (N,).

    A weight is infinite where a point is behind the camera, and 0 where there is no such error.
    """

    error: F64
    jacobian: F64
    weight: F64

    @property
    def chi2(self) -> F64:
        """Weighted squares (N,)."""
        known = np.isfinite(self.weight)
        return np.where(known, np.where(known, self.weight, 0.0) * (self.error**2).sum(axis=1), np.inf)


def _terms(S: F64, points: SharedPoints, camera: Camera, depth_sigma: float) -> tuple[_Term, _Term, _Term]:
    """Return the errors in both images [px], and those of the logarithm of the depth in the first camera."""
    S_second_first = sim3.inverse(S)
    q, known = np.asarray(points.of_second_m, dtype=np.float64), np.asarray(points.of_first_m, dtype=np.float64)
    p = q @ S[:3, :3].T + S[:3, 3]
    r = known @ S_second_first[:3, :3].T + S_second_first[:3, 3]
    p_by, r_by = S[:3, :3] @ _of_points(q), -_of_points(r)
    ahead = (points.second_weights > 0) & (p[:, 2] > MIN_DEPTH_M) & (known[:, 2] > MIN_DEPTH_M)
    z, z_known = np.where(ahead, p[:, 2], 1.0), np.where(ahead, known[:, 2], 1.0)
    return (
        _projected(p, p_by, points.first_px, points.first_weights, camera),
        _projected(r, r_by, points.second_px, points.second_weights, camera),
        _Term(np.log(z / z_known)[:, None], p_by[:, 2:] / z[:, None, None], ahead / depth_sigma**2),
    )


def _of_points(x: F64) -> F64:
    """Return the derivatives (N, 3, 7) of exp(ξ) x by ξ at 0."""
    return np.concatenate((np.broadcast_to(np.eye(3), (len(x), 3, 3)), -twists.skew(x), x[:, :, None]), axis=2)


def _projected(x: F64, x_by: F64, seen_px: Floats, weights: Floats, camera: Camera) -> _Term:
    """Return the errors of points (N, 3) of a camera, whose derivatives (N, 3, 7) are known, in its image."""
    ahead = x[:, 2] > MIN_DEPTH_M
    z = np.where(ahead, x[:, 2], 1.0)
    u, v = x[:, 0] / z, x[:, 1] / z
    error = np.stack((camera.fx * u + camera.cx, camera.fy * v + camera.cy), axis=1) - seen_px
    by_x = np.zeros((len(x), 2, 3))
    by_x[:, 0, 0], by_x[:, 0, 2] = camera.fx / z, -camera.fx * u / z
    by_x[:, 1, 1], by_x[:, 1, 2] = camera.fy / z, -camera.fy * v / z
    weight = np.asarray(weights, dtype=np.float64)
    return _Term(error, by_x @ x_by, np.where(ahead | (weight == 0.0), weight, np.inf))


def _cost(terms: Sequence[_Term], used: Bool) -> float:
    """Return Huber's Σρ(χ²); a point behind a camera counts as one a million σ off."""
    found = np.minimum(np.concatenate([term.chi2[used] for term in terms]), 1e12)
    return float(np.where(found <= CHI2, found, 2.0 * np.sqrt(CHI2 * found) - CHI2).sum())


def _normal_equations(terms: Sequence[_Term], used: Bool) -> tuple[F64, F64]:
    H, gradient = np.zeros((7, 7)), np.zeros(7)
    for term in terms:
        counted = np.flatnonzero(used & np.isfinite(term.weight))
        J, error = term.jacobian[counted], term.error[counted]
        factor = np.sqrt(CHI2 / np.maximum(term.chi2[counted], CHI2)) * term.weight[counted]
        weighted = factor[:, None, None] * J
        H += np.einsum("nij,nik->jk", weighted, J)
        gradient += np.einsum("nij,ni->j", weighted, error)
    return H, gradient
