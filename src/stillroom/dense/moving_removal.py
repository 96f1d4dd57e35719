"""Removal of what moves from what was fused before (OC-SLAM 2.6): voxels near moving points, found by Kd-tree."""

import numpy as np
from numba import njit
from scipy.spatial import cKDTree

from stillroom.geometry.arrays import F32, F64, U8, Bool, Floats

MOST_CELLS = 1 << 21


class MovingPoints:
    """Points of what moves, asked what lies near them."""

    def __init__(self, points_world_m: F64) -> None:
        """Take the points (M, 3) [m, world]."""
        self._points_m = points_world_m
        self._tree = cKDTree(points_world_m, balanced_tree=False, compact_nodes=False) if len(points_world_m) else None

    def near(self, candidates_world_m: Floats, radius_m: float) -> Bool:
        """Return which candidates (N, 3) lie within a radius of the points, (N,)."""
        near = np.zeros(len(candidates_world_m), dtype=np.bool_)
        if self._tree is None or len(candidates_world_m) == 0:
            return near
        lower, upper = self._box(radius_m)
        inside = np.flatnonzero(_inside(candidates_world_m, lower, upper))
        if len(inside) == 0:
            return near
        distance_m, _ = self._tree.query(candidates_world_m[inside], distance_upper_bound=radius_m)
        near[inside] = np.isfinite(distance_m)
        return near

    def perhaps_near(self, candidates_world_m: F32, radius_m: float) -> Bool:
        """Return which candidates (N, 3) may lie within a radius, (N,): all that do, and some a little farther off.

        A look at a grid of cells is a tenth of a question to the tree.
        """
        if self._tree is None:
            return np.zeros(len(candidates_world_m), dtype=np.bool_)
        lower, upper = self._box(radius_m)
        edge_m = max(radius_m, float(np.prod(upper - lower) / MOST_CELLS) ** (1 / 3))
        marked = np.zeros(tuple(((upper - lower) / edge_m).astype(np.int64) + 1), dtype=np.uint8)
        mark_cells(self._points_m, lower, edge_m, marked)
        near: Bool = in_marked_cells(candidates_world_m, lower, edge_m, marked)
        return near

    def _box(self, margin_m: float) -> tuple[F64, F64]:
        return self._points_m.min(axis=0) - margin_m, self._points_m.max(axis=0) + margin_m


def _inside(points_m: Floats, lower_m: F64, upper_m: F64) -> Bool:
    """Return which points (N, 3) lie in a box, axis by axis: numpy is slow along short ones."""
    inside = np.ones(len(points_m), dtype=np.bool_)
    for axis in range(3):
        inside &= (points_m[:, axis] >= lower_m[axis]) & (points_m[:, axis] <= upper_m[axis])
    return inside


@njit(nogil=True, cache=True)
def mark_cells(points_m: F64, lower_m: F64, edge_m: float, marked: U8) -> None:
    """Set the cells (A, B, C) that points (M, 3) lie in, and those around them; all points lie in the grid."""
    for n in range(len(points_m)):
        i = int((points_m[n, 0] - lower_m[0]) / edge_m)
        j = int((points_m[n, 1] - lower_m[1]) / edge_m)
        k = int((points_m[n, 2] - lower_m[2]) / edge_m)
        for a in range(max(0, i - 1), min(marked.shape[0], i + 2)):
            for b in range(max(0, j - 1), min(marked.shape[1], j + 2)):
                for c in range(max(0, k - 1), min(marked.shape[2], k + 2)):
                    marked[a, b, c] = 1


@njit(nogil=True, cache=True)
def in_marked_cells(points_m: F32, lower_m: F64, edge_m: float, marked: U8) -> Bool:
    """Return which points (N, 3) lie in marked cells (A, B, C), (N,); outside the grid nothing is marked."""
    found = np.zeros(len(points_m), dtype=np.bool_)
    for n in range(len(points_m)):
        x = (points_m[n, 0] - lower_m[0]) / edge_m
        y = (points_m[n, 1] - lower_m[1]) / edge_m
        z = (points_m[n, 2] - lower_m[2]) / edge_m
        if 0.0 <= x < marked.shape[0] and 0.0 <= y < marked.shape[1] and 0.0 <= z < marked.shape[2]:
            found[n] = marked[int(x), int(y), int(z)] == 1
    return found
