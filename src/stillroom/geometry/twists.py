"""Many small motions at once: logarithm, exponential and derivatives on SE(3) for arrays of poses.

Twists are (ρ [m], φ [rad]), as in `se3.exp`. Formulas: Barfoot, State Estimation for Robotics (2017), section 7.1.
"""

import numpy as np

from stillroom.geometry.arrays import F64, Floats
from stillroom.geometry.twist_kernels import log_of

_SMALL_RAD = 0.05
"""Below this angle the coefficients come from their series, which is then exact to rounding."""


def exp(twists: Floats) -> F64:
    """Return the motions (N, 4, 4) of twists (N, 6)."""
    from scipy.spatial.transform import Rotation

    rho, phi = np.asarray(twists, dtype=np.float64)[:, :3], np.asarray(twists, dtype=np.float64)[:, 3:]
    W = skew(phi)
    _, b, c, _, _ = _coefficients(np.linalg.norm(phi, axis=1))
    V = np.eye(3) + b[:, None, None] * W + c[:, None, None] * (W @ W)
    motions = np.zeros((len(rho), 4, 4))
    motions[:, :3, :3] = Rotation.from_rotvec(phi).as_matrix()
    motions[:, :3, 3] = np.einsum("nij,nj->ni", V, rho)
    motions[:, 3, 3] = 1.0
    return motions


def log(T_a_b: Floats) -> F64:
    """Return the twists (N, 6) of motions (N, 4, 4); rotation vectors are at most π long."""
    from scipy.spatial.transform import Rotation

    phi = np.asarray(Rotation.from_matrix(T_a_b[:, :3, :3]).as_rotvec(), dtype=np.float64)
    rho = np.einsum("nij,nj->ni", _inverse_left_jacobian_so3(phi), T_a_b[:, :3, 3])
    return np.concatenate((rho, phi), axis=1)


def of_motion(T_a_b: Floats) -> F64:
    """Return the twist (6,) of one motion (4, 4), as `log`, without the machinery for many."""
    twist = np.empty(6)
    log_of(np.ascontiguousarray(T_a_b, dtype=np.float64), twist)
    return twist


def adjoint(T_a_b: Floats) -> F64:
    """Return the matrices (N, 6, 6) that take twists of b to a: `exp(Ad ξ) T_a_b = T_a_b exp(ξ)`."""
    R = T_a_b[:, :3, :3]
    adjoints = np.zeros((len(R), 6, 6))
    adjoints[:, :3, :3] = R
    adjoints[:, 3:, 3:] = R
    adjoints[:, :3, 3:] = skew(T_a_b[:, :3, 3]) @ R
    return adjoints


def inverse_right_jacobian(twists: Floats) -> F64:
    """Return the derivatives (N, 6, 6) of `log(exp(r) exp(ξ))` by ξ at 0, for twists r (N, 6)."""
    opposite = -np.asarray(twists, dtype=np.float64)
    rho, phi = opposite[:, :3], opposite[:, 3:]  # J_right(r) = J_left(−r)
    inverse = _inverse_left_jacobian_so3(phi)
    jacobians = np.zeros((len(rho), 6, 6))
    jacobians[:, :3, :3] = inverse
    jacobians[:, 3:, 3:] = inverse
    jacobians[:, :3, 3:] = -inverse @ _mixed_block(rho, phi) @ inverse
    return jacobians


def skew(v: Floats) -> F64:
    """Return the matrices (N, 3, 3) whose products with w are the cross products v × w, v (N, 3)."""
    matrices = np.zeros((len(v), 3, 3))
    matrices[:, 0, 1], matrices[:, 0, 2], matrices[:, 1, 2] = -v[:, 2], v[:, 1], -v[:, 0]
    matrices[:, 1, 0], matrices[:, 2, 0], matrices[:, 2, 1] = v[:, 2], -v[:, 1], v[:, 0]
    return matrices


def _inverse_left_jacobian_so3(phi: F64) -> F64:
    W = skew(phi)
    a, b, _, _, _ = _coefficients(np.linalg.norm(phi, axis=1))
    angle2 = np.einsum("ni,ni->n", phi, phi)
    small = angle2 < _SMALL_RAD**2
    series = 1.0 / 12.0 + angle2 / 720.0 + angle2**2 / 30240.0
    d = np.where(small, series, (1.0 - 0.5 * a / b) / np.where(small, 1.0, angle2))
    inverse: F64 = np.eye(3) - 0.5 * W + d[:, None, None] * (W @ W)
    return inverse


def _mixed_block(rho: F64, phi: F64) -> F64:
    """Return Barfoot's Q (N, 3, 3), Eq. 7.86."""
    P, W = skew(rho), skew(phi)
    _, _, c, d, e = (k[:, None, None] for k in _coefficients(np.linalg.norm(phi, axis=1)))
    WP, PW = W @ P, P @ W
    WPW = WP @ W
    Q: F64 = 0.5 * P + c * (WP + PW + WPW) + d * (W @ WP + PW @ W - 3.0 * WPW) + e * (WPW @ W + W @ WPW)
    return Q


def _coefficients(angle: F64) -> tuple[F64, F64, F64, F64, F64]:
    """Return sin θ/θ, (1 − cos θ)/θ², (θ − sin θ)/θ³, (θ² + 2 cos θ − 2)/2θ⁴, (2θ − 3 sin θ + θ cos θ)/2θ⁵."""
    small = angle < _SMALL_RAD
    t = np.where(small, 1.0, angle)
    s, c = np.sin(t), np.cos(t)
    exact = (
        s / t,
        2.0 * np.sin(0.5 * t) ** 2 / t**2,
        (t - s) / t**3,
        (t**2 + 2.0 * c - 2.0) / (2.0 * t**4),
        (2.0 * t - 3.0 * s + t * c) / (2.0 * t**5),
    )
    q = angle**2
    series = (
        1.0 - q / 6.0 + q**2 / 120.0,
        0.5 - q / 24.0 + q**2 / 720.0,
        1.0 / 6.0 - q / 120.0 + q**2 / 5040.0,
        1.0 / 24.0 - q / 720.0 + q**2 / 40320.0,
        1.0 / 120.0 - q / 2520.0 + q**2 / 120960.0,
    )
    first, second, third, fourth, fifth = (np.where(small, near, far) for near, far in zip(series, exact, strict=True))
    return first, second, third, fourth, fifth
