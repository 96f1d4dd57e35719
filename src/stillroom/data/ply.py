"""PLY, the format that every viewer opens: points and triangles, binary, little-endian."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stillroom.data.replacing import replacing
from stillroom.geometry.arrays import Floats, Ints

NAMES = {"<f4": "float", "<i4": "int", "|u1": "uchar"}
VERTEX = np.dtype(
    [(name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz")] + [(name, "|u1") for name in ("red", "green", "blue")]
)
POINT = np.dtype([*((name, VERTEX[name].str) for name in VERTEX.names or ()), ("weight", "<f4")])
FACE = np.dtype([("n", "|u1"), ("vertices", "<i4", (3,))])
WORLD = "metres, in the frame of the first camera: x right, y down, z forward"


def write_ply(vertices: NDArray[Any], path: Path, triangles: Ints | None = None) -> None:
    """Write points or a mesh.

    Args:
        vertices: Structured array (N,), such as of `VERTEX` or `POINT`.
        path: Where to.
        triangles: Vertex numbers (M, 3), counter-clockwise as seen from the side of the normals.

    Raises:
        StillroomError: It cannot be written.
    """
    lines = ["ply", "format binary_little_endian 1.0", f"comment Stillroom; {WORLD}", f"element vertex {len(vertices)}"]
    lines += [f"property {NAMES[vertices.dtype[name].str]} {name}" for name in vertices.dtype.names or ()]
    if triangles is not None:
        lines += [f"element face {len(triangles)}", "property list uchar int vertex_indices"]
    with replacing(path) as file:
        file.write("\n".join([*lines, "end_header", ""]).encode("ascii"))
        file.write(vertices.tobytes())
        if triangles is not None:
            faces = np.empty(len(triangles), dtype=FACE)
            faces["n"] = 3
            faces["vertices"] = triangles
            file.write(faces.tobytes())


def filled(kind: np.dtype[Any], positions_m: Floats, normals: Floats, rgb: NDArray[np.uint8]) -> NDArray[Any]:
    """Return a structured array (N,) with positions, normals and colours (N, 3) in their fields."""
    points = np.zeros(len(positions_m), dtype=kind)
    for axis in range(3):
        points["xyz"[axis]] = positions_m[:, axis]
        points[("nx", "ny", "nz")[axis]] = normals[:, axis]
        points[("red", "green", "blue")[axis]] = rgb[:, axis]
    return points
