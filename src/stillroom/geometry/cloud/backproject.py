"""From a depth image to an organised cloud: points along the rays of the undistorted camera."""

from dataclasses import dataclass, field

import numpy as np

from stillroom.compiled import njit
from stillroom.geometry.arrays import F32, I32
from stillroom.geometry.camera import Camera


@dataclass(frozen=True)
class RayGrid:
    """The rays of every `stride`-th pixel of the image as taken.

    Attributes:
        rays: x/z and y/z of each (h, w, 2) float32 [camera frame].
        rows, columns: The pixels (h,) and (w,) int32 [px].
        stride: Step between them [px].
        ray_area: Area dx·dy of one step on the plane z = 1.
    """

    rays: F32 = field(repr=False)
    rows: I32 = field(repr=False)
    columns: I32 = field(repr=False)
    stride: int
    ray_area: float

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the grid."""
        return len(self.rows), len(self.columns)

    @property
    def pixels(self) -> tuple[slice, slice]:
        """What `image[grid.pixels]` takes of an image: the value at each of the grid's pixels (h, w)."""
        return slice(self.rows[0], None, self.stride), slice(self.columns[0], None, self.stride)


def ray_grid(camera: Camera, height: int, width: int, stride: int) -> RayGrid:
    """Return the rays of an image's pixels, the distortion of the lens taken out.

    Args:
        camera: The calibration.
        height, width: Size of the image as taken [px].
        stride: Step between pixels [px]; at least one row and column is left.

    Raises:
        ValueError: The stride is below 1, or the image has no pixels.
    """
    if stride < 1 or height < 1 or width < 1:
        raise ValueError(f"a grid of stride {stride} on {width} x {height} pixels is not possible")
    rows = np.arange(min(stride // 2, height - 1), height, stride, dtype=np.int32)
    columns = np.arange(min(stride // 2, width - 1), width, stride, dtype=np.int32)
    u, v = np.meshgrid(columns, rows)
    px = camera.undistort(np.stack((u.ravel(), v.ravel()), axis=1).astype(np.float32)).astype(np.float64)
    rays = (px - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    area = (stride / camera.fx) * (stride / camera.fy)
    return RayGrid(np.ascontiguousarray(rays.reshape(*u.shape, 2), np.float32), rows, columns, stride, area)


def back_project(depth_m: F32, grid: RayGrid, min_depth_m: float, max_depth_m: float) -> F32:
    """Return the organised cloud of a depth image (OC-SLAM Eq. 3–4).

    Differs from the paper: the ray is that of the undistorted camera, not that of the pixel as taken.

    Args:
        depth_m: Depth (H, W) float32 [m] as taken; 0, negative, infinite or NaN where unknown.
        grid: The rays.
        min_depth_m, max_depth_m: What lies outside this range is unknown [m].

    Returns:
        Points (h, w, 3) float32 [m, camera frame]; all zero where unknown.
    """
    points = np.zeros((*grid.shape, 3), dtype=np.float32)
    back_project_into(depth_m, grid.rays, grid.rows, grid.columns, min_depth_m, max_depth_m, points)
    return points


@njit(nogil=True, cache=True)
def back_project_into(
    depth_m: F32, rays: F32, rows: I32, columns: I32, min_depth_m: float, max_depth_m: float, points: F32
) -> None:
    """Fill points (h, w, 3) [m]; see `back_project`. NaN fails both comparisons and stays unknown."""
    for i in range(len(rows)):
        for j in range(len(columns)):
            z = depth_m[rows[i], columns[j]]
            if z > 0.0 and z >= min_depth_m and z <= max_depth_m:
                points[i, j, 0] = rays[i, j, 0] * z
                points[i, j, 1] = rays[i, j, 1] * z
                points[i, j, 2] = z
