"""Rigid motions as 4×4 matrices. `T_a_b` takes points of b to a: `p_a = T_a_b @ p_b`."""

import numpy as np

from stillroom.geometry.arrays import F64, Floats


def identity() -> F64:
    """Return the motion that moves nothing, (4, 4)."""
    return np.eye(4)


def from_rotation_translation(R_a_b: Floats, t_a_b_m: Floats) -> F64:
    """Assemble `T_a_b` (4, 4) from a rotation (3, 3) and a translation (3,)."""
    T_a_b = np.zeros((4, 4))
    T_a_b[:3, :3] = R_a_b
    T_a_b[:3, 3] = t_a_b_m
    T_a_b[3, 3] = 1.0
    return T_a_b


def inverse(T_a_b: Floats) -> F64:
    """Return `T_b_a` (..., 4, 4) of rigid motions `T_a_b` (..., 4, 4), using that the rotation is orthogonal."""
    if T_a_b.ndim == 2:  # One motion, the common case, without the machinery for many.
        R_b_a = T_a_b[:3, :3].T
        return from_rotation_translation(R_b_a, -(R_b_a @ T_a_b[:3, 3]))
    T_b_a = np.zeros_like(T_a_b, dtype=np.float64)
    R_b_a = np.swapaxes(T_a_b[..., :3, :3], -1, -2)
    T_b_a[..., :3, :3] = R_b_a
    T_b_a[..., :3, 3] = -np.einsum("...ij,...j->...i", R_b_a, T_a_b[..., :3, 3])
    T_b_a[..., 3, 3] = 1.0
    return T_b_a


def transform(T_a_b: Floats, points_b: Floats) -> F64:
    """Take points (N, 3) of b to a, (N, 3)."""
    moved: F64 = points_b @ T_a_b[:3, :3].T + T_a_b[:3, 3]
    return moved


def skew(v: Floats) -> F64:
    """Return the matrix (3, 3) whose product with w is the cross product v × w."""
    x, y, z = float(v[0]), float(v[1]), float(v[2])
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def exp(xi: Floats) -> F64:
    """Return the motion (4, 4) of a twist (6,): translation part [m] first, then rotation vector [rad]."""
    rho, phi = np.asarray(xi[:3], dtype=np.float64), np.asarray(xi[3:], dtype=np.float64)
    angle_rad = float(np.linalg.norm(phi))
    W = skew(phi)
    if angle_rad < 1e-8:
        R, V = np.eye(3) + W, np.eye(3) + 0.5 * W
    else:
        a = np.sin(angle_rad) / angle_rad
        b = (1.0 - np.cos(angle_rad)) / angle_rad**2
        c = (1.0 - a) / angle_rad**2
        R = np.eye(3) + a * W + b * W @ W
        V = np.eye(3) + b * W + c * W @ W
    return from_rotation_translation(R, V @ rho)


def angle_rad(T_a_b: Floats) -> F64:
    """Return the rotation angle [rad], shape (...,), of motions (..., 4, 4).

    Uses atan2 of sine and cosine, which stays exact for tiny angles where arccos of the trace does not.
    """
    R = T_a_b[..., :3, :3]
    sine = 0.5 * np.sqrt(
        (R[..., 2, 1] - R[..., 1, 2]) ** 2 + (R[..., 0, 2] - R[..., 2, 0]) ** 2 + (R[..., 1, 0] - R[..., 0, 1]) ** 2
    )
    cosine = 0.5 * (np.trace(R, axis1=-2, axis2=-1) - 1.0)
    return np.asarray(np.arctan2(sine, cosine), dtype=np.float64)


def are_near(T_a_b: Floats, T_c_b: Floats, reach_m: float, reach_rad: float) -> bool:
    """Return whether two poses (4, 4) of b, in frames a and c, differ by at most a distance and a rotation angle."""
    T_a_c = T_a_b @ inverse(T_c_b)
    return float(np.linalg.norm(T_a_c[:3, 3])) <= reach_m and float(angle_rad(T_a_c)) <= reach_rad


def orthonormalize(T_a_b: Floats) -> F64:
    """Return `T_a_b` (..., 4, 4) with its rotation replaced by the nearest true rotation."""
    U, _, Vt = np.linalg.svd(T_a_b[..., :3, :3])
    R = U @ Vt
    if T_a_b.ndim > 2:
        mirror = np.ones((*T_a_b.shape[:-2], 1, 3))
        mirror[..., 0, 2] = np.sign(np.linalg.det(R))
        T_true = np.array(T_a_b, dtype=np.float64)
        T_true[..., :3, :3] = (U * mirror) @ Vt
        return T_true
    (a, b, c), (d, e, f), (g, h, i) = R.tolist()  # one motion, the common case, without the machinery for many
    if a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) < 0.0:  # a mirror
        R = U @ np.diag([1.0, 1.0, -1.0]) @ Vt
    return from_rotation_translation(R, T_a_b[:3, 3])


def from_quaternions_xyzw(quaternions_xyzw: Floats, translations_m: Floats) -> F64:
    """Return motions (N, 4, 4) from unit quaternions (N, 4), order x y z w, and translations (N, 3)."""
    q = np.asarray(quaternions_xyzw, dtype=np.float64)
    x, y, z, w = (q / np.linalg.norm(q, axis=1, keepdims=True)).T
    T_a_b = np.zeros((len(q), 4, 4))
    T_a_b[:, 0, 0] = 1 - 2 * (y * y + z * z)
    T_a_b[:, 0, 1] = 2 * (x * y - z * w)
    T_a_b[:, 0, 2] = 2 * (x * z + y * w)
    T_a_b[:, 1, 0] = 2 * (x * y + z * w)
    T_a_b[:, 1, 1] = 1 - 2 * (x * x + z * z)
    T_a_b[:, 1, 2] = 2 * (y * z - x * w)
    T_a_b[:, 2, 0] = 2 * (x * z - y * w)
    T_a_b[:, 2, 1] = 2 * (y * z + x * w)
    T_a_b[:, 2, 2] = 1 - 2 * (x * x + y * y)
    T_a_b[:, :3, 3] = translations_m
    T_a_b[:, 3, 3] = 1.0
    return T_a_b


def to_quaternions_xyzw(T_a_b: Floats) -> F64:
    """Return unit quaternions (N, 4), order x y z w with w ≥ 0, of motions (N, 4, 4)."""
    from scipy.spatial.transform import Rotation

    quaternions = np.asarray(Rotation.from_matrix(T_a_b[:, :3, :3]).as_quat(), dtype=np.float64)
    return np.where(quaternions[:, 3:] < 0, -quaternions, quaternions)
