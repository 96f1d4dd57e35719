"""Ghosts in maps of rendered sequences, whose surfaces are known exactly."""

from dataclasses import dataclass, field

import numpy as np

from stillroom.compiled import njit
from stillroom.evaluation.ghosts import GhostFigure, SurfaceFigure, distances_m
from stillroom.evaluation.trajectory_errors import Statistics
from stillroom.geometry.arrays import F64, Bool, Floats

# Exact distances to surfaces that are made of parallelograms and triangles.


def distances_to_patches_m(points_m: Floats, patches_m: F64, is_triangle: Bool) -> F64:
    """Return the distance (N,) [m] of points (N, 3) to the nearest patch; infinite where there are no patches.

    Args:
        points_m: The points [m].
        patches_m: Corner c and edges a, b (Q, 9) [m]: a patch is all c + s·a + t·b with s, t ≥ 0, and s, t ≤ 1 in a
            parallelogram, s + t ≤ 1 in a triangle.
        is_triangle: Which are triangles (Q,).
    """
    squared = np.full(len(points_m), np.inf)
    points = np.ascontiguousarray(points_m, dtype=np.float64)
    patches = np.ascontiguousarray(patches_m, dtype=np.float64)
    _nearest(points, patches, np.ascontiguousarray(is_triangle, dtype=np.bool_), squared)
    return np.asarray(np.sqrt(squared))


@njit(nogil=True, cache=True)
def _nearest(points_m: F64, patches_m: F64, is_triangle: Bool, squared: F64) -> None:
    """Lower `squared` (N,) [m²] to the squared distance to the nearest patch."""
    for q in range(len(patches_m)):
        cx, cy, cz, ax, ay, az, bx, by, bz = patches_m[q]
        aa, bb, ab = ax * ax + ay * ay + az * az, bx * bx + by * by + bz * bz, ax * bx + ay * by + az * bz
        area2 = aa * bb - ab * ab
        if not area2 > 0.0:
            continue
        # The patch lies in the ball about its middle that its corners span: most points are too far from it.
        mx, my, mz = cx + 0.5 * (ax + bx), cy + 0.5 * (ay + by), cz + 0.5 * (az + bz)
        radius2 = 0.25 * (aa + bb + 2.0 * abs(ab))
        for i in range(len(points_m)):
            x, y, z = points_m[i, 0] - mx, points_m[i, 1] - my, points_m[i, 2] - mz
            # (r + d)² ≤ 2 (r² + d²) spares the roots.
            if x * x + y * y + z * z > 2.0 * (radius2 + squared[i]):
                continue
            x, y, z = points_m[i, 0] - cx, points_m[i, 1] - cy, points_m[i, 2] - cz
            pp, pa, pb = x * x + y * y + z * z, x * ax + y * ay + z * az, x * bx + y * by + z * bz
            products = pp, pa, pb, aa, bb, ab
            s, t = (pa * bb - pb * ab) / area2, (pb * aa - pa * ab) / area2
            to_plane = _squared(products, s, t)
            if to_plane >= squared[i]:
                continue
            is_inside = s >= 0.0 and t >= 0.0 and (s + t <= 1.0 if is_triangle[q] else max(s, t) <= 1.0)
            nearest = to_plane if is_inside else _to_edges(products, is_triangle[q])
            squared[i] = min(squared[i], max(0.0, nearest))


@njit(nogil=True, cache=True)
def _squared(products: tuple[float, ...], s: float, t: float) -> float:
    """Return |p − s·a − t·b|² from the products p·p, p·a, p·b, a·a, b·b and a·b."""
    pp, pa, pb, aa, bb, ab = products
    return pp - 2.0 * (s * pa + t * pb) + s * s * aa + 2.0 * s * t * ab + t * t * bb


@njit(nogil=True, cache=True)
def _to_edges(products: tuple[float, ...], is_triangle: bool) -> float:
    """Return the squared distance of p to the nearest edge of the patch; products as of `_squared`."""
    _, pa, pb, aa, bb, ab = products
    s, t = min(1.0, max(0.0, pa / aa)), min(1.0, max(0.0, pb / bb))
    nearest = min(_squared(products, s, 0.0), _squared(products, 0.0, t))
    if is_triangle:
        k = min(1.0, max(0.0, (pb - pa + aa - ab) / (aa + bb - 2.0 * ab)))
        return float(min(nearest, _squared(products, 1.0 - k, k)))
    s, t = min(1.0, max(0.0, (pa - ab) / aa)), min(1.0, max(0.0, (pb - ab) / bb))
    far = min(_squared(products, s, 1.0), _squared(products, 1.0, t))
    return float(min(nearest, far))


@dataclass(frozen=True)
class TrueScene:
    """The ground truth of a rendered scene, in the renderer's world frame.

    Attributes:
        patches_m: The static surface, exactly: corner and two edges of parallelograms and triangles (Q, 9) [m].
        is_triangle: Which of them are triangles (Q,).
        seen_m: The part of it that the camera saw, sampled evenly (M, 3) [m].
        movers_m: Where the camera saw figures, and things before and while they were moved, sampled (L, 3) [m].
    """

    patches_m: F64 = field(repr=False)
    is_triangle: Bool = field(repr=False)
    seen_m: F64 = field(repr=False)
    movers_m: F64 = field(repr=False)


@dataclass(frozen=True)
class GhostTruthConfig:
    """When a point is a ghost.

    Attributes:
        off_m: It lies further than this from the static surface [m] …
        near_mover_m: … and no further than this from where a mover was seen [m]: noise of the depth, and the steps
            of a mover from image to image.
    """

    off_m: float = 0.05
    near_mover_m: float = 0.10


def ghosts_by_truth(
    points_m: Floats, scene: TrueScene, config: GhostTruthConfig | None = None
) -> tuple[GhostFigure, SurfaceFigure]:
    """Find the points of a map that are off the static surface where a mover was, and the surface error of the others.

    Args:
        points_m: The map (N, 3) [m], in the renderer's world.
        scene: The true scene.
        config: When a point is a ghost.
    """
    config = config or GhostTruthConfig()
    error_m = distances_to_patches_m(points_m, scene.patches_m, scene.is_triangle)
    is_off = error_m > config.off_m
    is_ghost = np.zeros(len(points_m), dtype=np.bool_)
    near_m = distances_m(np.asarray(points_m)[is_off], scene.movers_m, config.near_mover_m)
    is_ghost[is_off] = near_m <= config.near_mover_m
    rest_m = error_m[~is_ghost]
    surface = SurfaceFigure(Statistics.of(rest_m) if len(rest_m) else None, int((is_off & ~is_ghost).sum()))
    return GhostFigure.of(is_ghost, int(is_off.sum())), surface
