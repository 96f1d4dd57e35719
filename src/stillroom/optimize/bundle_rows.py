"""Bundle adjustment under a rolling shutter: each free keyframe has a velocity beside its pose.

A keypoint that was read τ after mid-frame sees its point from exp(τ ν) T (see `rolling_pose`). Its derivative by ν is τ
times that by the pose, so a free keyframe takes two places among the cameras of `bundle_kernels`: its pose, then its
velocity, and each observation is there twice, with W and with τ W. The points are eliminated as ever; what is left to
add is the block Σ τ GᵀJᵀWJG that couples a pose with its own velocity.

Shapes: K keyframes of which F are free, P points, O observations, sorted as in `bundle_kernels`.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from stillroom.compiled import njit
from stillroom.data.map import Map
from stillroom.geometry.arrays import F64, I64, Floats, Ints
from stillroom.optimize.bundle_kernels import Blocks, Observations, Order, mixed_block, point_block
from stillroom.optimize.observations import (
    behind_chi_square,
    camera_blocks,
    chi_square,
    huber,
    point_information,
    residual,
)
from stillroom.optimize.rolling_pose import seen_from


class Rows(NamedTuple):
    """When rows were read, and what is known of velocities.

    Attributes:
        after_s: When each observation was made, from mid-frame on (O,) [s].
        free: The free keyframes (F,).
        information: Inverse variances of velocities about 0 (6,) [s²/m², s²/rad²].
    """

    after_s: F64
    free: I64
    information: F64


@dataclass(frozen=True)
class KnownRows:
    """When the rows of keyframes were read, as the map knows it.

    Attributes:
        after_s: When each observation was made, from mid-frame on (O,) [s].
        velocity: Velocities of the keyframes (K, 6) [m/s, rad/s], beyond those by which keypoints were moved to
            mid-frame; the free ones are adjusted with the poses.
    """

    after_s: Floats
    velocity: Floats


def known_rows(rows: Ints, keyframes: Ints, world: Map) -> KnownRows | None:
    """Return what the map knows of observations (O,), rows of its keypoints; None where rows were read at once.

    Args:
        rows: The observations.
        keyframes: The keyframes of the problem (K,).
        world: The map.
    """
    after_s = world.keypoints.after_s[rows]
    return KnownRows(after_s, world.keyframes.velocity[keyframes]) if after_s.any() else None


def doubled(order: Order) -> Order:
    """Return the order in which each observation is there twice, for the pose and for the velocity of its keyframe."""
    slots = np.where(order.slots < 0, -1, 2 * order.slots)
    return Order(2 * order.starts, np.stack((slots, np.where(slots < 0, -1, slots + 1)), axis=1).ravel())


@njit(nogil=True, cache=True)
def evaluate_rows(
    T: F64, velocity: F64, points: F64, seen: Observations, rows: Rows, deltas2: tuple[float, float], chi2: F64
) -> float:
    """Write χ² (O,) of every observation; return the robust cost of the active ones, and that of the velocities."""
    starts, _, keyframes, observed, weights, p_static, is_active, intrinsics = seen
    cost = 0.0
    for f in rows.free:
        for r in range(6):
            cost += rows.information[r] * velocity[f, r] * velocity[f, r]
    for p in range(points.shape[0]):
        for o in range(starts[p], starts[p + 1]):
            k = keyframes[o]
            x, y, z = seen_from(T[k], velocity[k], points[p], rows.after_s[o])
            chi2[o] = chi_square(x, y, z, observed[o], weights[o], intrinsics)
            if is_active[o]:
                value = chi2[o] if chi2[o] < np.inf else behind_chi_square(weights[o], intrinsics)
                cost += p_static[o] * huber(value, deltas2[1] if weights[o, 2] > 0.0 else deltas2[0])[0]
    return cost


@njit(nogil=True, cache=True)
def turned(T: F64, velocity: F64, after_s: float, R: F64) -> None:
    """Write the rotation of `T` as a row saw it into `R` (3, 3), to the second order as `seen_from`."""
    a, b, c = after_s * velocity[3], after_s * velocity[4], after_s * velocity[5]
    for k in range(3):
        x, y, z = T[0, k], T[1, k], T[2, k]
        dx, dy, dz = b * z - c * y, c * x - a * z, a * y - b * x
        R[0, k] = x + dx + 0.5 * (b * dz - c * dy)
        R[1, k] = y + dy + 0.5 * (c * dx - a * dz)
        R[2, k] = z + dz + 0.5 * (a * dy - b * dx)


@njit(nogil=True, cache=True)
def linearize_rows_of_all(
    T: F64,
    velocity: F64,
    points: F64,
    seen: Observations,
    rows: Rows,
    deltas2: tuple[float, float],
    blocks: Blocks,
    coupling: F64,
) -> None:
    """Write the normal equations' blocks, with H_cc (2F, 6, 6), b_c (2F, 6), W (2O, 3, 6), and `coupling` (F, 6, 6)."""
    starts, slots, keyframes, observed, weights, p_static, is_active, intrinsics = seen
    H_cc, b_c, H_pp, b_p, W = blocks
    H_cc[:] = 0.0
    b_c[:] = 0.0
    coupling[:] = 0.0
    R, block, slope = np.empty((3, 3)), np.empty((6, 6)), np.empty(6)
    for f in range(len(rows.free)):
        for r in range(6):
            H_cc[2 * f + 1, r, r] = rows.information[r]
            b_c[2 * f + 1, r] = rows.information[r] * velocity[rows.free[f], r]
    for p in range(points.shape[0]):
        H_pp[p] = 0.0
        b_p[p] = 0.0
        for o in range(starts[p], starts[p + 1]):
            W[2 * o] = 0.0
            W[2 * o + 1] = 0.0
            if not is_active[o]:
                continue
            k, after_s = keyframes[o], rows.after_s[o]
            x, y, z = seen_from(T[k], velocity[k], points[p], after_s)
            chi2 = chi_square(x, y, z, observed[o], weights[o], intrinsics)
            if not chi2 < np.inf:
                continue
            turned(T[k], velocity[k], after_s, R)
            has_right = weights[o, 2] > 0.0
            factor = p_static[o] * huber(chi2, deltas2[1] if has_right else deltas2[0])[1]
            error = residual(x, y, z, observed[o], intrinsics, has_right)
            info = point_information((x, y, z), error, weights[o], factor, intrinsics)
            f = slots[o]
            if f >= 0:
                mixed_block(R, x, y, z, info, W[2 * o])
                block[:] = 0.0
                slope[:] = 0.0
                camera_blocks(x, y, z, info, block, slope)
                for r in range(6):
                    b_c[2 * f, r] += slope[r]
                    b_c[2 * f + 1, r] += after_s * slope[r]
                    for i in range(3):
                        W[2 * o + 1, i, r] = after_s * W[2 * o, i, r]
                    for c in range(r + 1):
                        H_cc[2 * f, r, c] += block[r, c]
                        H_cc[2 * f + 1, r, c] += after_s * after_s * block[r, c]
                        coupling[f, r, c] += after_s * block[r, c]
            else:  # a fixed camera needs no derivative
                point_block(R, info, W[2 * o])
            at = 0
            for i in range(3):
                b_p[p, i] += R[0, i] * info[6] + R[1, i] * info[7] + R[2, i] * info[8]
                for j in range(i + 1):
                    H_pp[p, at] += R[0, i] * W[2 * o, j, 0] + R[1, i] * W[2 * o, j, 1] + R[2, i] * W[2 * o, j, 2]
                    at += 1
    for f in range(len(rows.free)):
        for r in range(6):
            for c in range(r):
                coupling[f, c, r] = coupling[f, r, c]


@njit(nogil=True, cache=True)
def move_velocities(velocity: F64, free: I64, step: F64, moved: F64) -> None:
    """Write the velocities of the free keyframes (F,), moved by a step (F, 6), into `moved` (K, 6)."""
    for f in range(len(free)):
        moved[free[f]] = velocity[free[f]] + step[f]
