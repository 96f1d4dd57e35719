"""What pose-only optimisation and bundle adjustment share: one observation, its derivative, and the pose update.

An observation is (u, v, u_right) [px] with u_right = u − bf/z; a weight of zero on u_right means there is none. Where
depth counts by the noise of its sensor (`optimize/depth_terms.py`) the third coordinate is −bf/z alone: u is no part of
it then, nor an error of u of what depth tells. The error is predicted minus observed. A camera moves on the left,
T ← exp(ξ) T with ξ = (ρ [m], φ [rad]), so a point x of the camera frame changes by ρ − [x]× φ, and both camera and
point Jacobians contain the same 3×3 derivative of the projection. The kernels are scalars in, scalars out: numba
inlines them into the loops that call them.
"""

import math

import numpy as np

from stillroom.compiled import njit
from stillroom.geometry.arrays import F64, Floats, Ints
from stillroom.geometry.camera import Camera

MIN_DEPTH_M = 1e-3
"""A point nearer than this counts as behind the camera: its projection is meaningless."""


# Keypoints as the optimisers want them.


@njit(nogil=True, cache=True)
def observed_px(px: Floats, right_px: Floats) -> F64:
    """Return u, v, u_right (N, 3) [px] of keypoints at (N, 2) with right coordinates (N,), −1 for none."""
    observed = np.empty((len(px), 3))
    for i in range(len(px)):
        observed[i, 0], observed[i, 1], observed[i, 2] = px[i, 0], px[i, 1], max(right_px[i], 0.0)
    return observed


@njit(nogil=True, cache=True)
def weights(octave: Ints, right_px: Floats, inverse_variances: Floats) -> F64:
    """Return inverse variances (N, 3) [1/px²]; the third is 0 where there is no right coordinate.

    Args:
        octave: Level of each keypoint (N,).
        right_px: Right coordinates (N,), −1 for none.
        inverse_variances: Weight on each level (L,) [1/px²].
    """
    weight = np.empty((len(octave), 3))
    for i in range(len(octave)):
        weight[i, :] = inverse_variances[octave[i]]
        if not right_px[i] >= 0:
            weight[i, 2] = 0.0
    return weight


@njit(nogil=True, cache=True)
def of_keypoints(
    chosen: Ints, px: Floats, octave: Ints, right_px: Floats, inverse_variances: Floats
) -> tuple[F64, F64]:
    """Return `observed_px` and `weights` of chosen keypoints (M,) of all (N,)."""
    observed, weight = np.empty((len(chosen), 3)), np.empty((len(chosen), 3))
    for i in range(len(chosen)):
        k = chosen[i]
        observed[i, 0], observed[i, 1], observed[i, 2] = px[k, 0], px[k, 1], max(right_px[k], 0.0)
        weight[i, :] = inverse_variances[octave[k]]
        if not right_px[k] >= 0:
            weight[i, 2] = 0.0
    return observed, weight


def intrinsics_of(camera: Camera, share_of_u: float = 1.0) -> F64:
    """Return what the kernels take, (6,): fx, fy, cx, cy [px], bf [px·m], and the share of u in the third coordinate.

    Args:
        camera: The calibration.
        share_of_u: 1 where the third coordinate is u − bf/z, 0 where it is −bf/z.
    """
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy, camera.bf, share_of_u])


@njit(nogil=True, cache=True)
def to_camera(T: F64, X: float, Y: float, Z: float) -> tuple[float, float, float]:
    """Take one world point [m] to the camera frame [m] of `T` = T_cam_world (4, 4)."""
    x = T[0, 0] * X + T[0, 1] * Y + T[0, 2] * Z + T[0, 3]
    y = T[1, 0] * X + T[1, 1] * Y + T[1, 2] * Z + T[1, 3]
    z = T[2, 0] * X + T[2, 1] * Y + T[2, 2] * Z + T[2, 3]
    return x, y, z


