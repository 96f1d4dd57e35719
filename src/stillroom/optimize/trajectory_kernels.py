"""Kernels of the trajectory prior: Gauss–Newton on a chain of poses, four of which each change of acceleration joins.

A pose X is moved to X exp(δ), δ (6,) being translation part [m], then rotation vector [rad]. Derivatives take the
Jacobians of the logarithm for the identity, as steps between frames and corrections are short. The normal equations are
banded; row j of the band holds what lies below the diagonal in column j.
"""

import math
from typing import NamedTuple

import numpy as np

from stillroom.compiled import njit
from stillroom.geometry.arrays import F64
from stillroom.geometry.twist_kernels import log_between
from stillroom.optimize.observations import retract

JOINED = 4
"""Poses that a change of acceleration is made of."""
BAND = 6 * JOINED


class Prior(NamedTuple):
    """What is known of N frames beside their poses, as the kernels take it.

    Attributes:
        own: Inverse variances of the frames' own poses (N, 6) [1/m², 1/rad²].
        jerk: Standard deviations of the change of acceleration, over a frame of `step_s` (6,) [m/s³, rad/s³].
        step_s: That frame's time [s].
        longest_step_s, fastest_m_s: Over a longer time, or in a faster step, nothing is known of the motion.
    """

    own: F64
    jerk: F64
    step_s: float
    longest_step_s: float
    fastest_m_s: float


@njit(nogil=True, cache=True)
def add_behind(J: F64, first: int, T_a_b: F64, weight: float) -> None:
    """Add weight · Ad(T_b_a), how a twist of a looks from b, to the six columns from `first` on in `J` (6, 24)."""
    for i in range(3):
        for j in range(3):
            J[i, first + j] += weight * T_a_b[j, i]
            J[3 + i, first + 3 + j] += weight * T_a_b[j, i]
            # skew(−Rᵀt) Rᵀ = −Rᵀ skew(t)
            k, m = (j + 1) % 3, (j + 2) % 3
            J[i, first + 3 + j] -= weight * (T_a_b[m, 3] * T_a_b[k, i] - T_a_b[k, 3] * T_a_b[m, i])


@njit(nogil=True, cache=True)
def linearize_chain(times_s: F64, T: F64, X: F64, prior: Prior, band: F64, slope: F64) -> None:
    """Write the normal equations: what is below their diagonal (6N, 24), by columns, and the slope (6N,).

    Args:
        times_s: Times (N,) [s], increasing; at least four.
        T: The frames' own poses T_world_cam (N, 4, 4).
        X: The poses (N, 4, 4) at which to linearise.
        prior: The prior.
        band, slope: Receive them.
    """
    n = len(times_s)
    steps, speed = np.empty((n - 1, 3, 4)), np.empty((n - 1, 6))
    between, off, J, residual = np.empty((3, 4)), np.empty(6), np.empty((6, BAND)), np.empty(6)
    band[:] = 0.0
    for i in range(n):
        log_between(T[i], X[i], between, off)
        for a in range(6):
            band[6 * i + a, 0] = prior.own[i, a]
            slope[6 * i + a] = prior.own[i, a] * off[a]
        if i > 0:
            log_between(X[i - 1], X[i], steps[i - 1], speed[i - 1])
            speed[i - 1] /= times_s[i] - times_s[i - 1]
    for k in range(n - 3):
        join(k, times_s, steps, speed, prior, J, residual)
        for r in range(6):
            for a in range(BAND):
                value = J[r, a]
                if value != 0.0:
                    slope[6 * k + a] += value * residual[r]
                    for b in range(a, BAND):
                        band[6 * k + a, b - a] += value * J[r, b]


@njit(nogil=True, cache=True)
def join(k: int, times_s: F64, steps: F64, speed: F64, prior: Prior, J: F64, residual: F64) -> None:
    """Write the residual (6,) of a change of acceleration and its derivatives (6, 24) by the poses k to k + 3.

    Args:
        k: The first pose.
        times_s: Times (N,) [s].
        steps: Motions from each pose to the next (N − 1, 3, 4).
        speed: Their twists over the time (N − 1, 6).
        prior: The prior.
        J, residual: Receive them.
    """
    first, second = 0.5 * (times_s[k + 2] - times_s[k]), 0.5 * (times_s[k + 3] - times_s[k + 1])
    whole = 0.5 * (first + second)
    # Weights that make of three velocities between four frames their change of acceleration.
    weights = (1.0 / (first * whole), -(1.0 / first + 1.0 / second) / whole, 1.0 / (second * whole))
    frames = (times_s[k + 3] - times_s[k]) / (3.0 * prior.step_s)
    J[:] = 0.0
    residual[:] = 0.0
    for j in range(3):
        share = weights[j] / (times_s[k + j + 1] - times_s[k + j])
        # A velocity changes by (δ of the later pose − that of the earlier one, seen from the later) over the time.
        add_behind(J, 6 * j, steps[k + j], -share)
        for r in range(6):
            J[r, 6 * (j + 1) + r] += share
            residual[r] += weights[j] * speed[k + j, r]
    for r in range(6):
        inverse = math.sqrt(frames) / prior.jerk[r]
        residual[r] *= inverse
        for a in range(BAND):
            J[r, a] *= inverse


