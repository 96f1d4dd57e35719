"""Two views of a static point: the epipolar constraint."""

import math

import numpy as np

from stillroom.compiled import njit
from stillroom.geometry.arrays import F64, I32, Floats
from stillroom.geometry.camera import Lens

# Points from two views.

_MAX_SWEEPS = 30
"""Four or five are enough; none where numbers are not finite."""


@njit(nogil=True, cache=True)
def triangulate(T_first_world: F64, T_second_world: F64, first_rays: F64, second_rays: F64) -> F64:
    """Triangulate by the linear method (Hartley and Zisserman, section 12.2).

    Args:
        T_first_world, T_second_world: `T_cam_world` (4, 4) of the two views.
        first_rays, second_rays: Normalised image coordinates (N, 2): x/z, y/z.

    Returns:
        Points (N, 3), world frame; not finite, or far away, where the rays are parallel.
    """
    points_m, A, V = np.empty((len(first_rays), 3)), np.empty((4, 4)), np.empty((4, 4))
    for i in range(len(first_rays)):
        for axis in range(2):
            for c in range(4):
                A[axis, c] = first_rays[i, axis] * T_first_world[2, c] - T_first_world[axis, c]
                A[2 + axis, c] = second_rays[i, axis] * T_second_world[2, c] - T_second_world[axis, c]
        last = _shortest_direction(A, V)
        for axis in range(3):
            points_m[i, axis] = V[axis, last] / V[3, last] if V[3, last] != 0.0 else np.inf
    return points_m


@njit(nogil=True, cache=True)
def _shortest_direction(A: F64, V: F64) -> int:
    """Turn columns of `A` (n, n) by pairs until all are at right angles, as `V` (n, n) notes; return the shortest.

    That column of `V` is the right singular vector of the smallest singular value: one-sided Jacobi (Golub and Van
    Loan, 8.6.3), which for four columns is done sooner than a call of LAPACK.
    """
    n = A.shape[0]
    V[:] = 0.0
    for k in range(n):
        V[k, k] = 1.0
    for _ in range(_MAX_SWEEPS):
        turned = False
        for p in range(n - 1):
            for q in range(p + 1, n):
                pp, qq, pq = 0.0, 0.0, 0.0
                for r in range(n):
                    pp += A[r, p] * A[r, p]
                    qq += A[r, q] * A[r, q]
                    pq += A[r, p] * A[r, q]
                if not abs(pq) > 1e-15 * math.sqrt(pp * qq):
                    continue
                turned = True
                zeta = (qq - pp) / (2.0 * pq)
                t = math.copysign(1.0, zeta) / (abs(zeta) + math.sqrt(1.0 + zeta * zeta))
                c = 1.0 / math.sqrt(1.0 + t * t)
                s = c * t
                for r in range(n):
                    A[r, p], A[r, q] = c * A[r, p] - s * A[r, q], s * A[r, p] + c * A[r, q]
                    V[r, p], V[r, q] = c * V[r, p] - s * V[r, q], s * V[r, p] + c * V[r, q]
        if not turned:
            break
    last, shortest = 0, np.inf
    for k in range(n):
        length2 = 0.0
        for r in range(n):
            length2 += A[r, k] * A[r, k]
        if length2 < shortest:
            last, shortest = k, length2
    return last


def line_distances_px(F_second_first: Floats, first_px: Floats, second_px: Floats) -> F64:
    """Return how far each second point lies from the epipolar line of its first point, (N,) [px].

    OC-SLAM Eq. 2, with the normalisation √(A² + B²) of a point-to-line distance and the absolute value that the
    printed equation lacks (it divides by √(A² + B² + C²)). Infinite where F gives no line.

    Args:
        F_second_first: One matrix (3, 3) for all, or one for each pair (N, 3, 3).
        first_px, second_px: The pairs (N, 2).
    """
    F = np.asarray(F_second_first)
    lines = np.einsum("...ij,...j->...i", F[..., :2], first_px) + F[..., 2]
    numerator = np.abs(np.einsum("ij,ij->i", lines[:, :2], second_px) + lines[:, 2])
    norm = np.hypot(lines[:, 0], lines[:, 1])
    return np.where(norm > 0, numerator / np.where(norm > 0, norm, 1.0), np.inf)


