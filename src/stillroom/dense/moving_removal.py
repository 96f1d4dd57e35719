"""Removal of what moves from what was fused before (OC-SLAM 2.6): voxels near moving points, found by Kd-tree."""

import numpy as np
from scipy.spatial import cKDTree

from stillroom.geometry.arrays import F64, Bool, Floats


def near_moving(moving_world_m: F64, candidates_world_m: Floats, radius_m: float) -> Bool:
    """Tell which candidates (N, 3) lie within a radius of moving points (M, 3) [m, world], (N,)."""
    near = np.zeros(len(candidates_world_m), dtype=np.bool_)
    if len(moving_world_m) == 0 or len(candidates_world_m) == 0:
        return near
    lower, upper = moving_world_m.min(axis=0) - radius_m, moving_world_m.max(axis=0) + radius_m
    inside = np.flatnonzero(_inside(candidates_world_m, lower, upper))
    if len(inside) == 0:
        return near
    tree = cKDTree(moving_world_m, balanced_tree=False, compact_nodes=False)
    distance_m, _ = tree.query(candidates_world_m[inside], distance_upper_bound=radius_m)
    near[inside] = np.isfinite(distance_m)
    return near


def _inside(points_m: Floats, lower_m: F64, upper_m: F64) -> Bool:
    """Tell which points (N, 3) lie in a box, axis by axis: numpy is slow along short ones."""
    inside = np.ones(len(points_m), dtype=np.bool_)
    for axis in range(3):
        inside &= (points_m[:, axis] >= lower_m[axis]) & (points_m[:, axis] <= upper_m[axis])
    return inside
