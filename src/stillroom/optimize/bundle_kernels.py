"""The loops of bundle adjustment. Observations come sorted by point, within a point by free keyframe.

Shapes: K keyframes of which F are free, P points, O observations. `starts` (P + 1,) delimits each point's observations;
`slots` (O,) is the observing keyframe's index among the free ones, −1 where it is fixed.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from stillroom.compiled import njit
from stillroom.geometry.arrays import F64, I64, Bool
from stillroom.optimize.observations import (
    MIN_DEPTH_M,
    behind_chi_square,
    camera_blocks,
    chi_square,
    huber,
    point_information,
    residual,
    retract,
    to_camera,
)

DIAGONAL_FLOOR = 1e-9
"""Added to every diagonal entry: what has no observations stays where it is, and no block becomes singular."""


class Order(NamedTuple):
    """How the observations are sorted: `starts` (P + 1,) and `slots` (O,), both int64."""

    starts: I64
    slots: I64


class Observations(NamedTuple):
    """The observations.

    Attributes:
        starts, slots: Their order.
        keyframes: The observing keyframe of each (O,).
        observed_px: u, v, u_right (O, 3) [px].
        weights: Inverse variances (O, 3) [1/px²].
        p_static: How much each counts (O,), 0 to 1.
        is_active: Which count at all (O,).
        intrinsics: Those of `intrinsics_of` (6,).
    """

    starts: I64
    slots: I64
    keyframes: I64
    observed_px: F64
    weights: F64
    p_static: F64
    is_active: Bool
    intrinsics: F64


class Blocks(NamedTuple):
    """The normal equations, block by block.

    Attributes:
        H_cc, b_c: Cameras: lower triangles (F, 6, 6), and (F, 6).
        H_pp, b_p: Points: lower triangles (P, 6) as 00 10 11 20 21 22, and (P, 3).
        W: Mixed, one an observation (O, 3, 6), point by camera; 0 if inactive, the first half only of fixed cameras.
    """

    H_cc: F64
    b_c: F64
    H_pp: F64
    b_p: F64
    W: F64


@njit(nogil=True, cache=True)
def sort_observations(points: I64, slots: I64, n_points: int) -> tuple[I64, I64]:
    """Sort observations (O,) by point, within a point by slot, and else as they came.

    Returns:
        Where each point's observations start (P + 1,), and the observations in order (O,).
    """
    starts = np.zeros(n_points + 1, np.int64)
    for o in range(len(points)):
        starts[points[o] + 1] += 1
    for p in range(n_points):
        starts[p + 1] += starts[p]
    ends = starts[:-1].copy()
    order = np.empty(len(points), np.int64)
    for o in range(len(points)):
        p = points[o]
        at = ends[p]
        while at > starts[p] and slots[order[at - 1]] > slots[o]:
            order[at] = order[at - 1]
            at -= 1
        order[at] = o
        ends[p] += 1
    return starts, order


@njit(nogil=True, cache=True)
def evaluate(T: F64, points: F64, seen: Observations, deltas2: tuple[float, float], chi2: F64) -> float:
    """Write χ² (O,) of every observation; return the robust cost Σpρ of the active ones."""
    starts, _, keyframes, observed, weights, _, _, intrinsics = seen
    for p in range(points.shape[0]):
        for o in range(starts[p], starts[p + 1]):
            x, y, z = to_camera(T[keyframes[o]], points[p, 0], points[p, 1], points[p, 2])
            chi2[o] = chi_square(x, y, z, observed[o], weights[o], intrinsics)
    cost: float = robust_cost(chi2, seen, deltas2)
    return cost


@njit(nogil=True, cache=True)
def robust_cost(chi2: F64, seen: Observations, deltas2: tuple[float, float]) -> float:
    """Return the robust cost Σpρ of the active observations, whose χ² (O,) are given."""
    _, _, _, _, weights, p_static, is_active, intrinsics = seen
    delta2_2d, delta2_3d = deltas2
    cost = 0.0
    for o in range(len(chi2)):
        if is_active[o]:
            value = chi2[o] if chi2[o] < np.inf else behind_chi_square(weights[o], intrinsics)
            cost += p_static[o] * huber(value, delta2_3d if weights[o, 2] > 0.0 else delta2_2d)[0]
    return cost


@njit(nogil=True, cache=True)
def mixed_block(R: F64, x: float, y: float, z: float, information: tuple[float, ...], block: F64) -> None:
    """Write GᵀJᵀWJR, transposed, into `block` (3, 6): with B = JᵀWJ R it is [B; [x]× B], column by column."""
    a00, a01, a02, a11, a12, a22 = information[:6]
    for k in range(3):
        m0 = a00 * R[0, k] + a01 * R[1, k] + a02 * R[2, k]
        m1 = a01 * R[0, k] + a11 * R[1, k] + a12 * R[2, k]
        m2 = a02 * R[0, k] + a12 * R[1, k] + a22 * R[2, k]
        block[k, 0], block[k, 1], block[k, 2] = m0, m1, m2
        block[k, 3] = y * m2 - z * m1
        block[k, 4] = z * m0 - x * m2
        block[k, 5] = x * m1 - y * m0


@njit(nogil=True, cache=True)
def point_block(R: F64, information: tuple[float, ...], block: F64) -> None:
    """Write the first three columns of `mixed_block` only: JᵀWJ R, transposed."""
    a00, a01, a02, a11, a12, a22 = information[:6]
    for k in range(3):
        block[k, 0] = a00 * R[0, k] + a01 * R[1, k] + a02 * R[2, k]
        block[k, 1] = a01 * R[0, k] + a11 * R[1, k] + a12 * R[2, k]
        block[k, 2] = a02 * R[0, k] + a12 * R[1, k] + a22 * R[2, k]


@njit(nogil=True, cache=True)
def linearize(T: F64, points: F64, seen: Observations, deltas2: tuple[float, float], blocks: Blocks) -> None:
    """Write the normal equations' blocks, sums over the active observations."""
    starts, slots, keyframes, observed, weights, p_static, is_active, intrinsics = seen
    H_cc, b_c, H_pp, b_p, W = blocks
    delta2_2d, delta2_3d = deltas2
    H_cc[:] = 0.0
    b_c[:] = 0.0
    for p in range(points.shape[0]):
        h00, h10, h11, h20, h21, h22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        q0, q1, q2 = 0.0, 0.0, 0.0
        for o in range(starts[p], starts[p + 1]):
            W[o] = 0.0
            if not is_active[o]:
                continue
            R = T[keyframes[o]]
            x, y, z = to_camera(R, points[p, 0], points[p, 1], points[p, 2])
            chi2 = chi_square(x, y, z, observed[o], weights[o], intrinsics)
            if not chi2 < np.inf:
                continue
            has_right = weights[o, 2] > 0.0
            factor = p_static[o] * huber(chi2, delta2_3d if has_right else delta2_2d)[1]
            error = residual(x, y, z, observed[o], intrinsics, has_right)
            info = point_information((x, y, z), error, weights[o], factor, intrinsics)
            g0, g1, g2 = info[6], info[7], info[8]
            if slots[o] >= 0:
                camera_blocks(x, y, z, info, H_cc[slots[o]], b_c[slots[o]])
                mixed_block(R, x, y, z, info, W[o])
            else:  # a fixed camera needs no derivative
                point_block(R, info, W[o])
            h00 += R[0, 0] * W[o, 0, 0] + R[1, 0] * W[o, 0, 1] + R[2, 0] * W[o, 0, 2]
            h10 += R[0, 1] * W[o, 0, 0] + R[1, 1] * W[o, 0, 1] + R[2, 1] * W[o, 0, 2]
            h20 += R[0, 2] * W[o, 0, 0] + R[1, 2] * W[o, 0, 1] + R[2, 2] * W[o, 0, 2]
            h11 += R[0, 1] * W[o, 1, 0] + R[1, 1] * W[o, 1, 1] + R[2, 1] * W[o, 1, 2]
            h21 += R[0, 2] * W[o, 1, 0] + R[1, 2] * W[o, 1, 1] + R[2, 2] * W[o, 1, 2]
            h22 += R[0, 2] * W[o, 2, 0] + R[1, 2] * W[o, 2, 1] + R[2, 2] * W[o, 2, 2]
            q0 += R[0, 0] * g0 + R[1, 0] * g1 + R[2, 0] * g2
            q1 += R[0, 1] * g0 + R[1, 1] * g1 + R[2, 1] * g2
            q2 += R[0, 2] * g0 + R[1, 2] * g1 + R[2, 2] * g2
        H_pp[p, 0], H_pp[p, 1], H_pp[p, 2] = h00, h10, h11
        H_pp[p, 3], H_pp[p, 4], H_pp[p, 5] = h20, h21, h22
        b_p[p, 0], b_p[p, 1], b_p[p, 2] = q0, q1, q2


