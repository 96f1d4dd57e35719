"""Two views of a static point: the epipolar constraint."""

import numpy as np

from stillroom.geometry.arrays import F64, Floats


def fundamental_from_motion(T_second_first: Floats, K: Floats) -> F64:
    """Return F (..., 3, 3) with `p_second @ F @ p_first = 0` from known motions (..., 4, 4): F = K⁻ᵀ [t]× R K⁻¹.

    OC-SLAM Eq. 1; Hartley and Zisserman, Eq. 9.2.
    """
    K_inverse = np.linalg.inv(K)
    R = np.asarray(T_second_first)[..., :3, :3]
    t = np.asarray(T_second_first)[..., :3, 3]
    return np.asarray(K_inverse.T @ np.cross(t[..., None, :], R, axisb=-2, axisc=-2) @ K_inverse)


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
