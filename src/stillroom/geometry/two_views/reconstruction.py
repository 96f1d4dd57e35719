"""Two views become a motion and points, or are refused (ORB-SLAM's initialisation).

Mur-Artal et al., T-RO 2015, section IV; the numbers are those of ORB-SLAM2 (docs/reference.md#orb-slam2-monocular).

Differs from ORB-SLAM2: it counts the points that each motion of the winning model puts in front of both cameras. The
two motions of a plane often count the same, and a desk, which is almost one, is refused. Here every motion is refined
over all pairs, also those off the plane, and the one that explains them best wins, if it explains them clearly better
than any other.
"""

import math
from dataclasses import dataclass, field
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from stillroom.compiled import njit
from stillroom.geometry.arrays import F64, Bool, Floats
from stillroom.geometry.two_views import motions
from stillroom.geometry.two_views.models import GATE_F, SAMPLE, fit_both
from stillroom.geometry.two_views.refinement import essential, refine, sampson2

_PARALLEL_COS = 0.99998
"""Rays nearer than .36° tell nothing of their point's depth, not even its sign."""
_CHI2 = 4.0
_WORST_CHI2 = 9.0
_MIN_SHARE_BEFORE = 0.5
_STEPS = 30
_SAME_RAD = math.radians(10.0)
"""Motions whose translations differ by less are one motion, found twice."""


class Refusal(StrEnum):
    """Why two views do not make a map."""

    FEW_PAIRS = "too few pairs"
    NO_MOTION = "no motion explains the pairs"
    AMBIGUOUS = "two motions explain the pairs"
    LITTLE_PARALLAX = "too little parallax"


@dataclass(frozen=True)
class TwoViewLimits:
    """When two views are accepted.

    Attributes:
        sigma_px: Standard deviation of a keypoint's position [px].
        n_samples: Samples of the RANSAC.
        homography_share: A share of the homography in both scores above this one chooses it.
        min_points: Points that must be in front of both cameras and seen where they were matched …
        min_share: … also as a share of the pairs that agree with the motion.
        min_separation: By how much another motion must explain the pairs worse, in standard deviations of the sum of
            the pairs' differences (Vuong's test of models that do not contain each other, Econometrica 1989).
        min_parallax_rad: Parallax of the `parallax_rank`-th best point.
        parallax_rank: Which one, from 0.
    """

    sigma_px: float = 1.0
    n_samples: int = 200
    homography_share: float = 0.40
    min_points: int = 50
    min_share: float = 0.9
    min_separation: float = 3.0
    min_parallax_rad: float = math.radians(1.0)
    parallax_rank: int = 50


@dataclass(frozen=True)
class TwoViews:
    """What two views tell, in the first camera's frame, in units of the distance between the cameras.

    Attributes:
        T_second_first: Motion (4, 4), its translation of length 1.
        points_first: A point of each pair (N, 3); 0 where there is none.
        has_point: Which pairs have one (N,).
        parallax_rad: Parallax of the points, that of the `parallax_rank`-th best.
        by_homography: Whether the motion comes from the homography.
    """

    T_second_first: F64
    points_first: F64 = field(repr=False)
    has_point: Bool = field(repr=False)
    parallax_rad: float
    by_homography: bool


def reconstruct(first_px: Floats, second_px: Floats, K: Floats, limits: TwoViewLimits, seed: int) -> TwoViews | Refusal:
    """Return motion and points of two views, or why there are none.

    Args:
        first_px, second_px: Pairs (N, 2) [px], undistorted; some may be wrong.
        K: Intrinsics of both (3, 3).
        limits: When to accept.
        seed: Of the samples: the same input and seed give the same answer.
    """
    if len(first_px) < max(SAMPLE, limits.min_points):
        return Refusal.FEW_PAIRS
    fitted = fit_both(first_px, second_px, limits.sigma_px, limits.n_samples, seed)
    if fitted is None or not fitted[0].score + fitted[1].score > 0.0:
        return Refusal.NO_MOTION
    H, F = fitted
    by_homography = H.score > limits.homography_share * (H.score + F.score)
    model, candidates = (
        (H, motions.of_homography(H.matrix, K)) if by_homography else (F, motions.of_fundamental(F.matrix, K))
    )
    if len(candidates) == 0:
        return Refusal.LITTLE_PARALLAX
    pairs = _Pairs.of(first_px, second_px, K, limits)
    agreeing = pairs.chosen(model.is_inlier)
    counts = [checked(agreeing, T).n_good for T in candidates]
    likely = [T for T, n in zip(candidates, counts, strict=True) if n >= max(1.0, _MIN_SHARE_BEFORE * max(counts))]
    found = sorted((checked(pairs, refined(pairs, T)) for T in likely), key=lambda one: float(one.chi2.sum()))
    refusal = _refused(found, limits)
    if refusal is not None:
        return refusal
    best = found[0]
    points = np.where(best.is_kept[:, None], best.points, 0.0)
    return TwoViews(best.T_second_first, points, best.is_kept, best.parallax_rad, by_homography)


