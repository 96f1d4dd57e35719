"""Clouds of simple things: rectangles, cubes, and a room."""

from collections.abc import Iterable
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from stillroom.data.dense_cloud import DenseCloud
from stillroom.geometry.arrays import F64

Color: TypeAlias = tuple[int, int, int]
Sheet: TypeAlias = tuple[F64, F64, F64]

VOXEL_M = 0.05
FLOOR, WALL, CEILING, CRATE = (90, 160, 90), (200, 190, 120), (250, 20, 250), (220, 60, 40)


def sheet(origin: ArrayLike, along: ArrayLike, across: ArrayLike, normal: ArrayLike, rgb: Color) -> Sheet:
    """Return points every voxel of a rectangle: positions, normals and colours."""
    edges = [np.asarray(edge, float) for edge in (along, across)]
    steps = [np.arange(0.0, np.linalg.norm(edge) + 1e-9, VOXEL_M) / np.linalg.norm(edge) for edge in edges]
    s, t = (grid.ravel() for grid in np.meshgrid(*steps))
    positions_m = np.asarray(origin, float) + s[:, None] * edges[0] + t[:, None] * edges[1]
    return positions_m, np.tile(np.asarray(normal, float), (len(s), 1)), np.tile(np.asarray(rgb, float), (len(s), 1))


def cube(center: ArrayLike, edge_m: float, rgb: Color) -> list[Sheet]:
    """Return the six faces of a cube, axis-parallel."""
    faces = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            normal = np.eye(3)[axis] * sign
            along, across = (np.eye(3)[(axis + k) % 3] * edge_m for k in (1, 2))
            origin = np.asarray(center) + normal * edge_m / 2 - (along + across) / 2
            faces.append(sheet(origin, along, across, normal, rgb))
    return faces


def assemble(sheets: Iterable[Sheet]) -> DenseCloud:
    """Return one cloud of them all."""
    positions_m, normals, rgb = (np.concatenate(parts) for parts in zip(*sheets, strict=True))
    weight = np.ones(len(positions_m), np.float32)
    return DenseCloud(positions_m.astype(np.float32), normals.astype(np.float32), rgb.astype(np.uint8), weight, VOXEL_M)


def select(cloud: DenseCloud, kept: np.ndarray) -> DenseCloud:
    """Return some of a cloud's points."""
    parts = (values[kept] for values in (cloud.positions_m, cloud.normals, cloud.rgb, cloud.weight))
    return DenseCloud(*parts, cloud.voxel_m)


EMPTY = select(assemble(cube((0, 0, 0), 0.1, CRATE)), np.zeros(0, np.int64))
"""No points."""
