"""Points from two views."""

import numpy as np

from stillroom.geometry.arrays import F64, Floats


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


def ray_cosines(T_world_first: Floats, T_world_second: Floats, first_rays: Floats, second_rays: Floats) -> F64:
    """Return the cosine (N,) of the angle between two cameras' rays (N, 2) to the same point."""
    first = np.column_stack((first_rays, np.ones(len(first_rays)))) @ np.asarray(T_world_first)[:3, :3].T
    second = np.column_stack((second_rays, np.ones(len(second_rays)))) @ np.asarray(T_world_second)[:3, :3].T
    lengths = np.linalg.norm(first, axis=1) * np.linalg.norm(second, axis=1)
    return np.asarray(np.einsum("ij,ij->i", first, second) / lengths)
