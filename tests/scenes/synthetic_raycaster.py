"""A slow, plain ray caster over the same patches: no planes in the image, no intervals, no z-buffer."""

import numpy as np

from stillroom.geometry.arrays import F64, I32, Ints
from stillroom.geometry.camera import Camera
from stillroom_scenes.scene.patches import Patches


def cast(patches: Patches, camera: Camera, T_world_cam: F64, pixels: Ints) -> tuple[F64, I32, F64]:
    """Cast a ray through each pixel (N, 2), x then y.

    Returns:
        Depth (N,) along the optical axis, infinite where nothing is hit; instance (N,), −1 there; and how clear the
        answer is (N,): the least change of s or t (as shares of the patch) that would change which patch is hit.
    """
    origin = T_world_cam[:3, 3]
    corner, edge_s, edge_t = (patches.shape_m.reshape(-1, 3, 3)[:, k] for k in range(3))
    normal = np.cross(edge_s, edge_t)
    is_triangle, instance = patches.kind[:, 0] == 1, patches.kind[:, 2]
    gram = np.stack([np.sum(a * b, axis=1) for a, b in ((edge_s, edge_s), (edge_s, edge_t), (edge_t, edge_t))])
    determinant = gram[0] * gram[2] - gram[1] ** 2
    depths, owners, margins = np.full(len(pixels), np.inf), np.full(len(pixels), -1, np.int32), np.zeros(len(pixels))
    for row, (x, y) in enumerate(pixels):
        ray = T_world_cam[:3, :3] @ np.array([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, 1.0])
        with np.errstate(divide="ignore", invalid="ignore"):
            z = np.sum(normal * (corner - origin), axis=1) / (normal @ ray)
        hit = origin + z[:, None] * ray - corner
        a, b = np.sum(hit * edge_s, axis=1), np.sum(hit * edge_t, axis=1)
        s = (gram[2] * a - gram[1] * b) / determinant
        t = (gram[0] * b - gram[1] * a) / determinant
        inside = np.minimum(np.minimum(s, t), np.where(is_triangle, 1.0 - s - t, 1.0 - np.maximum(s, t)))
        with np.errstate(invalid="ignore"):
            possible = (normal @ ray < 0) & (z > 0.0)
            is_hit = possible & (inside >= 0)
        if is_hit.any():
            best = int(np.argmin(np.where(is_hit, z, np.inf)))
            depths[row], owners[row] = z[best], instance[best]
            rivals = possible & (z < z[best] + 1e-3)
            margins[row] = np.abs(inside[rivals]).min()
    return depths, owners, margins