def printed_line_distances(F_second_first: Floats, first_px: Floats, second_px: Floats) -> F64:
    """Return OC-SLAM's Eq. 2 as it is printed, (N,): p₂ᵀ F p₁ / √(A² + B² + C²), with a sign.

    It is no distance: C, of a line through an image, is some hundred times A and B, so that the result is as many times
    smaller than `line_distances_px`, and it is negative on one side of the line. 0 where F gives no line.

    Args:
        F_second_first: The matrix (3, 3).
        first_px, second_px: The pairs (N, 2).
    """
    F = np.asarray(F_second_first)
    lines = first_px @ F[:, :2].T + F[:, 2]
    norm = np.linalg.norm(lines, axis=1)
    return np.asarray((np.sum(lines[:, :2] * second_px, axis=1) + lines[:, 2]) / np.where(norm > 0, norm, 1.0))


@njit(nogil=True, cache=True)
def inverse_motion(T_a_b: F64) -> F64:
    """Do what `se3.inverse` tells, of one motion (4, 4), within kernels."""
    T_b_a = np.zeros((4, 4))
    for i in range(3):
        for j in range(3):
            T_b_a[i, j] = T_a_b[j, i]
            T_b_a[i, 3] -= T_a_b[j, i] * T_a_b[j, 3]
    T_b_a[3, 3] = 1.0
    return T_b_a


@njit(nogil=True, cache=True)
def motion_fundamental(T_second_first: F64, lens: Lens) -> F64:
    """Return F (3, 3) with `p_second @ F @ p_first = 0` from a known motion (4, 4): F = K⁻ᵀ [t]× R K⁻¹.

    OC-SLAM Eq. 1; Hartley and Zisserman, Eq. 9.2. Distortion is not read.
    """
    T, fx, fy, cx, cy = T_second_first, lens.fx, lens.fy, lens.cx, lens.cy
    F = np.empty((3, 3))
    for c in range(3):
        x, y, z = T[0, c], T[1, c], T[2, c]
        # [t]× R from the left by K⁻ᵀ.
        e0, e1, e2 = T[1, 3] * z - T[2, 3] * y, T[2, 3] * x - T[0, 3] * z, T[0, 3] * y - T[1, 3] * x
        F[0, c], F[1, c] = e0 / fx, e1 / fy
        F[2, c] = e2 - F[0, c] * cx - F[1, c] * cy
    for r in range(3):
        F[r, 0], F[r, 1] = F[r, 0] / fx, F[r, 1] / fy
        F[r, 2] -= F[r, 0] * cx + F[r, 1] * cy
    return F


@njit(nogil=True, cache=True)
def motion_line_distances_px(
    T_second_world: F64, T_world_first: F64, first: I32, first_px: F64, second_px: F64, lens: Lens
) -> F64:
    """Return what `line_distances_px` would, (N,) [px], for first points of many images with known poses.

    Args:
        T_second_world: Pose of the second image (4, 4).
        T_world_first: Poses of the first images (Q, 4, 4).
        first: Image of each first point (N,).
        first_px, second_px: The pairs (N, 2).
        lens: Of the camera; distortion is not read.
    """
    fx, fy, cx, cy = lens.fx, lens.fy, lens.cx, lens.cy
    T = T_second_world
    distances_px = np.empty(len(first))
    t, y, ray = np.empty(3), np.empty(3), np.empty(3)
    for i in range(len(first)):
        P = T_world_first[first[i]]
        x0, x1 = (first_px[i, 0] - cx) / fx, (first_px[i, 1] - cy) / fy
        for r in range(3):
            ray[r] = P[r, 0] * x0 + P[r, 1] * x1 + P[r, 2]
        for r in range(3):
            y[r] = T[r, 0] * ray[0] + T[r, 1] * ray[1] + T[r, 2] * ray[2]
            t[r] = T[r, 0] * P[0, 3] + T[r, 1] * P[1, 3] + T[r, 2] * P[2, 3] + T[r, 3]
        a = (t[1] * y[2] - t[2] * y[1]) / fx
        b = (t[2] * y[0] - t[0] * y[2]) / fy
        c = t[0] * y[1] - t[1] * y[0] - a * cx - b * cy
        norm = np.hypot(a, b)
        distance = abs(a * second_px[i, 0] + b * second_px[i, 1] + c)
        distances_px[i] = distance / norm if norm > 0.0 else np.inf
    return distances_px
