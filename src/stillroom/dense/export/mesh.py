"""A triangle mesh of the dense map: marching cubes through the signed distance of its points."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stillroom.data.dense_cloud import DenseCloud
from stillroom.data.ply import VERTEX, filled, write_ply
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
from stillroom.geometry.arrays import F32, F64, I32, I64, U8, Bool, Floats

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
        min_points: Surfaces lie in the 3×3×3 cells around points, and no further from them; but only around points with
            at least this many in the 5×5×5 cells around: an isolated one makes no surface.
        max_weight: A point is weighted by its number of pixels, up to here.
    """

    cell_voxels: float = 1.0
    min_points: int = 4
    max_weight: float = 8.0

    def build(self) -> "Mesher":
        """Return the mesher."""
        return Mesher(self)


@dataclass(frozen=True)
class Mesh:
    """Triangles with colours.

    Attributes:
        positions_m: Of the vertices (N, 3) float32 [m, world].
        normals: Unit normals of the vertices (N, 3) float32 [world]; zero where the points near disagree.
        rgb: Colours of the vertices (N, 3) uint8.
        triangles: Vertex numbers (M, 3) int32, counter-clockwise as seen from the side of the normals.
    """

    positions_m: F32
    normals: F32
    rgb: U8
    triangles: I32

    def write_ply(self, path: Path) -> None:
        """Write it.

        Raises:
            StillroomError: It cannot be written.
        """
        write_ply(filled(VERTEX, self.positions_m, self.normals, self.rgb), path, self.triangles)


class Mesher:
    """Makes meshes of clouds, block by block: apart from the mesh itself, memory does not grow with the map."""

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
        for block in blocks(cloud, cell_m, self._config.max_weight, self._config.min_points):
            part = _surface(block, cell_m, marching_cubes)
            if part is not None:
                parts.append(part)
        if not parts:
            raise MapError(f"the dense map's {len(cloud)} points are too sparse for a mesh of {cell_m:g} m cells")
        return _joined(parts)


@dataclass(frozen=True)
class _Part:
    """The mesh of a block, and which of its vertices lie on the block's faces: their numbers (K,) and places (K, 3)."""

    mesh: Mesh
    border: I64
    border_corners: F64


def _marching_cubes() -> Any:
    try:
        from skimage.measure import marching_cubes
    except ImportError:
        raise MissingExtraError("scikit-image", "mesh") from None
    return marching_cubes


def _surface(block: Block, cell_m: float, marching_cubes: Any) -> _Part | None:
    """Return the mesh of a block, if there is a surface in it."""
    weight = block.sums[..., WEIGHT]
    distance = np.asarray(block.sums[..., DISTANCE] / np.where(weight > 0, weight, 1), dtype=np.float32)
    cuts = _is_cut(distance) & block.is_sampled
    if not cuts.any():
        return None
    mask = np.zeros(distance.shape, dtype=bool)
    mask[1:, 1:, 1:] = cuts  # The library's mask has each cell at its highest corner.
    corners, triangles, _, _ = marching_cubes(distance, 0.0, gradient_direction="descent", mask=mask)
    sums = _interpolated(block.sums, corners)
    kept = _agrees(corners, triangles, sums[:, NORMAL] / sums[:, WEIGHT, None])
    if not kept.any():
        return None
    in_grid = corners.astype(np.float64) + block.first_cell
    length = np.linalg.norm(sums[:, NORMAL], axis=1, keepdims=True)
    mesh = Mesh(
        corner_position_m(in_grid, cell_m).astype(np.float32),
        np.asarray(sums[:, NORMAL] / np.where(length > 0, length, 1), dtype=np.float32),
        np.clip(np.rint(sums[:, RGB] / sums[:, WEIGHT, None]), 0, 255).astype(np.uint8),
        triangles[kept].astype(np.int32),
    )
    border = np.flatnonzero(((corners == 0) | (corners == BLOCK)).any(axis=1))
    return _Part(mesh, border, in_grid[border])


def _is_cut(distance: F32) -> Bool:
    """Return which cells (S−1, S−1, S−1) have corners (S, S, S) on both sides."""
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
    """Return which triangles (M,) face the same way as the normals of the points near them.

    The distance changes its sign at the surface, and also halfway between two surfaces that lie behind each other.
    Slivers, whose normals are undefined, agree: without them the mesh would have slits.
    """
    a, b, c = (corners[triangles[:, k]] for k in range(3))
    across = np.cross(b - a, c - a)
    near = normals[triangles].sum(axis=1)
    facing = np.einsum("ij,ij->i", across, near)
    size = np.linalg.norm(across, axis=1)
    return np.asarray((size < SLIVER) | (facing >= LEAST_AGREEMENT * size * np.linalg.norm(near, axis=1)), dtype=bool)


def _joined(parts: list[_Part]) -> Mesh:
    """Return one mesh: blocks meet in vertices that each of them has, at the very same places."""
    starts = np.cumsum([0, *(len(part.mesh.positions_m) for part in parts)])
    number = np.arange(starts[-1], dtype=np.int32)
    border = np.concatenate([part.border + start for part, start in zip(parts, starts[:-1], strict=True)])
    places = np.concatenate([part.border_corners for part in parts])
    _, first, group = np.unique(places, axis=0, return_index=True, return_inverse=True)
    number[border] = border[first[group.ravel()]]
    triangles = np.concatenate(
        [number[part.mesh.triangles + start] for part, start in zip(parts, starts, strict=False)]
    )
    a, b, c = triangles.T
    triangles = triangles[(a != b) & (b != c) & (c != a)]
    is_used = np.zeros(len(number), dtype=bool)
    is_used[triangles] = True
    renumbered = np.cumsum(is_used, dtype=np.int32) - 1

    def column(name: str) -> NDArray[Any]:
        return np.concatenate([getattr(part.mesh, name) for part in parts])[is_used]

    return Mesh(column("positions_m"), column("normals"), column("rgb"), renumbered[triangles])