@njit(nogil=True, cache=True)
def residual(
    x: float, y: float, z: float, observed: F64, intrinsics: F64, has_right: bool
) -> tuple[float, float, float]:
    """Return predicted minus observed (u, v, third coordinate) [px] of a camera-frame point [m] with z > 0.

    The third is 0 where there is no right coordinate, whatever `observed` (3,) holds there.
    """
    u = intrinsics[0] * x / z + intrinsics[2]
    e_u = u - observed[0]
    e_v = intrinsics[1] * y / z + intrinsics[3] - observed[1]
    e_r = intrinsics[5] * u - intrinsics[4] / z - observed[2] if has_right else 0.0
    return e_u, e_v, e_r


@njit(nogil=True, cache=True)
def chi_square(x: float, y: float, z: float, observed: F64, weight: F64, intrinsics: F64) -> float:
    """Return the weighted squared error of one observation; infinite behind the camera or where a number is NaN."""
    if not z > MIN_DEPTH_M:
        return np.inf
    e_u, e_v, e_r = residual(x, y, z, observed, intrinsics, weight[2] > 0.0)
    chi2: float = weight[0] * e_u * e_u + weight[1] * e_v * e_v + weight[2] * e_r * e_r
    return chi2 if chi2 < np.inf else np.inf


@njit(nogil=True, cache=True)
def behind_chi_square(weight: F64, intrinsics: F64) -> float:
    """Return what an observation costs while its point is behind the camera: an error of 2 fx in every coordinate.

    A finite constant, above what any error within the image costs: without it a step could lower the cost by
    carrying points behind the camera, and with infinity one wild point could stop all the others.
    """
    cost: float = 4.0 * intrinsics[0] * intrinsics[0] * (weight[0] + weight[1] + weight[2])
    return cost


@njit(nogil=True, cache=True)
def huber(chi2: float, delta2: float) -> tuple[float, float]:
    """Return Huber's ρ(χ²) and its derivative, the factor on the weights; δ² infinite means no kernel.

    ρ = χ² up to δ², beyond it 2δχ − δ² (the convention of g2o).
    """
    if chi2 <= delta2:
        return chi2, 1.0
    chi = math.sqrt(chi2)
    delta = math.sqrt(delta2)
    return 2.0 * delta * chi - delta2, delta / chi


@njit(nogil=True, cache=True)
def point_information(
    point: tuple[float, float, float],
    error: tuple[float, float, float],
    weight: F64,
    factor: float,
    intrinsics: F64,
) -> tuple[float, float, float, float, float, float, float, float, float]:
    """Return JᵀWJ and JᵀWe of one observation, J the derivative (3, 3) of (u, v, u_right) by the camera-frame point.

    Everything else follows: with G = [I, −[x]×] a camera's block is GᵀJᵀWJG, a point's RᵀJᵀWJR, the mixed one
    GᵀJᵀWJR.

    Args:
        point: x, y, z in the camera's frame [m].
        error: Predicted minus observed, from `residual` [px].
        weight: Inverse variances (3,) [1/px²].
        factor: The robust kernel's, times the probability that the point is static.
        intrinsics: Those of `intrinsics_of` (6,).

    Returns:
        a00, a01, a02, a11, a12, a22 of the symmetric JᵀWJ [1/m²], then g0, g1, g2 of JᵀWe [1/m].
    """
    x, y, z = point
    e_u, e_v, e_r = error
    inv_z = 1.0 / z
    j_u0 = intrinsics[0] * inv_z
    j_u2 = -j_u0 * x * inv_z
    j_v1 = intrinsics[1] * inv_z
    j_v2 = -j_v1 * y * inv_z
    share = intrinsics[5]  # 0 or 1, so that products with it are exact
    j_r2 = share * j_u2 + intrinsics[4] * inv_z * inv_z
    w_u, w_v, w_r = factor * weight[0], factor * weight[1], factor * weight[2]
    a00 = (w_u + share * w_r) * j_u0 * j_u0
    a02 = j_u0 * (w_u * j_u2 + share * w_r * j_r2)
    a11 = w_v * j_v1 * j_v1
    a12 = w_v * j_v1 * j_v2
    a22 = w_u * j_u2 * j_u2 + w_v * j_v2 * j_v2 + w_r * j_r2 * j_r2
    g0 = j_u0 * (w_u * e_u + share * w_r * e_r)
    g1 = w_v * j_v1 * e_v
    g2 = w_u * j_u2 * e_u + w_v * j_v2 * e_v + w_r * j_r2 * e_r
    return a00, 0.0, a02, a11, a12, a22, g0, g1, g2


