"""A motion between two views, refined over all pairs: five numbers, for the length of the translation is free."""

import math

import numpy as np

from stillroom.compiled import njit
from stillroom.geometry.arrays import F64

_WIDE, _NARROW, _NARROWING = 25.0, 3.0, 0.7
"""From about this squared error on [σ²] a pair's pull falls (Geman and McClure's weight): it may be wrong. At first it
is wide, so that pairs which the start explains badly are heard; each step makes it narrower."""
_DAMPING = 1e-4
_CONVERGED = 1e-8


@njit(nogil=True, cache=True)
def essential(T_second_first: F64) -> F64:
    """Return E (3, 3) with `second @ E @ first = 0` for rays: [t]× R."""
    T, E = T_second_first, np.empty((3, 3))
    for j in range(3):
        E[0, j] = T[1, 3] * T[2, j] - T[2, 3] * T[1, j]
        E[1, j] = T[2, 3] * T[0, j] - T[0, 3] * T[2, j]
        E[2, j] = T[0, 3] * T[1, j] - T[1, 3] * T[0, j]
    return E


@njit(nogil=True, cache=True, error_model="numpy")
def refine(T_second_first: F64, first: F64, second: F64, sigma: float, iterations: int) -> F64:
    """Return the motion near another that brings pairs of rays nearest to each other's epipolar lines.

    Iteratively reweighted least squares of the Sampson error (Hartley and Zisserman, section 11.4.3).

    Args:
        T_second_first: Where to start (4, 4), its translation of length 1.
        first, second: Rays (N, 2), x/z and y/z; some pairs may be wrong.
        sigma: Standard deviation of a ray's coordinates.
        iterations: Most steps.
    """
    T, softness2 = T_second_first.copy(), _WIDE
    normal, gradient, row, step, turns = np.empty((5, 5)), np.empty(5), np.empty(5), np.empty(5), np.empty((5, 3, 3))
    for _ in range(iterations):
        E = essential(T)
        one, other = _across(T[:3, 3])
        _derivatives(T, one, other, turns)
        normal[:], gradient[:] = 0.0, 0.0
        for k in range(len(first)):
            x, y, u, v = first[k, 0], first[k, 1], second[k, 0], second[k, 1]
            p, q, r, s, product = _forms(E, x, y, u, v)
            norm2 = p * p + q * q + r * r + s * s
            if not norm2 > 0.0:
                continue
            error = product / (math.sqrt(norm2) * sigma)
            weight = (1.0 + error * error / softness2) ** -2.0
            for i in range(5):
                dp, dq, dr, ds, d = _forms(turns[i], x, y, u, v)
                row[i] = (d - product * (p * dp + q * dq + r * dr + s * ds) / norm2) / (math.sqrt(norm2) * sigma)
                gradient[i] += weight * row[i] * error
                for j in range(i + 1):
                    normal[i, j] += weight * row[i] * row[j]
        if not _solve(normal, gradient, step):
            break
        _move(T, one, other, step)
        if softness2 == _NARROW and (step * step).sum() < _CONVERGED**2:
            break
        softness2 = max(_NARROW, _NARROWING * softness2)
    return T


@njit(nogil=True, cache=True)
def _forms(E: F64, x: float, y: float, u: float, v: float) -> tuple[float, float, float, float, float]:
    """Return the two lines' first two numbers, E (x, y, 1) and Eᵀ (u, v, 1), and the whole product."""
    p, q = E[0, 0] * x + E[0, 1] * y + E[0, 2], E[1, 0] * x + E[1, 1] * y + E[1, 2]
    r, s = E[0, 0] * u + E[1, 0] * v + E[2, 0], E[0, 1] * u + E[1, 1] * v + E[2, 1]
    return p, q, r, s, u * p + v * q + E[2, 0] * x + E[2, 1] * y + E[2, 2]


@njit(nogil=True, cache=True, error_model="numpy")
def sampson2(E: F64, x: float, y: float, u: float, v: float) -> float:
    """Return how far rays (x, y, 1), (u, v, 1) are from the nearest pair that meets, squared, to first order."""
    p, q, r, s, product = _forms(E, x, y, u, v)
    error2: float = product * product / (p * p + q * q + r * r + s * s)
    return error2


@njit(nogil=True, cache=True)
def _derivatives(T: F64, one: F64, other: F64, turns: F64) -> None:
    """Write the derivatives (5, 3, 3) of E by a turn about each axis, and by t along each of two directions."""
    moved = T.copy()
    for axis in range(3):
        j, k = (axis + 1) % 3, (axis + 2) % 3
        moved[axis, :3], moved[j, :3], moved[k, :3] = 0.0, -T[k, :3], T[j, :3]  # the axis × R
        turns[axis] = essential(moved)
    moved[:] = T
    moved[:3, 3] = one
    turns[3] = essential(moved)
    moved[:3, 3] = other
    turns[4] = essential(moved)


@njit(nogil=True, cache=True)
def _across(t: F64) -> tuple[F64, F64]:
    """Return two unit vectors at right angles to a unit vector (3,) and to each other."""
    least = int(np.argmin(np.abs(t)))
    one, other = np.zeros(3), np.empty(3)
    one[least] = 1.0
    for i in range(3):
        one[i] -= t[least] * t[i]
    one /= math.sqrt((one * one).sum())
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        other[i] = t[j] * one[k] - t[k] * one[j]
    return one, other


@njit(nogil=True, cache=True, error_model="numpy")
def _solve(normal: F64, gradient: F64, step: F64) -> bool:
    """Write the solution (5,) of the damped normal equations, by Cholesky; return whether there is one."""
    L = np.zeros((5, 5))
    for i in range(5):
        for j in range(i + 1):
            total = normal[i, j] * (1.0 + _DAMPING if i == j else 1.0)
            for k in range(j):
                total -= L[i, k] * L[j, k]
            if i > j:
                L[i, j] = total / L[j, j]
            elif total > 0.0:
                L[i, i] = math.sqrt(total)
            else:
                return False
    for i in range(5):
        total = gradient[i]
        for k in range(i):
            total -= L[i, k] * step[k]
        step[i] = total / L[i, i]
    for i in range(4, -1, -1):
        total = step[i]
        for k in range(i + 1, 5):
            total -= L[k, i] * step[k]
        step[i] = total / L[i, i]
    return True


@njit(nogil=True, cache=True)
def _move(T: F64, one: F64, other: F64, step: F64) -> None:
    """Take a step (5,) back: turn a motion (4, 4) by three of its numbers (Rodrigues), and move t by the others."""
    for i in range(3):
        T[i, 3] -= step[3] * one[i] + step[4] * other[i]
    T[:3, 3] /= math.sqrt(T[0, 3] ** 2 + T[1, 3] ** 2 + T[2, 3] ** 2)
    angle = math.sqrt(step[0] ** 2 + step[1] ** 2 + step[2] ** 2)
    if angle == 0.0:
        return
    x, y, z = -step[0] / angle, -step[1] / angle, -step[2] / angle
    sine, rest = math.sin(angle), 1.0 - math.cos(angle)
    for j in range(3):
        a, b, c = T[0, j], T[1, j], T[2, j]
        along = x * a + y * b + z * c
        T[0, j] = a + sine * (y * c - z * b) + rest * (x * along - a)
        T[1, j] = b + sine * (z * a - x * c) + rest * (y * along - b)
        T[2, j] = c + sine * (x * b - y * a) + rest * (z * along - c)
