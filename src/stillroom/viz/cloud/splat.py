"""Discs on an image with a depth buffer: each point of a cloud as a disc in its tangent plane."""

from dataclasses import dataclass, field

import numpy as np

from stillroom.compiled import njit
from stillroom.data.dense_cloud import DenseCloud
from stillroom.geometry import se3
from stillroom.geometry.arrays import F32, I32
from stillroom.viz.cloud.view import Viewpoint

NEAR_M = 0.05
"""Points nearer to the eye than this are not drawn."""

MAX_RADIUS_PX = 96
"""No disc is drawn larger than this, so that a point near the viewpoint does not cover the picture."""

BEHIND = 2.0
"""Discs up to this many radii behind the nearest belong to the same surface and are blended with it."""

SOFTNESS = 2.0
"""A disc's weight falls to exp(−SOFTNESS) at its edge where neighbouring discs are blended."""


@dataclass(frozen=True)
class Splats:
    """A cloud as one view sees it; where it sees nothing, nearest is −1 and all else 0.

    Attributes:
        nearest: The point whose disc is nearest in each pixel (H, W) int32, −1 for none.
        depth_m: Depth of the surface (H, W) float32 [m].
        normals: Normals of the surface (H, W, 3) float32 [view frame], not of unit length.
        rgb: Its colours (H, W, 3) float32, 0 … 255.
    """

    nearest: I32 = field(repr=False)
    depth_m: F32 = field(repr=False)
    normals: F32 = field(repr=False)
    rgb: F32 = field(repr=False)


def splat(cloud: DenseCloud, view: Viewpoint, radius_m: float, two_sided: bool = False) -> Splats:
    """Draw a cloud's points as discs in their tangent planes (Zwicker et al., Surface splatting, 2001).

    A first pass finds the nearest disc in each pixel; a second blends the discs a little behind it, so that a
    surface is smooth and what it hides does not shine through.

    Args:
        cloud: The points; those without a normal (0, 0, 0) face the eye.
        view: From where.
        radius_m: Of the discs [m].
        two_sided: Whether discs are drawn that are seen from behind. They are not by default: a wall between the
            eye and the room is left out, as in a doll's house.
    """
    shown = view.shows(cloud.positions_m)
    T_view_world = se3.inverse(view.T_world_cam)
    points_m = se3.transform(T_view_world, cloud.positions_m[shown])
    normals = cloud.normals[shown].astype(np.float64) @ T_view_world[:3, :3].T
    unknown = np.einsum("ij,ij->i", normals, normals) < 0.25
    normals[unknown] = -points_m[unknown]
    facing = np.einsum("ij,ij->i", normals, points_m) < 0.0
    if two_sided:
        normals[~facing] *= -1.0
    drawn = (points_m[:, 2] > NEAR_M) & (facing | two_sided)
    indices = np.flatnonzero(shown)[drawn].astype(np.int32)
    points_m, normals = points_m[drawn], normals[drawn]
    c = view.camera
    depth_m = np.full((c.height, c.width), np.inf, dtype=np.float32)
    nearest = np.full((c.height, c.width), -1, dtype=np.int32)
    _nearest(points_m, normals, c.lens, radius_m, depth_m, nearest)
    total = np.zeros((c.height, c.width, 8), dtype=np.float32)
    _blend(points_m, normals, cloud.rgb[indices], c.lens, radius_m, (depth_m, nearest), total)
    total /= np.maximum(total[..., :1], 1e-12)
    # With no points at all there is nothing to look up; −1 stays −1 otherwise too.
    found = np.append(indices, np.int32(-1))[nearest]
    return Splats(found, total[..., 1].copy(), total[..., 2:5].copy(), total[..., 5:8].copy())


