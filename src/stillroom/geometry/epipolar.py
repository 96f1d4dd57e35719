"""Two views of a static point: the epipolar constraint."""

import numpy as np

from stillroom.compiled import njit
from stillroom.geometry.arrays import F64, I32, Floats
from stillroom.geometry.camera import Lens

# Points from two views.


def triangulate(T_first_world: Floats, T_second_world: Floats, first_rays: Floats, second_rays: Floats) -> F64:
    """Triangulate by the linear method (Hartley and Zisserman, section 12.2).

    Args:
        T_first_world, T_second_world: `T_cam_world` (4, 4) of the two views.
        first_rays, second_rays: Normalised image coordinates (N, 2): x/z, y/z.

    Returns:
        Points (N, 3), world frame; not finite where the rays are parallel.
    """
    P1, P2 = np.asarray(T_first_world)[:3], np.asarray(T_second_world)[:3]
    A = np.stack(
        (
            first_rays[:, :1] * P1[2] - P1[0],
            first_rays[:, 1:] * P1[2] - P1[1],
            second_rays[:, :1] * P2[2] - P2[0],
            second_rays[:, 1:] * P2[2] - P2[1],
        ),
        axis=1,
    )
    homogeneous = np.linalg.svd(A)[2][:, -1]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(homogeneous[:, :3] / homogeneous[:, 3:])


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


def printed_line_distances(F_second_first: Floats, first_px: Floats, second_px: Floats) -> F64:
    """Return OC-SLAM's Eq. 2 as it is printed, (N,): p₂ᵀ F p₁ / √(A² + B² + C²), with a sign.

    It is no distance: C, of a line through an image, is some hundred times A and B, so that the result is as many times
    smaller than `line_distances_px`, and it is negative on one side of the line. 0 where F gives no line.

    Args:
        F_second_first: The matrix (3, 3).
        first_px, second_px: The pairs (N, 2).
    """
    F = np.asarray(F_second_first)
    lines = first_px @ F[:, :2].T + F[:, 2]
    norm = np.linalg.norm(lines, axis=1)
    return np.asarray((np.sum(lines[:, :2] * second_px, axis=1) + lines[:, 2]) / np.where(norm > 0, norm, 1.0))


@njit(nogil=True, cache=True)
def motion_line_distances_px(
    T_second_world: F64, T_world_first: F64, first: I32, first_px: F64, second_px: F64, lens: Lens
) -> F64:
    """Return what `line_distances_px` would, (N,) [px], for first points of many images with known poses.

    Args:
        T_second_world: Pose of the second image (4, 4).
        T_world_first: Poses of the first images (Q, 4, 4).
        first: Image of each first point (N,).
        first_px, second_px: The pairs (N, 2).
        lens: Of the camera; distortion is not read.
    """
    fx, fy, cx, cy = lens.fx, lens.fy, lens.cx, lens.cy
    T = T_second_world
    distances_px = np.empty(len(first))
    t, y, ray = np.empty(3), np.empty(3), np.empty(3)
    for i in range(len(first)):
        P = T_world_first[first[i]]
        x0, x1 = (first_px[i, 0] - cx) / fx, (first_px[i, 1] - cy) / fy
        for r in range(3):
            ray[r] = P[r, 0] * x0 + P[r, 1] * x1 + P[r, 2]
        for r in range(3):
            y[r] = T[r, 0] * ray[0] + T[r, 1] * ray[1] + T[r, 2] * ray[2]
            t[r] = T[r, 0] * P[0, 3] + T[r, 1] * P[1, 3] + T[r, 2] * P[2, 3] + T[r, 3]
        a = (t[1] * y[2] - t[2] * y[1]) / fx
        b = (t[2] * y[0] - t[0] * y[2]) / fy
        c = t[0] * y[1] - t[1] * y[0] - a * cx - b * cy
        norm = np.hypot(a, b)
        distance = abs(a * second_px[i, 0] + b * second_px[i, 1] + c)
        distances_px[i] = distance / norm if norm > 0.0 else np.inf
    return distances_px