def _refused(found: "list[Checked]", limits: TwoViewLimits) -> Refusal | None:
    """Return why the best of motions, best first, is refused; None where it is not."""
    if not found or found[0].n_good < max(limits.min_points, limits.min_share * found[0].n_agreeing):
        return Refusal.NO_MOTION
    best = found[0]
    if best.parallax_rad < limits.min_parallax_rad:
        return Refusal.LITTLE_PARALLAX
    for other in found[1:]:
        is_other = float(best.T_second_first[:3, 3] @ other.T_second_first[:3, 3]) < math.cos(_SAME_RAD)
        worse = other.chi2 - best.chi2
        if is_other and worse.sum() < limits.min_separation * np.sqrt(np.sum(worse**2)):
            return Refusal.AMBIGUOUS
    return None


# A motion against the pairs.


@dataclass(frozen=True)
class _Pairs:
    """Pairs as rays (N, 2), x/z and y/z; the standard deviation of their coordinates; and which parallax counts."""

    first: F64
    second: F64
    sigma: float
    parallax_rank: int

    @staticmethod
    def of(first_px: Floats, second_px: Floats, K: Floats, limits: TwoViewLimits) -> "_Pairs":
        focal_px = np.array([K[0, 0], K[1, 1]])
        first, second = ((np.asarray(px, dtype=np.float64) - K[:2, 2]) / focal_px for px in (first_px, second_px))
        return _Pairs(first, second, limits.sigma_px / float(np.sqrt(focal_px.prod())), limits.parallax_rank)

    def chosen(self, which: Bool) -> "_Pairs":
        return _Pairs(self.first[which], self.second[which], self.sigma, self.parallax_rank)


@dataclass(frozen=True)
class Checked:
    """What a motion makes of N pairs.

    Attributes:
        T_second_first: The motion (4, 4).
        points: Points (N, 3).
        is_kept: Which of them are reliable (N,).
        n_good: How many are in front of both cameras and seen where they should be.
        n_agreeing: How many pairs lie on each other's epipolar lines.
        chi2: The pairs' χ² (N,), each at most 9; that of a point behind a camera is 9.
        parallax_rad: Parallax of the point of `parallax_rank`.
    """

    T_second_first: F64
    points: F64
    is_kept: Bool
    n_good: int
    n_agreeing: int
    chi2: F64
    parallax_rad: float


def refined(pairs: _Pairs, T_second_first: F64) -> F64:
    """Return a motion (4, 4) refined over the pairs."""
    return np.asarray(refine(T_second_first, pairs.first, pairs.second, pairs.sigma, _STEPS))


def checked(pairs: _Pairs, T_second_first: F64) -> Checked:
    """Return what a motion (4, 4) makes of the pairs."""
    n = len(pairs.first)
    points, chi2, cosines, is_kept = np.empty((n, 3)), np.empty(n), np.empty(n), np.zeros(n, dtype=np.bool_)
    seen = Seen(points, chi2, cosines, is_kept)
    n_good, n_agreeing = check_points(T_second_first, pairs.first, pairs.second, pairs.sigma**-2.0, seen)
    ranked = np.sort(cosines[np.isfinite(cosines)])
    rank = min(pairs.parallax_rank, len(ranked) - 1)
    parallax_rad = math.acos(min(1.0, ranked[rank])) if len(ranked) else 0.0
    return Checked(T_second_first, points, is_kept, int(n_good), int(n_agreeing), chi2, parallax_rad)


class Seen(NamedTuple):
    """What becomes of N pairs, as the kernel writes it.

    Attributes:
        points: Points (N, 3) in the first camera's frame.
        chi2: See `Checked`.
        cosines: Cosine of the parallax of those that count (N,), infinity for others.
        is_kept: See `Checked`.
    """

    points: F64
    chi2: F64
    cosines: F64
    is_kept: Bool


