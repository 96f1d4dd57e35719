"""Similarities as 4×4 matrices `S_a_b = [[s R, t], [0, 1]]`: `p_a = s R p_b + t`; and their logarithm and derivatives.

The motions of a map whose scale is free. A rigid motion is one of scale 1, so rigid and similar ones multiply as
matrices. Tangents are (ρ, φ [rad], σ): those of `twists`, and the logarithm of the scale. Formulas: Strasdat, Local
Accuracy and Global Consistency for Efficient Visual SLAM (2012), section 2.4.
"""

import numpy as np

from stillroom.geometry.arrays import F64, Floats
from stillroom.geometry.twists import skew

_NODES, _SHARES = np.polynomial.legendre.leggauss(20)
_NODES, _SHARES = 0.5 * (_NODES + 1.0), 0.5 * _SHARES
"""Gauss's rule on [0, 1]: exact to rounding for what is integrated here, up to half a turn and a scale of e⁸."""
_TERMS = 40
"""Terms of the exponential series of a derivative; the last is below rounding in the same range."""


def of(T_a_b: Floats, scale: Floats | float) -> F64:
    """Return similarities (N, 4, 4) with the rotations and translations of motions (N, 4, 4), and scales (N,)."""
    S_a_b = np.array(T_a_b, dtype=np.float64)
    S_a_b[..., :3, :3] *= np.asarray(scale)[..., None, None]
    return S_a_b


def scale(S_a_b: Floats) -> F64:
    """Return the scales (...,) of similarities (..., 4, 4)."""
    return np.asarray(np.cbrt(np.linalg.det(S_a_b[..., :3, :3])), dtype=np.float64)


def rigid(S_a_b: Floats) -> F64:
    """Return similarities (..., 4, 4) without their scale: the pose of a camera whose coordinates they take to a."""
    T_a_b = np.array(S_a_b, dtype=np.float64)
    T_a_b[..., :3, :3] /= scale(T_a_b)[..., None, None]
    return T_a_b


def inverse(S_a_b: Floats) -> F64:
    """Return `S_b_a` (..., 4, 4) of similarities `S_a_b` (..., 4, 4)."""
    S_b_a = np.zeros_like(S_a_b, dtype=np.float64)
    A = np.swapaxes(S_a_b[..., :3, :3], -1, -2) / scale(S_a_b)[..., None, None] ** 2
    S_b_a[..., :3, :3] = A
    S_b_a[..., :3, 3] = -np.einsum("...ij,...j->...i", A, S_a_b[..., :3, 3])
    S_b_a[..., 3, 3] = 1.0
    return S_b_a


def exp(tangents: Floats) -> F64:
    """Return the similarities (N, 4, 4) of tangents (N, 7)."""
    from scipy.spatial.transform import Rotation

    xi = np.asarray(tangents, dtype=np.float64)
    S = np.zeros((len(xi), 4, 4))
    S[:, :3, :3] = np.exp(xi[:, 6])[:, None, None] * Rotation.from_rotvec(xi[:, 3:6]).as_matrix()
    S[:, :3, 3] = np.einsum("nij,nj->ni", _mean_similarity(xi[:, 3:6], xi[:, 6]), xi[:, :3])
    S[:, 3, 3] = 1.0
    return S


def log(S_a_b: Floats) -> F64:
    """Return the tangents (N, 7) of similarities (N, 4, 4); rotation vectors are at most π long."""
    from scipy.spatial.transform import Rotation

    s = scale(S_a_b)
    phi = np.asarray(Rotation.from_matrix(S_a_b[:, :3, :3] / s[:, None, None]).as_rotvec(), dtype=np.float64)
    rho = np.linalg.solve(_mean_similarity(phi, np.log(s)), S_a_b[:, :3, 3:])[:, :, 0]
    return np.concatenate((rho, phi, np.log(s)[:, None]), axis=1)


def adjoint(S_a_b: Floats) -> F64:
    """Return the matrices (N, 7, 7) that take tangents of b to a: `exp(Ad ξ) S_a_b = S_a_b exp(ξ)`."""
    A, t = S_a_b[:, :3, :3], S_a_b[:, :3, 3]
    R = A / scale(S_a_b)[:, None, None]
    adjoints = np.zeros((len(A), 7, 7))
    adjoints[:, :3, :3] = A
    adjoints[:, :3, 3:6] = skew(t) @ R
    adjoints[:, :3, 6] = -t
    adjoints[:, 3:6, 3:6] = R
    adjoints[:, 6, 6] = 1.0
    return adjoints


def inverse_right_jacobian(tangents: Floats) -> F64:
    """Return the derivatives (N, 7, 7) of `log(exp(r) exp(ξ))` by ξ at 0, for tangents r (N, 7)."""
    opposite = -_small_adjoint(np.asarray(tangents, dtype=np.float64))
    unit = np.eye(7)
    jacobians = np.zeros_like(opposite) + unit
    for k in range(_TERMS, 1, -1):  # Σ (−ad)ⁿ / (n + 1)!, from the last term on
        jacobians = unit + opposite @ jacobians / k
    return np.asarray(np.linalg.inv(jacobians), dtype=np.float64)


def _small_adjoint(xi: F64) -> F64:
    """Return the matrices (N, 7, 7) whose products with η are the brackets [ξ, η]."""
    W = skew(xi[:, 3:6])
    matrices = np.zeros((len(xi), 7, 7))
    matrices[:, :3, :3] = W + xi[:, 6, None, None] * np.eye(3)
    matrices[:, :3, 3:6] = skew(xi[:, :3])
    matrices[:, :3, 6] = -xi[:, :3]
    matrices[:, 3:6, 3:6] = W
    return matrices


def _mean_similarity(phi: F64, sigma: F64) -> F64:
    """Return the matrices V (N, 3, 3) with t = V ρ: the mean of exp(τ (φ× + σ I)) over τ from 0 to 1.

    Integrated by a rule instead of by Strasdat's closed form, whose four cases lose digits where they meet.
    """
    angle = np.linalg.norm(phi, axis=1)[:, None] * _NODES
    weight = _SHARES * np.exp(sigma[:, None] * _NODES)
    of_unit = weight.sum(axis=1)
    of_first = (weight * _NODES * np.sinc(angle / np.pi)).sum(axis=1)
    of_second = (0.5 * weight * (_NODES * np.sinc(0.5 * angle / np.pi)) ** 2).sum(axis=1)
    W = skew(phi)
    V: F64 = of_unit[:, None, None] * np.eye(3) + of_first[:, None, None] * W + of_second[:, None, None] * (W @ W)
    return V
