"""Two views of a static point: the epipolar constraint."""

import numpy as np

from stillroom.geometry import se3
from stillroom.geometry.arrays import F64, Floats


def fundamental_from_motion(T_second_first: Floats, K: Floats) -> F64:
    """Return F (3, 3) with `p_second @ F @ p_first = 0` from a known motion (4, 4): F = K⁻ᵀ [t]× R K⁻¹.

    OC-SLAM Eq. 1; Hartley and Zisserman, Eq. 9.2.
    """
    K_inverse = np.linalg.inv(K)
    return np.asarray(K_inverse.T @ se3.skew(T_second_first[:3, 3]) @ T_second_first[:3, :3] @ K_inverse)


def line_distances_px(F_second_first: Floats, first_px: Floats, second_px: Floats) -> F64:
    """Return how far each second point lies from the epipolar line of its first point, (N,) [px].

    OC-SLAM Eq. 2, with the normalisation √(A² + B²) of a point-to-line distance and the absolute value that the
    printed equation lacks (it divides by √(A² + B² + C²)). Infinite where F gives no line.
    """
    ones = np.ones((len(first_px), 1))
    lines = np.hstack((first_px, ones)) @ np.asarray(F_second_first).T
    numerator = np.abs(np.einsum("ij,ij->i", lines, np.hstack((second_px, ones))))
    norm = np.hypot(lines[:, 0], lines[:, 1])
    return np.where(norm > 0, numerator / np.where(norm > 0, norm, 1.0), np.inf)
