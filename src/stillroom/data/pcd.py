"""PCD, the Point Cloud Library's format: version 0.7, binary, fields of `pcl::PointXYZRGBNormal`."""

from pathlib import Path

import numpy as np

from stillroom.data.replacing import replacing
from stillroom.geometry.arrays import U8, Floats

FIELDS = ("x", "y", "z", "rgb", "normal_x", "normal_y", "normal_z", "curvature")
POINT = np.dtype([(name, "<u4" if name == "rgb" else "<f4") for name in FIELDS])


def write_pcd(positions_m: Floats, normals: Floats, rgb: U8, path: Path) -> None:
    """Write points with colours and normals (N, 3).

    The colour is packed as the library does it: the bits 0x00RRGGBB, declared a float. They are kept as an integer
    here, since a float that is no number may change its bits when it is copied. `curvature` is unknown and zero, as the
    library itself has it before it is estimated; without the field its reader warns.

    Raises:
        StillroomError: It cannot be written.
    """
    points = np.zeros(len(positions_m), dtype=POINT)
    for axis, name in enumerate("xyz"):
        points[name] = positions_m[:, axis]
        points[f"normal_{name}"] = normals[:, axis]
    red, green, blue = rgb.astype(np.uint32).T
    points["rgb"] = red << 16 | green << 8 | blue
    header = [
        "# .PCD v0.7 - Point Cloud Data file format",
        "VERSION 0.7",
        f"FIELDS {' '.join(FIELDS)}",
        f"SIZE{' 4' * len(FIELDS)}",
        f"TYPE{' F' * len(FIELDS)}",
        f"COUNT{' 1' * len(FIELDS)}",
        f"WIDTH {len(positions_m)}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {len(positions_m)}",
        "DATA binary",
        "",
    ]
    with replacing(path) as file:
        file.write("\n".join(header).encode("ascii"))
        file.write(points.tobytes())
