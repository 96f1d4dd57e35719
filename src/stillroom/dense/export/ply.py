"""PLY, the format that every viewer opens: points and triangles, binary, little-endian."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stillroom.data.clouds import DenseCloud
from stillroom.dense.export.replacing import replacing
from stillroom.geometry.arrays import Floats, Ints

NAMES = {"<f4": "float", "<i4": "int", "|u1": "uchar"}
VERTEX = np.dtype(
    [(name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz")] + [(name, "|u1") for name in ("red", "green", "blue")]
)
POINT = np.dtype([*((name, VERTEX[name].str) for name in VERTEX.names or ()), ("weight", "<f4")])
FACE = np.dtype([("n", "|u1"), ("vertices", "<i4", (3,))])
WORLD = "metres, in the frame of the first camera: x right, y down, z forward"


def write_point_ply(cloud: DenseCloud, path: Path) -> None:
    """Write a cloud as points with normals, colours and weights (`float weight`).

    Raises:
        StillroomError: It cannot be written.
    """
    points = filled(POINT, cloud.positions_m, cloud.normals, cloud.rgb)
    points["weight"] = cloud.weight
    _write(path, points, None)


def write_mesh_ply(vertices: NDArray[Any], triangles: Ints, path: Path) -> None:
    """Write a mesh.

    Args:
        vertices: Structured array (N,) of `VERTEX`.
        triangles: Vertex numbers (M, 3), counter-clockwise as seen from the side of the normals.
        path: Where to.

    Raises:
        StillroomError: It cannot be written.
    """
    faces = np.empty(len(triangles), dtype=FACE)
    faces["n"] = 3
    faces["vertices"] = triangles
    _write(path, vertices, faces)


def filled(kind: np.dtype[Any], positions_m: Floats, normals: Floats, rgb: NDArray[np.uint8]) -> NDArray[Any]:
    """Return a structured array (N,) with positions, normals and colours (N, 3) in their fields."""
    points = np.zeros(len(positions_m), dtype=kind)
    for axis in range(3):
        points["xyz"[axis]] = positions_m[:, axis]
        points[("nx", "ny", "nz")[axis]] = normals[:, axis]
        points[("red", "green", "blue")[axis]] = rgb[:, axis]
    return points


def _write(path: Path, vertices: NDArray[Any], faces: NDArray[Any] | None) -> None:
    lines = ["ply", "format binary_little_endian 1.0", f"comment Stillroom; {WORLD}", f"element vertex {len(vertices)}"]
    lines += [f"property {NAMES[vertices.dtype[name].str]} {name}" for name in vertices.dtype.names or ()]
    if faces is not None:
        lines += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    header = "\n".join([*lines, "end_header", ""])
    with replacing(path) as file:
        file.write(header.encode("ascii"))
        file.write(vertices.tobytes())
        if faces is not None:
            file.write(faces.tobytes())