@njit(nogil=True, cache=True, error_model="numpy")
def check_points(
    T_second_first: F64,
    first: F64,
    second: F64,
    inverse_variance: float,
    seen: Seen,
) -> tuple[int, int]:
    """Triangulate pairs of rays (N, 2), and tell how well the motion explains them.

    A point whose rays are almost parallel may lie behind: its depth is noise. It counts, but is not kept.

    Args:
        T_second_first: The motion (4, 4).
        first, second: The pairs.
        inverse_variance: Of a ray's coordinates.
        seen: Receives what becomes of each pair.

    Returns:
        How many count, and how many pairs lie on each other's epipolar lines.
    """
    points, chi2, cosines, is_kept = seen
    T, E = T_second_first, essential(T_second_first)
    centre = np.empty(3)
    for r in range(3):
        centre[r] = -(T[0, r] * T[0, 3] + T[1, r] * T[1, 3] + T[2, r] * T[2, 3])
    n_good, n_agreeing = 0, 0
    for i in range(len(first)):
        x, y, u, v = first[i, 0], first[i, 1], second[i, 0], second[i, 1]
        error2 = sampson2(E, x, y, u, v) * inverse_variance
        n_agreeing += error2 <= GATE_F
        X, Y, Z = triangulated(T, E, x, y, u, v)
        points[i, 0], points[i, 1], points[i, 2] = X, Y, Z
        dx, dy, dz = X - centre[0], Y - centre[1], Z - centre[2]
        lengths = math.sqrt(X * X + Y * Y + Z * Z) * math.sqrt(dx * dx + dy * dy + dz * dz)
        cosine = (X * dx + Y * dy + Z * dz) / lengths
        a = T[0, 0] * X + T[0, 1] * Y + T[0, 2] * Z + T[0, 3]
        b = T[1, 0] * X + T[1, 1] * Y + T[1, 2] * Z + T[1, 3]
        c = T[2, 0] * X + T[2, 1] * Y + T[2, 2] * Z + T[2, 3]
        apart2 = max((X / Z - x) ** 2 + (Y / Z - y) ** 2, (a / c - u) ** 2 + (b / c - v) ** 2)
        is_ahead = (Z > 0.0 and c > 0.0) or cosine >= _PARALLEL_COS
        is_good = is_ahead and apart2 * inverse_variance <= _CHI2  # false where a number is not one
        n_good += is_good
        chi2[i] = min(error2, _WORST_CHI2) if is_ahead else _WORST_CHI2
        cosines[i] = cosine if is_good else np.inf
        is_kept[i] = is_good and cosine < _PARALLEL_COS
    return n_good, n_agreeing


@njit(nogil=True, cache=True, error_model="numpy")
def triangulated(T: F64, E: F64, x: float, y: float, u: float, v: float) -> tuple[float, float, float]:
    """Return the point in the first camera's frame whose images lie nearest to where they were seen.

    Lindstrom, Triangulation made easy, CVPR 2010 (`niter2`): both images are moved onto epipolar lines of each other,
    then the rays meet.

    Args:
        T: The motion `T_second_first` (4, 4).
        E: `essential` of it.
        x, y: The first ray (x, y, 1).
        u, v: The second.
    """
    p, q = E[0, 0] * x + E[0, 1] * y + E[0, 2], E[1, 0] * x + E[1, 1] * y + E[1, 2]  # the second image's line
    r, s = E[0, 0] * u + E[1, 0] * v + E[2, 0], E[0, 1] * u + E[1, 1] * v + E[2, 1]  # the first image's
    a = p * (E[0, 0] * r + E[0, 1] * s) + q * (E[1, 0] * r + E[1, 1] * s)
    b = 0.5 * (p * p + q * q + r * r + s * s)
    c = u * p + v * q + E[2, 0] * x + E[2, 1] * y + E[2, 2]
    d = math.sqrt(max(b * b - a * c, 0.0))
    step = c / (b + d)
    dp, dq, dr, ds = step * p, step * q, step * r, step * s
    p, q = p - E[0, 0] * dr - E[0, 1] * ds, q - E[1, 0] * dr - E[1, 1] * ds
    r, s = r - E[0, 0] * dp - E[1, 0] * dq, s - E[0, 1] * dp - E[1, 1] * dq
    step *= 2.0 * d / (p * p + q * q + r * r + s * s)
    x, y, u, v = x - step * r, y - step * s, u - step * p, v - step * q
    # The first ray as the second camera sees it, and where it meets the second.
    X = T[0, 0] * x + T[0, 1] * y + T[0, 2]
    Y = T[1, 0] * x + T[1, 1] * y + T[1, 2]
    Z = T[2, 0] * x + T[2, 1] * y + T[2, 2]
    nx, ny, nz = v * Z - Y, X - u * Z, u * Y - v * X
    mx, my, mz = T[1, 3] - v * T[2, 3], u * T[2, 3] - T[0, 3], v * T[0, 3] - u * T[1, 3]
    depth = (nx * mx + ny * my + nz * mz) / (nx * nx + ny * ny + nz * nz)
    return depth * x, depth * y, depth
