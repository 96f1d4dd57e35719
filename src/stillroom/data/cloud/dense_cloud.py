"""The dense map as it leaves the house: coloured, oriented points."""

from dataclasses import dataclass

from stillroom.geometry.arrays import F32, U8


@dataclass(frozen=True)
class DenseCloud:
    """N points of the static scene, one for each occupied voxel.

    Attributes:
        positions_m: Mean positions (N, 3) float32 [m, world].
        normals: Unit normals towards the cameras that saw them (N, 3) float32 [world].
        rgb: Mean colours (N, 3) uint8.
        weight: How many pixels each is the mean of (N,) float32.
        voxel_m: Edge of the voxels [m].
    """

    positions_m: F32
    normals: F32
    rgb: U8
    weight: F32
    voxel_m: float

    def __len__(self) -> int:
        """Number of points."""
        return len(self.positions_m)
