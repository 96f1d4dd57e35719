"""From labels of a cloud's points to a label image on all pixels."""

from typing import NamedTuple

import numpy as np
from numba import njit

from stillroom.geometry.arrays import F32, I16, I32
from stillroom.geometry.cloud.backproject import RayGrid


def spread_labels(
    labels: I16, points_m: F32, depth_m: F32, grid: RayGrid, step_m: float, step_share: float, unknown: int
) -> I16:
    """Give every pixel the label of the sample around it that is nearest in depth.

    This is OC-SLAM's Eq. 5 (whose print lacks the division by z) read backwards: a point of an organised cloud knows
    the pixel that it came from, so nothing is projected, no cluster gets holes, and edges follow the depth image.

    Args:
        labels: Labels of the samples (h, w).
        points_m: Their points (h, w, 3) [m]; z = 0 where unknown.
        depth_m: Depth image (H, W) [m].
        grid: The samples' pixels.
        step_m, step_share: A pixel further in depth from all four samples around it than max(step_m, step_share · z),
            z being the depth of the farthest of them, belongs to none [m].
        unknown: Label of such pixels, and of those without depth.

    Returns:
        Labels (H, W) int16.
    """
    image = np.full(depth_m.shape, unknown, dtype=np.int16)
    if labels.size:
        z = np.ascontiguousarray(points_m[..., 2])
        samples = Samples(labels, z, grid.rows, grid.columns)
        spread_into(samples, depth_m, np.float32(step_m), np.float32(step_share), np.int16(unknown), image)
    return image


class Samples(NamedTuple):
    """Labels and depths of samples (h, w), and the pixel rows (h,) and columns (w,) that they were taken at."""

    labels: I16
    z: F32
    rows: I32
    columns: I32


@njit(nogil=True, cache=True)
def spread_into(samples: Samples, depth_m: F32, step_m: float, step_share: float, unknown: int, image: I16) -> None:
    """Fill the label image (H, W); see `spread_labels`."""
    labels, z, rows, columns = samples
    last_i, last_j = len(rows) - 1, len(columns) - 1
    height, width = image.shape
    for i0 in range(last_i + 1):
        i1 = min(i0 + 1, last_i)
        top, bottom = (0 if i0 == 0 else rows[i0]), (height if i0 == last_i else rows[i1])
        for j0 in range(last_j + 1):
            j1 = min(j0 + 1, last_j)
            left, right = (0 if j0 == 0 else columns[j0]), (width if j0 == last_j else columns[j1])
            z0, z1, z2, z3 = z[i0, j0], z[i0, j1], z[i1, j0], z[i1, j1]
            if z0 <= 0.0 and z1 <= 0.0 and z2 <= 0.0 and z3 <= 0.0:
                continue
            a0, a1, a2, a3 = labels[i0, j0], labels[i0, j1], labels[i1, j0], labels[i1, j1]
            nearest, farthest = min(z0, z1, z2, z3), max(z0, z1, z2, z3)
            step = max(step_m, step_share * farthest)
            if a0 == a1 == a2 == a3 and nearest > 0.0 and farthest - nearest <= step:
                # One surface: what lies between the samples in depth is within the step of one of them.
                low, high = max(nearest - step, np.float32(0.0)), farthest + step
                for r in range(top, bottom):
                    for c in range(left, right):
                        image[r, c] = a0 if low < depth_m[r, c] <= high else unknown
                continue
            for r in range(top, bottom):
                for c in range(left, right):
                    depth = depth_m[r, c]
                    # An unknown sample's depth of 0 is as far from the pixel's as the pixel is from the camera.
                    best, label = abs(z0 - depth), a0
                    if abs(z1 - depth) < best:
                        best, label = abs(z1 - depth), a1
                    if abs(z2 - depth) < best:
                        best, label = abs(z2 - depth), a2
                    if abs(z3 - depth) < best:
                        best, label = abs(z3 - depth), a3
                    if best <= step and best < depth:
                        image[r, c] = label
