"""Surfaces gathered from depth images: at most one point in each cell of a grid."""

from dataclasses import dataclass

import numpy as np

from stillroom.geometry import se3
from stillroom.geometry.arrays import F32, F64, I64, Bool, Floats
from stillroom.geometry.camera import Camera

BITS = 21
"""Of each coordinate of a cell in its key."""
MERGE_ABOVE = 4_000_000


class Gatherer:
    """Collects what depth images see, as the mean position in each cell of a grid.

    Knows also in how many images each cell was seen, which tells a surface from a stray pixel.
    """

    def __init__(self, camera: Camera, voxel_m: float = 0.02, stride: int = 2) -> None:
        """Start empty.

        Args:
            camera: The images' calibration.
            voxel_m: Edge of the cells [m].
            stride: 2 takes every second pixel of every second row.
        """
        self._voxel_m, self._stride = voxel_m, stride
        rows, columns = np.mgrid[0 : camera.height : stride, 0 : camera.width : stride]
        px = camera.undistort(np.stack((columns.ravel(), rows.ravel()), axis=1).astype(np.float32))
        self._rays = camera.back_project(px, np.ones(len(px)))
        self._pending = [_summed(np.zeros((0, 3), dtype=np.int64), np.zeros((0, 3)))]

    def add(self, depth_m: F32, T_world_cam: F64, keep: Bool | None = None, reach_m: float = np.inf) -> None:
        """Take an image's surface.

        Args:
            depth_m: Depth (H, W) [m]; 0 where unknown.
            T_world_cam: Its pose (4, 4).
            keep: Which pixels (H, W) to take; all where not given.
            reach_m: Depths beyond are left out [m].
        """
        small_m = depth_m[:: self._stride, :: self._stride]
        taken = (small_m > 0) & (small_m <= reach_m)
        if keep is not None:
            taken &= keep[:: self._stride, :: self._stride]
        points_cam = self._rays[taken.ravel()] * small_m[taken].astype(np.float64)[:, None]
        points = se3.transform(T_world_cam, points_cam)
        self._pending.append(_summed(np.floor(points / self._voxel_m).astype(np.int64), points))
        if sum(len(cells.key) for cells in self._pending[1:]) > MERGE_ABOVE:
            self._pending = [_merged(self._pending)]

    def points(self, seen_by: int = 1) -> F64:
        """Return the mean positions (N, 3) [m, world] in the cells that at least so many images saw."""
        self._pending = [cells := _merged(self._pending)]
        chosen = cells.n_images >= seen_by
        return np.asarray(cells.total_m[chosen] / cells.n_points[chosen, None])


def thinned(points_m: Floats, voxel_m: float) -> F64:
    """Return the means (M, 3) of the points (N, 3) in each cell of a grid."""
    cells = _summed(np.floor(points_m / voxel_m).astype(np.int64), points_m)
    return np.asarray(cells.total_m / cells.n_points[:, None])


@dataclass(frozen=True)
class _Cells:
    """Cells by rising key (N,): sums of the points in them (N, 3), and numbers of those and of their images (N,)."""

    key: I64
    total_m: F64
    n_points: I64
    n_images: I64


def _summed(cell: I64, points: Floats) -> _Cells:
    """Sum up the points (N, 3) of one image by their cells (N, 3)."""
    half = 1 << (BITS - 1)
    x, y, z = (np.clip(cell, -half, half - 1) + half).T
    ones = np.ones(len(cell), dtype=np.int64)
    cells = _grouped(x << 2 * BITS | y << BITS | z, points, ones, ones)
    return _Cells(cells.key, cells.total_m, cells.n_points, np.ones_like(cells.n_points))


def _merged(parts: list[_Cells]) -> _Cells:
    return _grouped(
        np.concatenate([part.key for part in parts]),
        np.concatenate([part.total_m for part in parts]),
        np.concatenate([part.n_points for part in parts]),
        np.concatenate([part.n_images for part in parts]),
    )


def _grouped(key: I64, total_m: Floats, n_points: I64, n_images: I64) -> _Cells:
    order = np.argsort(key, kind="stable")
    ordered = key[order]
    first = np.flatnonzero(np.diff(ordered, prepend=-1))  # keys are not negative
    if len(first) == 0:
        return _Cells(key, np.asarray(total_m, dtype=np.float64), n_points, n_images)
    return _Cells(
        ordered[first],
        np.add.reduceat(np.asarray(total_m, dtype=np.float64)[order], first, axis=0),
        np.add.reduceat(n_points[order], first),
        np.add.reduceat(n_images[order], first),
    )
