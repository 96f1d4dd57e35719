"""The segmentation of one image's depth cloud: planes, and Euclidean clusters of the rest."""

from dataclasses import dataclass, field

from stillroom.geometry.arrays import F32, I16, I32, Floats
from stillroom.geometry.pixels import values_at

UNKNOWN = -1
"""Label of a pixel without depth, out of range, or in a clump too small for a cluster."""
PLANE = -2
"""Label of a pixel on a plane: wall, floor, table top."""


@dataclass(frozen=True)
class Clusters:
    """K Euclidean clusters of a frame's depth cloud (OC-SLAM 2.3), largest first.

    Attributes:
        labels: Label image (H, W) int16 on the pixels as taken: 0 … K−1, `PLANE` or `UNKNOWN`.
        n_points: Points of each after the voxel filter (K,).
        centroid_m: Mean of their points (K, 3) [m, camera frame].
        lower_m, upper_m: Corners of the axis-parallel boxes around them (K, 3) [m, camera frame].
        box: Which of the image's detected boxes covers each (K,), −1 for none.
        planes: Planes (Q, 4) as unit normal and offset, n·p + d = 0 [m, camera frame], normals towards the camera.
    """

    labels: I16 = field(repr=False)
    n_points: I32
    centroid_m: F32
    lower_m: F32
    upper_m: F32
    box: I32
    planes: F32

    def __len__(self) -> int:
        """Number of clusters."""
        return len(self.n_points)

    def labels_at(self, raw_px: Floats) -> I16:
        """Return the labels (N,) at points (N, 2) of the image as taken [px]."""
        return values_at(self.labels, raw_px)
