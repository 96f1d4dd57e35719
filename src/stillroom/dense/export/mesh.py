"""A triangle mesh of the dense map: marching cubes through the signed distance of its points."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stillroom.data.cloud.dense_cloud import DenseCloud
from stillroom.dense.export.ply import VERTEX, filled, write_mesh_ply
from stillroom.dense.export.signed_distance import (
    BLOCK,
    DISTANCE,
    NORMAL,
    RGB,
    WEIGHT,
    Block,
    blocks,
    corner_position_m,
)
from stillroom.errors import MapError, MissingExtraError
from stillroom.geometry.arrays import F32, F64, I64, U8, Bool, Floats

LEAST_AGREEMENT = 0.2
"""Least cosine between a triangle's normal and that of the points near it; at the corners of a box it is 0.58."""

SLIVER = 1e-4
"""Twice the area of a triangle [square cells] that is too small to tell which way it faces."""


@dataclass(frozen=True)
class MeshConfig:
    """How a mesh is made.

    Attributes:
        cell_voxels: Edge of the cells that triangles are made in, in voxels of the cloud. More is coarser, and closes
            larger holes.
        min_points: Surfaces lie in the 3×3×3 cells around points, and no further from them; but only around points
            that have so many in the 5×5×5 cells around: a lone one makes no surface.
        max_weight: A point counts by the pixels that it is the mean of, up to here.
    """

    cell_voxels: float = 1.0
    min_points: int = 4
    max_weight: float = 8.0

    def build(self) -> "Mesher":
        """Return what makes meshes so."""
        return Mesher(self)


@dataclass(frozen=True)
class Mesh:
    """Triangles with colours.

    Attributes:
        positions_m: Of the vertices (N, 3) float32 [m, world].
        normals: Unit normals of the vertices (N, 3) float32 [world]; zero where the points near disagree.
        rgb: Colours of the vertices (N, 3) uint8.
        triangles: Vertex numbers (M, 3), counter-clockwise as seen from the side of the normals.
    """

    positions_m: F32
    normals: F32
    rgb: U8
    triangles: I64

    def write_ply(self, path: Path) -> None:
        """Write it.

        Raises:
            StillroomError: It cannot be written.
        """
        write_mesh_ply(filled(VERTEX, self.positions_m, self.normals, self.rgb), self.triangles, path)


class Mesher:
    """Makes meshes of clouds, block by block: beside the mesh itself, memory does not grow with the map."""

    def __init__(self, config: MeshConfig) -> None:
        self._config = config

    def __call__(self, cloud: DenseCloud) -> Mesh:
        """Return the surface that the points are samples of.

        Raises:
            MissingExtraError: scikit-image is not installed.
            MapError: The points are too sparse for a single triangle.
        """
        marching_cubes = _marching_cubes()
        cell_m = cloud.voxel_m * self._config.cell_voxels
        parts = []
        n_before = 0
        for block in blocks(cloud, cell_m, self._config.max_weight, self._config.min_points):
            part = self._surface(block, marching_cubes)
            if part is not None:
                corners, sums, triangles = part
                parts.append((corners + block.first_cell, _on_border(corners), sums, triangles + n_before))
                n_before += len(corners)
        if not any(len(triangles) for *_, triangles in parts):
            raise MapError(f"the dense map's {len(cloud)} points are too sparse for a mesh of {cell_m:g} m cells")
        corners, on_border, sums, triangles = (np.concatenate(column) for column in zip(*parts, strict=True))
        return _assembled(corners, sums, _sewn(corners, on_border)[triangles], cell_m)

    def _surface(self, block: Block, marching_cubes: Any) -> tuple[F64, F32, I64] | None:
        """Return a block's vertices (N, 3) [cells, from its first], their sums (N, 8) and its triangles (M, 3)."""
        weight = block.sums[..., WEIGHT]
        distance = np.asarray(block.sums[..., DISTANCE] / np.where(weight > 0, weight, 1), dtype=np.float32)
        cuts = _is_cut(distance) & block.is_sampled
        if not cuts.any():
            return None
        mask = np.zeros(distance.shape, dtype=bool)
        mask[1:, 1:, 1:] = cuts  # The library's mask tells of a cell at its highest corner.
        corners, triangles, _, _ = marching_cubes(distance, 0.0, gradient_direction="descent", mask=mask)
        sums = _interpolated(block.sums, corners)
        kept = _agrees(corners, triangles, sums[:, NORMAL] / sums[:, WEIGHT, None])
        return corners.astype(np.float64), sums, triangles[kept].astype(np.int64)