@njit(nogil=True, cache=True)
def _span_px(center_px, z_m, focal_px, radius_m, size_px):  # type: ignore[no-untyped-def]
    """Return the first and last pixel along one axis that a disc may cover; its middle is always among them."""
    reach = 0.5 + min(MAX_RADIUS_PX, focal_px * radius_m / max(z_m - radius_m, NEAR_M))
    return int(max(0.0, np.ceil(center_px - reach))), int(min(size_px - 1.0, np.floor(center_px + reach)))


@njit(nogil=True, cache=True, error_model="numpy")
def _nearest(points_m, normals, lens, radius_m, depth_m, nearest):  # type: ignore[no-untyped-def]
    """Fill the depth buffer (H, W), inf where empty, and the index of the disc that is nearest in each pixel.

    A ray (x, y, 1) meets the plane of the disc at p with normal n at the depth n·p / n·(x, y, 1).
    """
    height, width = depth_m.shape
    fx, fy, cx, cy = lens.fx, lens.fy, lens.cx, lens.cy
    for i in range(len(points_m)):
        px, py, pz = points_m[i]
        nx, ny, nz = normals[i]
        u, v = fx * px / pz + cx, fy * py / pz + cy
        x0, x1 = _span_px(u, pz, fx, radius_m, width)
        y0, y1 = _span_px(v, pz, fy, radius_m, height)
        offset = nx * px + ny * py + nz * pz
        for y in range(y0, y1 + 1):
            ray_y = (y - cy) / fy
            for x in range(x0, x1 + 1):
                ray_x = (x - cx) / fx
                z = offset / (nx * ray_x + ny * ray_y + nz)
                square = (z * ray_x - px) ** 2 + (z * ray_y - py) ** 2 + (z - pz) ** 2
                # Written so that a ray along the plane, whose depth is no number, misses.
                if square <= radius_m * radius_m and z < depth_m[y, x]:
                    depth_m[y, x] = z
                    nearest[y, x] = i
        # A disc smaller than a pixel, or seen on edge, still shows in the pixel of its middle.
        x, y = int(np.rint(u)), int(np.rint(v))
        if 0 <= x < width and 0 <= y < height and pz < depth_m[y, x]:
            depth_m[y, x] = pz
            nearest[y, x] = i


@njit(nogil=True, cache=True, error_model="numpy")
def _blend(points_m, normals, rgb, lens, radius_m, front, total):  # type: ignore[no-untyped-def]
    """Add weight, depth, normal and colour of all discs that lie near the front, from `_nearest`, to sums (H, W, 8)."""
    depth_m, nearest = front
    height, width = depth_m.shape
    fx, fy, cx, cy = lens.fx, lens.fy, lens.cx, lens.cy
    for i in range(len(points_m)):
        px, py, pz = points_m[i]
        nx, ny, nz = normals[i]
        x0, x1 = _span_px(fx * px / pz + cx, pz, fx, radius_m, width)
        y0, y1 = _span_px(fy * py / pz + cy, pz, fy, radius_m, height)
        offset = nx * px + ny * py + nz * pz
        for y in range(y0, y1 + 1):
            ray_y = (y - cy) / fy
            for x in range(x0, x1 + 1):
                if pz - radius_m > depth_m[y, x] + BEHIND * radius_m:
                    continue
                ray_x = (x - cx) / fx
                z = offset / (nx * ray_x + ny * ray_y + nz)
                square = (z * ray_x - px) ** 2 + (z * ray_y - py) ** 2 + (z - pz) ** 2
                inside = square <= radius_m * radius_m
                if (inside and z <= depth_m[y, x] + BEHIND * radius_m) or nearest[y, x] == i:
                    if not inside:
                        z, square = pz, radius_m * radius_m
                    weight = np.exp(-SOFTNESS * square / (radius_m * radius_m))
                    total[y, x, 0] += weight
                    total[y, x, 1] += weight * z
                    for k in range(3):
                        total[y, x, 2 + k] += weight * normals[i, k]
                        total[y, x, 5 + k] += weight * rgb[i, k]