@njit(nogil=True, cache=True)
def factor_points(H_pp: F64, damping: float, L: F64) -> None:
    """Write Cholesky factors `L` (P, 6) of the damped point blocks as 1/l00 l10 1/l11 l20 l21 1/l22.

    Zeros where there is none: such a point stays where it is in this step.
    """
    for p in range(H_pp.shape[0]):
        d0 = H_pp[p, 0] * (1.0 + damping) + DIAGONAL_FLOOR
        l00 = math.sqrt(d0) if d0 > 0.0 else 0.0
        l10 = H_pp[p, 1] / l00 if l00 > 0.0 else 0.0
        l20 = H_pp[p, 3] / l00 if l00 > 0.0 else 0.0
        d1 = H_pp[p, 2] * (1.0 + damping) + DIAGONAL_FLOOR - l10 * l10
        l11 = math.sqrt(d1) if d1 > 0.0 else 0.0
        l21 = (H_pp[p, 4] - l20 * l10) / l11 if l11 > 0.0 else 0.0
        d2 = H_pp[p, 5] * (1.0 + damping) + DIAGONAL_FLOOR - l20 * l20 - l21 * l21
        l22 = math.sqrt(d2) if d2 > 0.0 else 0.0
        if l00 * l11 * l22 > 0.0:
            L[p, 0], L[p, 1], L[p, 2] = 1.0 / l00, l10, 1.0 / l11
            L[p, 3], L[p, 4], L[p, 5] = l20, l21, 1.0 / l22
        else:
            L[p] = 0.0