def _marching_cubes() -> Any:
    try:
        from skimage.measure import marching_cubes
    except ImportError:
        raise MissingExtraError("scikit-image", "mesh") from None
    return marching_cubes


def _is_cut(distance: F32) -> Bool:
    """Tell which cells (S−1, S−1, S−1) have corners (S, S, S) on both sides."""
    front = distance > 0
    some, every = front, front
    for axis in range(3):
        low = tuple(slice(None, -1) if k == axis else slice(None) for k in range(3))
        high = tuple(slice(1, None) if k == axis else slice(None) for k in range(3))
        some, every = some[low] | some[high], every[low] & every[high]
    return some & ~every


def _interpolated(sums: F32, corners: F32) -> F32:
    """Return the sums (N, 8) at vertices (N, 3), which lie on the edges of cells."""
    low = np.floor(corners).astype(np.int64)
    high = np.ceil(corners).astype(np.int64)
    share = (corners - low).max(axis=1, keepdims=True)
    between: F32 = (1 - share) * sums[tuple(low.T)] + share * sums[tuple(high.T)]
    return between


def _agrees(corners: F32, triangles: NDArray[Any], normals: Floats) -> Bool:
    """Tell which triangles (M,) face the way that the points near them do.

    The distance changes its sign at the surface, and also halfway between two surfaces that lie behind each other.
    Slivers, which face nowhere in particular, agree: without them the mesh would have slits.
    """
    a, b, c = (corners[triangles[:, k]] for k in range(3))
    across = np.cross(b - a, c - a)
    near = normals[triangles].sum(axis=1)
    facing = np.einsum("ij,ij->i", across, near)
    size = np.linalg.norm(across, axis=1)
    return np.asarray((size < SLIVER) | (facing >= LEAST_AGREEMENT * size * np.linalg.norm(near, axis=1)), dtype=bool)


def _on_border(corners: F64) -> Bool:
    """Tell which vertices (N,) lie on the faces of their block."""
    return np.asarray(((corners == 0) | (corners == BLOCK)).any(axis=1), dtype=bool)


def _sewn(corners: F64, on_border: Bool) -> I64:
    """Return for each vertex (N,) the first one at the same place: blocks meet in vertices that each of them has."""
    number = np.arange(len(corners))
    border = np.flatnonzero(on_border)
    _, first, group = np.unique(corners[border], axis=0, return_index=True, return_inverse=True)
    number[border] = border[first[group.ravel()]]
    return number


def _assembled(corners: F64, sums: F32, triangles: I64, cell_m: float) -> Mesh:
    """Return the mesh of the vertices that triangles use."""
    a, b, c = triangles.T
    triangles = triangles[(a != b) & (b != c) & (c != a)]
    is_used = np.zeros(len(corners), dtype=bool)
    is_used[triangles] = True
    used = np.flatnonzero(is_used)
    renumbered = np.cumsum(is_used) - 1
    normals = sums[used, NORMAL]
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    rgb = np.rint(sums[used, RGB] / sums[used, WEIGHT][:, None])
    return Mesh(
        corner_position_m(corners[used], cell_m).astype(np.float32),
        np.asarray(normals / np.where(length > 0, length, 1), dtype=np.float32),
        np.clip(rgb, 0, 255).astype(np.uint8),
        renumbered[triangles],
    )
