"""From labels of a cloud's points to a label image on all pixels."""

from typing import NamedTuple

import numpy as np

from stillroom.compiled import njit
from stillroom.geometry.arrays import F32, I16, I32
from stillroom.geometry.cloud.backproject import RayGrid


def spread_labels(
    labels: I16, points_m: F32, depth_m: F32, grid: RayGrid, step_m: float, step_share: float, unknown: int
) -> I16:
    """Give every pixel the label of the sample around it that is nearest in depth.

    This is OC-SLAM's Eq. 5 (whose print lacks the division by z) inverted: a point of an organised cloud has a known
    pixel, so nothing is projected, no cluster gets holes, and edges follow the depth image.

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
        samples = DepthSamples(labels, z, grid.rows, grid.columns)
        spread_into(samples, depth_m, np.float32(step_m), np.float32(step_share), np.int16(unknown), image)
    return image


class DepthSamples(NamedTuple):
    """Labels and depths of samples (h, w), and the pixel rows (h,) and columns (w,) that they were taken at."""

    labels: I16
    z: F32
    rows: I32
    columns: I32


@njit(nogil=True, cache=True)
def spread_into(
    samples: DepthSamples, depth_m: F32, step_m: float, step_share: float, unknown: int, image: I16
) -> None:
    """Fill the label image (H, W); see `spread_labels`.

    All pixels of a row are labelled at once, by steps that compile to vector instructions: those between four samples
    on one surface, and then the others.
    """
    labels, z, rows, columns = samples
    last_i, last_j = len(rows) - 1, len(columns) - 1
    height, width = image.shape
    block_of = np.zeros(width, dtype=np.int32)  # the sample at the upper left of each pixel
    for c in range(columns[0] + 1, width):
        block_of[c] = block_of[c - 1] + (c == columns[min(block_of[c - 1] + 1, last_j)])
    low, high = np.empty(last_j + 1, dtype=np.float32), np.empty(last_j + 1, dtype=np.float32)
    is_mixed, mixed = np.empty(last_j + 1, dtype=np.uint8), np.empty(width, dtype=np.int32)
    low_at, high_at, label_at = np.empty(width, np.float32), np.empty(width, np.float32), np.empty(width, np.int16)
    for i0 in range(last_i + 1):
        i1 = min(i0 + 1, last_i)
        for j0 in range(last_j + 1):
            j1 = min(j0 + 1, last_j)
            a0, nearest = labels[i0, j0], min(min(z[i0, j0], z[i0, j1]), min(z[i1, j0], z[i1, j1]))
            farthest = max(max(z[i0, j0], z[i0, j1]), max(z[i1, j0], z[i1, j1]))
            step = max(step_m, step_share * farthest)
            # One surface: what lies between the samples in depth is within the step of one of them.
            is_one = (a0 == labels[i0, j1]) & (a0 == labels[i1, j0]) & (a0 == labels[i1, j1]) & (nearest > 0.0)
            is_one &= farthest - nearest <= step
            low[j0] = max(nearest - step, np.float32(0.0)) if is_one else np.float32(np.inf)
            high[j0] = farthest + step
            is_mixed[j0] = not is_one and farthest > 0.0
        n_mixed = 0
        for c in range(width):
            low_at[c], high_at[c], label_at[c] = low[block_of[c]], high[block_of[c]], labels[i0, block_of[c]]
            mixed[n_mixed] = c
            n_mixed += is_mixed[block_of[c]]
        top, bottom = (0 if i0 == 0 else rows[i0]), (height if i0 == last_i else rows[i1])
        for r in range(top, bottom):
            for c in range(width):
                is_on = np.int16(low_at[c] < depth_m[r, c]) & np.int16(depth_m[r, c] <= high_at[c])
                image[r, c] = unknown + is_on * (label_at[c] - unknown)
        at = mixed[:n_mixed]
        spread_mixed(samples, i0, at, block_of, depth_m[top:bottom], step_m, step_share, unknown, image[top:bottom])


@njit(nogil=True, cache=True)
def spread_mixed(
    samples: DepthSamples,
    i0: int,
    mixed: I32,
    block_of: I32,
    depth_m: F32,
    step_m: float,
    step_share: float,
    unknown: int,
    image: I16,
) -> None:
    """Label pixels of some rows (R, W) by the nearest in depth of the four samples around each.

    Args:
        samples: The samples.
        i0: Row of samples above.
        mixed: Columns of the pixels (C,).
        block_of: Column of samples to the left of each pixel (W,).
        depth_m: Depth of the rows (R, W) [m].
        step_m, step_share, unknown: See `spread_labels`.
        image: Labels (R, W), written to.
    """
    labels, z = samples.labels, samples.z
    i1, n = min(i0 + 1, z.shape[0] - 1), len(mixed)
    around, label = np.empty((4, n), dtype=np.float32), np.empty((4, n), dtype=np.float32)
    step, depth, found = np.empty(n, np.float32), np.empty(n, np.float32), np.empty(n, np.float32)
    for m in range(n):
        j0 = block_of[mixed[m]]
        j1 = min(j0 + 1, z.shape[1] - 1)
        around[0, m], around[1, m], around[2, m], around[3, m] = z[i0, j0], z[i0, j1], z[i1, j0], z[i1, j1]
        label[0, m], label[1, m], label[2, m], label[3, m] = (
            labels[i0, j0],
            labels[i0, j1],
            labels[i1, j0],
            labels[i1, j1],
        )
        step[m] = max(step_m, step_share * max(around[0, m], around[1, m], around[2, m], around[3, m]))
    z0, z1, z2, z3 = around
    a0, a1, a2, a3 = label
    none = np.float32(unknown)
    for r in range(len(depth_m)):
        for m in range(n):
            depth[m] = depth_m[r, mixed[m]]
        for m in range(n):
            # An unknown sample's depth of 0 is as far from the pixel's as the pixel is from the camera.
            d, best, a, other = depth[m], abs(z0[m] - depth[m]), a0[m], a1[m]
            away = abs(z1[m] - d)
            a, best, other = other if away < best else a, away if away < best else best, a2[m]
            away = abs(z2[m] - d)
            a, best, other = other if away < best else a, away if away < best else best, a3[m]
            away = abs(z3[m] - d)
            a, best = other if away < best else a, away if away < best else best
            best = best if best < d else np.float32(np.inf)
            found[m] = a if best <= step[m] else none
        for m in range(n):
            image[r, mixed[m]] = np.int16(found[m])