@intrinsic
def add_product(typing_context: Any, Z: Any, a: Any, b: Any, blocks: Any, at: Any) -> Any:
    """Add Z[a]ᵀZ[b] of float64 arrays (N, 3, 6) to `blocks[at]` (B, 6, 6); all contiguous (inside kernels only).

    Six numbers are one vector here: numba's loops stay scalar where arrays may alias, and take nearly three times as
    long.
    """

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        number, row, index = ir.DoubleType(), ir.VectorType(ir.DoubleType(), 6), ir.IntType(64)

        def place(array: int, offset: Any) -> Any:
            data = context.make_array(signature.args[array])(context, builder, args[array]).data
            return builder.gep(data, [offset])

        def load(place: Any, at: int, kind: Any) -> Any:
            there = builder.bitcast(builder.gep(place, [ir.Constant(index, at)]), kind.as_pointer())
            return builder.load(there, align=8)

        def product(scalar: Any, vector: Any) -> Any:
            first = builder.insert_element(ir.Constant(row, ir.Undefined), scalar, ir.Constant(ir.IntType(32), 0))
            zeros = ir.Constant(ir.VectorType(ir.IntType(32), 6), [0] * 6)
            return builder.fmul(builder.shuffle_vector(first, first, zeros), vector)

        first, second = (place(0, builder.mul(args[k], ir.Constant(index, 18))) for k in (1, 2))
        block = place(3, builder.mul(args[4], ir.Constant(index, 36)))
        rows = [load(second, 6 * k, row) for k in range(3)]
        for i in range(6):
            terms = [product(load(first, 6 * k + i, number), rows[k]) for k in range(3)]
            total = builder.fadd(builder.fadd(terms[0], terms[1]), terms[2])
            there = builder.bitcast(builder.gep(block, [ir.Constant(index, 6 * i)]), row.as_pointer())
            builder.store(builder.fadd(builder.load(there, align=8), total), there, align=8)
        return context.get_dummy_value()

    return types.void(Z, types.int64, types.int64, blocks, types.int64), codegen


