"""Where map points should appear in an image (ORB-SLAM2's isInFrustum)."""

from dataclasses import dataclass

import numpy as np
from numba import njit

from stillroom.geometry.arrays import F32, F64, I32, Bool, Floats
from stillroom.geometry.camera import Camera


@dataclass(frozen=True)
class Projection:
    """Where P points appear.

    Attributes:
        px: Undistorted pixel (P, 2) float32.
        right_px: Right coordinate (P,) float32.
        octave: Level on which the point should be found (P,) int32.
        view_cos: Cosine between present and mean viewing direction (P,) float32.
        depth_m: Depth (P,) float64 [m].
        visible: Whether it should be found at all (P,).
    """

    px: F32
    right_px: F32
    octave: I32
    view_cos: F32
    depth_m: F64
    visible: Bool


def project_points(
    T_cam_world: F64,
    camera: Camera,
    scale_factors: F64,
    points_world_m: F64,
    normals: F64,
    min_distance_m: Floats,
    max_distance_m: Floats,
    min_view_cos: float = 0.5,
) -> Projection:
    """Project points with their viewing geometry (P, …) into a camera at `T_cam_world` (4, 4)."""
    n = len(points_world_m)
    result = Projection(
        np.zeros((n, 2), np.float32),
        np.zeros(n, np.float32),
        np.zeros(n, np.int32),
        np.zeros(n, np.float32),
        np.zeros(n, np.float64),
        np.zeros(n, np.bool_),
    )
    _project(
        np.ascontiguousarray(T_cam_world),
        np.array([camera.fx, camera.fy, camera.cx, camera.cy, camera.bf]),
        np.array(camera.undistorted_bounds_px),
        float(np.log(scale_factors[1])) if len(scale_factors) > 1 else 1.0,
        len(scale_factors),
        points_world_m,
        normals,
        np.asarray(min_distance_m, dtype=np.float64),
        np.asarray(max_distance_m, dtype=np.float64),
        min_view_cos,
        result.px,
        result.right_px,
        result.octave,
        result.view_cos,
        result.depth_m,
        result.visible,
    )
    return result


@njit(nogil=True, cache=True)
def _project(
    T: F64,
    intrinsics: F64,
    bounds_px: F64,
    log_factor: float,
    n_levels: int,
    points: F64,
    normals: F64,
    min_distance_m: F64,
    max_distance_m: F64,
    min_view_cos: float,
    px: F32,
    right_px: F32,
    octave: I32,
    view_cos: F32,
    depth_m: F64,
    visible: Bool,
) -> None:
    fx, fy, cx, cy, bf = intrinsics
    ox = -(T[0, 0] * T[0, 3] + T[1, 0] * T[1, 3] + T[2, 0] * T[2, 3])
    oy = -(T[0, 1] * T[0, 3] + T[1, 1] * T[1, 3] + T[2, 1] * T[2, 3])
    oz = -(T[0, 2] * T[0, 3] + T[1, 2] * T[1, 3] + T[2, 2] * T[2, 3])
    for i in range(len(points)):
        X, Y, Z = points[i, 0], points[i, 1], points[i, 2]
        z = T[2, 0] * X + T[2, 1] * Y + T[2, 2] * Z + T[2, 3]
        depth_m[i] = z
        if z <= 0.05:
            continue
        u = fx * (T[0, 0] * X + T[0, 1] * Y + T[0, 2] * Z + T[0, 3]) / z + cx
        v = fy * (T[1, 0] * X + T[1, 1] * Y + T[1, 2] * Z + T[1, 3]) / z + cy
        px[i, 0], px[i, 1] = u, v
        right_px[i] = u - bf / z
        if u < bounds_px[0] or v < bounds_px[1] or u > bounds_px[2] or v > bounds_px[3]:
            continue
        dx, dy, dz = X - ox, Y - oy, Z - oz
        distance = np.sqrt(dx * dx + dy * dy + dz * dz)
        if distance < 0.8 * min_distance_m[i] or distance > 1.2 * max_distance_m[i]:
            continue
        cosine = (dx * normals[i, 0] + dy * normals[i, 1] + dz * normals[i, 2]) / distance
        view_cos[i] = cosine
        if cosine < min_view_cos:
            continue
        level = int(np.ceil(np.log(max_distance_m[i] / distance) / log_factor))
        octave[i] = min(max(level, 0), n_levels - 1)
        visible[i] = True
