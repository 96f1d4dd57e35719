"""The fundamental matrix of a motion, written plainly."""

import numpy as np


def fundamental_from_motion(T_second_first: np.ndarray, K: np.ndarray) -> np.ndarray:
    """F (..., 3, 3) with `p_second @ F @ p_first = 0` from motions (..., 4, 4): K⁻ᵀ [t]× R K⁻¹ (Hartley, Eq. 9.2)."""
    K_inverse = np.linalg.inv(K)
    R, t = T_second_first[..., :3, :3], T_second_first[..., :3, 3]
    return K_inverse.T @ np.cross(t[..., None, :], R, axisb=-2, axisc=-2) @ K_inverse