@njit(nogil=True, cache=True)
def reduce_to_cameras(order: Order, blocks: Blocks, L: F64, damping: float, Z: F64, S: F64, rhs: F64) -> None:
    """Write the damped reduced system: `S` (F, 6, F, 6), lower block triangle, and `rhs` (F, 6); S ξ = rhs.

    With H_pp = L Lᵀ and Z = W L⁻ᵀ, S = H_cc − Σ Z Zᵀ and rhs = −b_c + Σ Z L⁻¹ b_p, point by point. `Z` is scratch
    (3, 6) for as many observations as a point has at most.
    """
    starts, slots = order
    H_cc, b_c, _, b_p, W = blocks
    n_free = b_c.shape[0]
    shared = np.zeros((n_free * n_free, 6, 6))  # Σ Z Zᵀ in whole blocks: what is written together lies together
    rhs[:] = -b_c
    for p in range(b_p.shape[0]):
        i0, l10, i1, l20, l21, i2 = L[p, 0], L[p, 1], L[p, 2], L[p, 3], L[p, 4], L[p, 5]
        y0 = i0 * b_p[p, 0]
        y1 = i1 * (b_p[p, 1] - l10 * y0)
        y2 = i2 * (b_p[p, 2] - l20 * y0 - l21 * y1)
        for o in range(starts[p], starts[p + 1]):
            f = slots[o]
            if f < 0:
                continue
            Zo = Z[o - starts[p]]
            for a in range(6):
                z0 = i0 * W[o, 0, a]
                z1 = i1 * (W[o, 1, a] - l10 * z0)
                z2 = i2 * (W[o, 2, a] - l20 * z0 - l21 * z1)
                Zo[0, a], Zo[1, a], Zo[2, a] = z0, z1, z2
                rhs[f, a] += z0 * y0 + z1 * y1 + z2 * y2
            for other in range(starts[p], o + 1):
                g = slots[other]
                if g < 0:
                    continue
                add_product(Z, o - starts[p], other - starts[p], shared, f * n_free + g)
                if g == f and other != o:  # one keyframe, one point, two observations: both orders meet here
                    add_product(Z, other - starts[p], o - starts[p], shared, f * n_free + f)
    for f in range(n_free):
        for g in range(f + 1):
            for a in range(6):
                for b in range(6):
                    S[f, a, g, b] = -shared[f * n_free + g, a, b]
        for a in range(6):
            for b in range(a + 1):
                S[f, a, f, b] += H_cc[f, a, b]
            S[f, a, f, a] += damping * H_cc[f, a, a] + DIAGONAL_FLOOR


@njit(nogil=True, cache=True)
def move_points(points: F64, order: Order, blocks: Blocks, L: F64, xi: F64, moved: F64) -> None:
    """Write points − H_pp⁻¹ (b_p + Σ Wᵀξ) into `moved` (P, 3), given the cameras' step `xi` (F, 6)."""
    starts, slots = order
    _, _, _, b_p, W = blocks
    for p in range(points.shape[0]):
        q0, q1, q2 = b_p[p, 0], b_p[p, 1], b_p[p, 2]
        for o in range(starts[p], starts[p + 1]):
            f = slots[o]
            if f >= 0:
                for a in range(6):
                    q0 += W[o, 0, a] * xi[f, a]
                    q1 += W[o, 1, a] * xi[f, a]
                    q2 += W[o, 2, a] * xi[f, a]
        i0, l10, i1, l20, l21, i2 = L[p, 0], L[p, 1], L[p, 2], L[p, 3], L[p, 4], L[p, 5]
        y0 = i0 * q0
        y1 = i1 * (q1 - l10 * y0)
        y2 = i2 * (q2 - l20 * y0 - l21 * y1)
        s2 = i2 * y2
        s1 = i1 * (y1 - l21 * s2)
        s0 = i0 * (y0 - l10 * s1 - l20 * s2)
        finite = abs(s0) + abs(s1) + abs(s2) < np.inf
        moved[p, 0] = points[p, 0] - s0 if finite else points[p, 0]
        moved[p, 1] = points[p, 1] - s1 if finite else points[p, 1]
        moved[p, 2] = points[p, 2] - s2 if finite else points[p, 2]


@njit(nogil=True, cache=True)
def keep_in_front(
    T: F64,
    points: F64,
    T_trial: F64,
    moved: F64,
    starts: I64,
    keyframes: I64,
    is_active: Bool,
) -> None:
    """Shorten the steps in `moved` (P, 3) that would carry a point behind a camera which it was in front of.

    Behind a camera an observation has no derivative that could bring the point back. A badly seen point thus loses
    part of its step and all others keep theirs; after three halvings without success it stays where it is.
    """
    for p in range(points.shape[0]):
        for attempt in range(4):
            crosses = False
            for o in range(starts[p], starts[p + 1]):
                k = keyframes[o]
                if not is_active[o] or to_camera(T_trial[k], moved[p, 0], moved[p, 1], moved[p, 2])[2] > MIN_DEPTH_M:
                    continue
                if to_camera(T[k], points[p, 0], points[p, 1], points[p, 2])[2] > MIN_DEPTH_M:
                    crosses = True
                    break
            if not crosses:
                break
            for axis in range(3):
                middle = 0.5 * (points[p, axis] + moved[p, axis])
                moved[p, axis] = middle if attempt < 3 else points[p, axis]


@njit(nogil=True, cache=True)
def move_cameras(T: F64, free: I64, xi: F64, moved: F64) -> None:
    """Write exp(ξ) T of the free keyframes (F,) into `moved` (K, 4, 4); the others stay as `moved` has them."""
    for f in range(free.shape[0]):
        retract(T[free[f]], xi[f], moved[free[f]])
