"""Removal of what moves from what was fused before (OC-SLAM 2.6): voxels near moving points, found by Kd-tree."""

import numpy as np
from scipy.spatial import cKDTree

from stillroom.geometry.arrays import F64, I64, Bool, Floats

THINNING_M = 0.02
"""Moving points are thinned to one in a cube of this size: the radius is larger."""


def near_moving(moving_world_m: F64, candidates_world_m: Floats, radius_m: float) -> Bool:
    """Tell which candidates (N, 3) lie within a radius of moving points (M, 3) [m, world], (N,)."""
    near = np.zeros(len(candidates_world_m), dtype=np.bool_)
    if len(moving_world_m) == 0 or len(candidates_world_m) == 0:
        return near
    lower, upper = moving_world_m.min(axis=0) - radius_m, moving_world_m.max(axis=0) + radius_m
    inside = np.flatnonzero(np.all((candidates_world_m >= lower) & (candidates_world_m <= upper), axis=1))
    if len(inside) == 0:
        return near
    tree = cKDTree(thinned(moving_world_m), balanced_tree=False, compact_nodes=False)
    distance_m, _ = tree.query(candidates_world_m[inside], distance_upper_bound=radius_m)
    near[inside] = np.isfinite(distance_m)
    return near


def thinned(points_m: F64) -> F64:
    """Return the first of the points (N, 3) in each cube of `THINNING_M`."""
    cubes: I64 = np.floor(points_m / THINNING_M).astype(np.int64)
    cubes -= cubes.min(axis=0)
    size = cubes.max(axis=0) + 1
    flat = (cubes[:, 0] * size[1] + cubes[:, 1]) * size[2] + cubes[:, 2]
    _, first = np.unique(flat, return_index=True)
    return points_m[np.sort(first)]
