"""Passes over an organised cloud, for one plane: how far off the samples are, and how the camera bends it."""

import numpy as np
from numba import njit

from stillroom.geometry.arrays import F32, F64, Bool

N_TERMS = 6
"""1, x, y, x², x·y, y²: a parabola over the rays."""


@njit(nogil=True, cache=True)
def plane_misfits(points: F32, slope: F64) -> F32:
    """Return by how much each sample is nearer than a plane, in inverse depth.

    Args:
        points: Points (h, w, 3) [m]; z = 0 where unknown.
        slope: The plane's a, b, c (3,).

    Returns:
        Misfits (h, w) [1/m]; infinite where unknown.
    """
    off = np.full(points.shape[:2], np.inf, dtype=np.float32)
    a, b, c = slope
    for i in range(points.shape[0]):
        for j in range(points.shape[1]):
            z = points[i, j, 2]
            if z > 0.0:
                off[i, j] = (1.0 - a * points[i, j, 0] - b * points[i, j, 1]) / z - c
    return off


@njit(nogil=True, cache=True)
def parabola_sums(points: F32, off: F32, limit: float) -> tuple[F64, F64, int]:
    """Return the normal equations (6, 6) and (6,) of a parabola through misfits up to a limit, and how many they are.

    Args:
        points: Points (h, w, 3) [m].
        off: Misfits (h, w) [1/m]; infinite where unknown.
        limit: Largest misfit that counts [1/m].
    """
    normal, right = np.zeros((N_TERMS, N_TERMS)), np.zeros(N_TERMS)
    t = np.ones(N_TERMS)
    n = 0
    for i in range(points.shape[0]):
        for j in range(points.shape[1]):
            if not abs(off[i, j]) <= limit:
                continue
            n += 1
            x, y = points[i, j, 0] / points[i, j, 2], points[i, j, 1] / points[i, j, 2]
            t[1], t[2], t[3], t[4], t[5] = x, y, x * x, x * y, y * y
            for k in range(N_TERMS):
                right[k] += t[k] * off[i, j]
                for m in range(k + 1):
                    normal[k, m] += t[k] * t[m]
    for k in range(N_TERMS):
        for m in range(k):
            normal[m, k] = normal[k, m]
    return normal, right, n


@njit(nogil=True, cache=True)
def unbend(points: F32, off: F32, parabola: F64, max_bend: float) -> None:
    """Take a parabola (6,), held within ± `max_bend` [1/m], off the misfits (h, w) of points (h, w, 3)."""
    p = parabola
    for i in range(points.shape[0]):
        for j in range(points.shape[1]):
            z = points[i, j, 2]
            if z > 0.0:
                x, y = points[i, j, 0] / z, points[i, j, 1] / z
                bend = p[0] + x * (p[1] + p[3] * x + p[4] * y) + y * (p[2] + p[5] * y)
                off[i, j] -= min(max(bend, -max_bend), max_bend)


@njit(nogil=True, cache=True)
def area_moments(points: F32, chosen: Bool, steepness: float) -> F64:
    """Return the area of a plane's samples, and its first and second moments.

    Args:
        points: Points (h, w, 3) [m].
        chosen: The plane's samples (h, w).
        steepness: Length of the plane's (a, b, c): z³ times it is the area of a unit of the plane z = 1.

    Returns:
        Σw, Σwx, Σwy, Σwz, Σwxx, Σwxy, Σwxz, Σwyy, Σwyz, Σwzz (10,) with w the area of a sample in rays.
    """
    s = np.zeros(10)
    for i in range(points.shape[0]):
        for j in range(points.shape[1]):
            if chosen[i, j]:
                x, y, z = np.float64(points[i, j, 0]), np.float64(points[i, j, 1]), np.float64(points[i, j, 2])
                w = z * z * z * steepness
                s[0] += w
                s[1] += w * x
                s[2] += w * y
                s[3] += w * z
                s[4] += w * x * x
                s[5] += w * x * y
                s[6] += w * x * z
                s[7] += w * y * y
                s[8] += w * y * z
                s[9] += w * z * z
    return s