@njit(nogil=True, cache=True)
def camera_blocks(x: float, y: float, z: float, information: tuple[float, ...], H: F64, b: F64) -> None:
    """Add GᵀJᵀWJG to the lower triangle of `H` (6, 6) and GᵀJᵀWe to `b` (6,), with G = [I, −[x]×]."""
    a00, a01, a02, a11, a12, a22, g0, g1, g2 = information
    H[0, 0] += a00
    H[1, 0] += a01
    H[1, 1] += a11
    H[2, 0] += a02
    H[2, 1] += a12
    H[2, 2] += a22
    # C = [x]× A; the lower left block is C, the lower right one C [x]×ᵀ.
    c00, c01, c02 = y * a02 - z * a01, y * a12 - z * a11, y * a22 - z * a12
    c10, c11, c12 = z * a00 - x * a02, z * a01 - x * a12, z * a02 - x * a22
    c20, c21, c22 = x * a01 - y * a00, x * a11 - y * a01, x * a12 - y * a02
    H[3, 0] += c00
    H[3, 1] += c01
    H[3, 2] += c02
    H[4, 0] += c10
    H[4, 1] += c11
    H[4, 2] += c12
    H[5, 0] += c20
    H[5, 1] += c21
    H[5, 2] += c22
    H[3, 3] += y * c02 - z * c01
    H[4, 3] += y * c12 - z * c11
    H[5, 3] += y * c22 - z * c21
    H[4, 4] += z * c10 - x * c12
    H[5, 4] += z * c20 - x * c22
    H[5, 5] += x * c21 - y * c20
    b[0] += g0
    b[1] += g1
    b[2] += g2
    b[3] += y * g2 - z * g1
    b[4] += z * g0 - x * g2
    b[5] += x * g1 - y * g0


@njit(nogil=True, cache=True)
def retract(T: F64, xi: F64, moved: F64) -> None:
    """Write exp(ξ) T into `moved` (4, 4); ξ (6,) is translation part [m], then rotation vector [rad].

    One Newton step towards orthogonality follows, so that no number of updates lets the rotation decay.
    """
    p0, p1, p2 = xi[3], xi[4], xi[5]
    angle2 = p0 * p0 + p1 * p1 + p2 * p2
    if angle2 < 1e-6:
        a, b, c = 1.0 - angle2 / 6.0, 0.5 - angle2 / 24.0, 1.0 / 6.0 - angle2 / 120.0
    else:
        angle = math.sqrt(angle2)
        half_sine = math.sin(0.5 * angle)
        a = math.sin(angle) / angle
        b = 2.0 * half_sine * half_sine / angle2
        c = (1.0 - a) / angle2
    W = np.array([[0.0, -p2, p1], [p2, 0.0, -p0], [-p1, p0, 0.0]])
    R = np.empty((3, 3))
    t = np.zeros(3)
    for i in range(3):
        for j in range(3):
            square = W[i, 0] * W[0, j] + W[i, 1] * W[1, j] + W[i, 2] * W[2, j]
            one = 1.0 if i == j else 0.0
            R[i, j] = one + a * W[i, j] + b * square
            t[i] += (one + b * W[i, j] + c * square) * xi[j]
    M = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            M[i, j] = R[i, 0] * T[0, j] + R[i, 1] * T[1, j] + R[i, 2] * T[2, j]
        moved[i, 3] = R[i, 0] * T[0, 3] + R[i, 1] * T[1, 3] + R[i, 2] * T[2, 3] + t[i]
    for i in range(3):
        for j in range(3):
            moved[i, j] = 1.5 * M[i, j]
            for k in range(3):
                moved[i, j] -= 0.5 * M[i, k] * (M[0, k] * M[0, j] + M[1, k] * M[1, j] + M[2, k] * M[2, j])
    moved[3, 0], moved[3, 1], moved[3, 2], moved[3, 3] = 0.0, 0.0, 0.0, 1.0