@njit(nogil=True, cache=True)
def solve_band(band: F64, slope: F64) -> bool:
    """Solve H δ = −b by Cholesky, both overwritten: the factor, and δ (6N,); return whether H is positive definite."""
    n = len(slope)
    for j in range(n):
        pivot = band[j, 0]
        if not pivot > 0.0:
            return False
        root = math.sqrt(pivot)
        reach = min(BAND - j % 6, n - j)  # a pose is joined with the three after it
        for d in range(reach):
            band[j, d] /= root
        slope[j] = slope[j] / root
        for p in range(1, reach):
            value = band[j, p]
            slope[j + p] -= value * slope[j]
            for d in range(reach - p):
                band[j + p, d] -= value * band[j, p + d]
    for j in range(n - 1, -1, -1):
        total = -slope[j]
        for d in range(1, min(BAND - j % 6, n - j)):
            total -= band[j, d] * slope[j + d]
        slope[j] = total / band[j, 0]
    return True


@njit(nogil=True, cache=True)
def move_chain(times_s: F64, T: F64, prior: Prior, rounds: int, X: F64) -> None:
    """Move poses without a gap among them to the estimate, in rounds of Gauss–Newton; arguments as `move_pieces`."""
    n = len(times_s)
    band, slope = np.empty((6 * n, BAND)), np.empty(6 * n)
    identity, step, before = np.eye(4), np.empty((4, 4)), np.empty((4, 4))
    for _ in range(rounds):
        linearize_chain(times_s, T, X, prior, band, slope)
        if not solve_band(band, slope):
            return
        for i in range(n):
            retract(identity, slope[6 * i : 6 * i + 6], step)
            before[:] = X[i]
            multiply(before, step, X[i])


@njit(nogil=True, cache=True)
def multiply(T_a_b: F64, T_b_c: F64, T_a_c: F64) -> None:
    """Write the product of two motions (4, 4)."""
    for i in range(3):
        for j in range(4):
            value = T_a_b[i, 3] if j == 3 else 0.0
            for k in range(3):
                value += T_a_b[i, k] * T_b_c[k, j]
            T_a_c[i, j] = value
    T_a_c[3, 0], T_a_c[3, 1], T_a_c[3, 2], T_a_c[3, 3] = 0.0, 0.0, 0.0, 1.0


@njit(nogil=True, cache=True)
def move_pieces(times_s: F64, T: F64, prior: Prior, rounds: int, X: F64) -> None:
    """Move poses to the estimate under the prior, each piece between gaps and jumps by itself.

    Args:
        times_s: Times (N,) [s], increasing.
        T: The frames' own poses T_world_cam (N, 4, 4).
        prior: The prior.
        rounds: Rounds of Gauss–Newton.
        X: Where they start, and then the estimates (N, 4, 4). In pieces of fewer than four poses they are the own ones.
    """
    start = 0
    for end in range(1, len(times_s) + 1):
        if end < len(times_s):
            step_s = times_s[end] - times_s[end - 1]
            away2 = 0.0
            for i in range(3):
                away2 += (T[end, i, 3] - T[end - 1, i, 3]) ** 2
            is_near = math.sqrt(away2) <= prior.fastest_m_s * step_s
            if 0.0 < step_s <= prior.longest_step_s and is_near:
                continue
        piece = slice(start, end)
        if end - start < JOINED:
            X[piece] = T[piece]
        else:
            own = Prior(prior.own[piece], prior.jerk, prior.step_s, prior.longest_step_s, prior.fastest_m_s)
            move_chain(times_s[piece], T[piece], own, rounds, X[piece])
        start = end


@njit(nogil=True, cache=True)
def follow(times_s: F64, T: F64, prior: Prior, rounds: int, T_own_cam: F64) -> F64:
    """Return the poses (N, 4, 4) of the newest frames, from where they were estimated before.

    Args:
        times_s, T, prior, rounds: As `move_pieces`.
        T_own_cam: Estimates relative to the frames' own poses (N, 4, 4): where to start, and then as they are now.
    """
    X = np.empty_like(T)
    for i in range(len(T)):
        multiply(T[i], T_own_cam[i], X[i])
    move_pieces(times_s, T, prior, rounds, X)
    T_cam_own = np.eye(4)
    for i in range(len(T)):
        for r in range(3):
            T_cam_own[r, 3] = 0.0
            for c in range(3):
                T_cam_own[r, c] = T[i, c, r]
                T_cam_own[r, 3] -= T[i, c, r] * T[i, c, 3]
        multiply(T_cam_own, X[i], T_own_cam[i])
    return X
