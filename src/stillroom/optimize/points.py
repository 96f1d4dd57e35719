"""Points placed by all cameras that see them: the other half of an adjustment, with the cameras held still.

Each point has three unknowns of its own, so a step of Gauss–Newton is a sum over what is seen of it and a system of
three equations. Cameras are added one after the other, and none has to be kept.
"""

import math
from typing import NamedTuple

import numpy as np

from stillroom.compiled import njit
from stillroom.geometry.arrays import F64, I32
from stillroom.optimize.observations import chi_square, huber, point_information, residual, to_camera

FARTHEST = 8.0
"""What lies so many times beyond its limit on χ² is another point."""
LONGEST_STEP_M = 0.05
"""Adjusted points are nearer than this to where all cameras see them; what is not is told badly."""
DAMPING = 1e-5
"""Relative to the largest of a point's three: a point on a few parallel rays stays where it is along them."""


class PointSums(NamedTuple):
    """The normal equations of P points.

    Attributes:
        H: Upper triangles (P, 6) float64, as 00 01 02 11 12 22 [1/m²].
        b: Slopes (P, 3) float64 [1/m].
    """

    H: F64
    b: F64

    @classmethod
    def nothing(cls, n_points: int) -> "PointSums":
        """Return those of points that nothing sees yet."""
        return cls(np.zeros((n_points, 6)), np.zeros((n_points, 3)))


@njit(nogil=True, cache=True)
def add_camera(
    sums: PointSums,
    position_m: F64,
    point_ids: I32,
    T: F64,
    observed_px: F64,
    weights: F64,
    p_static: F64,
    limits: tuple[float, float],
    intrinsics: F64,
) -> None:
    """Add what one camera sees, with Huber's kernel.

    Args:
        sums: Written to.
        position_m: Where the points are now (P, 3) [m, world].
        point_ids: Which of them are seen (M,).
        T: The camera's pose T_cam_world (4, 4).
        observed_px: u, v and the third coordinate (M, 3) [px].
        weights: Inverse variances (M, 3) [1/px²]; the third is 0 where there is no right coordinate.
        p_static: How much each counts (M,).
        limits: Squared thresholds of the kernel, without and with a right coordinate.
        intrinsics: Those of `intrinsics_of` (6,).
    """
    for i in range(len(point_ids)):
        p = point_ids[i]
        x, y, z = to_camera(T, position_m[p, 0], position_m[p, 1], position_m[p, 2])
        chi2 = chi_square(x, y, z, observed_px[i], weights[i], intrinsics)
        has_right = weights[i, 2] > 0.0
        limit = limits[1] if has_right else limits[0]
        if not chi2 <= FARTHEST * limit:
            continue
        error = residual(x, y, z, observed_px[i], intrinsics, has_right)
        factor = p_static[i] * huber(chi2, limit)[1]
        info = point_information((x, y, z), error, weights[i], factor, intrinsics)
        a00, a01, a02, a11, a12, a22, g0, g1, g2 = info
        n = 0
        for r in range(3):
            # A row of Rᵀ A, then its products with the columns of R from the diagonal on.
            m0 = T[0, r] * a00 + T[1, r] * a01 + T[2, r] * a02
            m1 = T[0, r] * a01 + T[1, r] * a11 + T[2, r] * a12
            m2 = T[0, r] * a02 + T[1, r] * a12 + T[2, r] * a22
            for c in range(r, 3):
                sums.H[p, n] += m0 * T[0, c] + m1 * T[1, c] + m2 * T[2, c]
                n += 1
            sums.b[p, r] += T[0, r] * g0 + T[1, r] * g1 + T[2, r] * g2


@njit(nogil=True, cache=True)
def placed(sums: PointSums, position_m: F64) -> F64:
    """Return the points (P, 3) [m] a step nearer to where the cameras see them; unseen ones stay where they are."""
    moved = position_m.copy()
    for p in range(len(position_m)):
        h00, h01, h02, h11, h12, h22 = sums.H[p]
        floor = DAMPING * max(h00, h11, h22)
        if not floor > 0.0:
            continue
        h00, h11, h22 = h00 + floor, h11 + floor, h22 + floor
        c00, c01, c02 = h11 * h22 - h12 * h12, h02 * h12 - h01 * h22, h01 * h12 - h02 * h11
        c11, c12, c22 = h00 * h22 - h02 * h02, h01 * h02 - h00 * h12, h00 * h11 - h01 * h01
        det = h00 * c00 + h01 * c01 + h02 * c02
        if not det > 0.0:
            continue
        b0, b1, b2 = sums.b[p]
        s0 = (c00 * b0 + c01 * b1 + c02 * b2) / det
        s1 = (c01 * b0 + c11 * b1 + c12 * b2) / det
        s2 = (c02 * b0 + c12 * b1 + c22 * b2) / det
        length_m = math.sqrt(s0 * s0 + s1 * s1 + s2 * s2)
        if length_m <= LONGEST_STEP_M:
            moved[p, 0] -= s0
            moved[p, 1] -= s1
            moved[p, 2] -= s2
    return moved
