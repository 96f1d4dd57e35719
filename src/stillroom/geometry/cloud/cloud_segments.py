"""Clusters of a cloud in which the foreground of each box is clustered separately."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from stillroom.bounds import bounded
from stillroom.compiled import njit
from stillroom.geometry.arrays import F32, F64, I16, I32, I64, Bool, Floats
from stillroom.geometry.cloud.backproject import RayGrid
from stillroom.geometry.cloud.euclidean import depth_scaled, euclidean_clusters
from stillroom.geometry.cloud.voxels import voxel_filter

NO_BOX = -1
BIN_M = 0.05
MANY = 0.6
NO_SEGMENT = -1


# From labels of a cloud's points to a label image on all pixels.


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


# The foreground of a box: pixels near the depth that most of them have.


def claim_foregrounds(
    z_m: F32,
    free: Bool,
    rows: I32,
    columns: I32,
    boxes_xyxy_px: Floats,
    half_depth_m: float,
    min_share: float,
) -> I16:
    """Give the samples of each box's foreground to the box, so that they can be clustered separately.

    The foreground's depth is the nearest at which a window over the depths holds many of the box's free samples. Boxes
    claim samples, the nearest box first, and the depth of the next is taken from what is left: of a person half behind
    another, the rest.

    Args:
        z_m: Depths of the samples (h, w) [m].
        free: Which of them may be claimed (h, w): known, and on no plane.
        rows, columns: Their pixels (h,) and (w,) [px].
        boxes_xyxy_px: Edges of the boxes (B, 4) [px].
        half_depth_m: Half the depth extent of an object in a box [m].
        min_share: A box claims nothing where its foreground has less than this share of its samples.

    Returns:
        Box of each sample (h, w) int16, −1 for none.
    """
    owner = np.full(z_m.shape, NO_BOX, dtype=np.int16)
    windows = [_window(box, rows, columns) for box in boxes_xyxy_px]
    first = [_mode(z_m[at][free[at]], half_depth_m) for at in windows]
    # Of boxes at one depth the one with most support claims first; the other's foreground may be what is left of it.
    for k in sorted(range(len(windows)), key=lambda k: (round(first[k][0] / half_depth_m), -first[k][1], k)):
        at = windows[k]
        left = free[at] & (owner[at] == NO_BOX)
        centre_m, support = _mode(z_m[at][left], half_depth_m)
        if support == 0 or support < min_share * left.size:
            continue
        owner[at][left & (np.abs(z_m[at] - centre_m) <= half_depth_m)] = k
    return owner


def _window(box: Floats, rows: I32, columns: I32) -> tuple[slice, slice]:
    x0, y0, x1, y1 = box
    top, bottom = np.searchsorted(rows, (y0, np.nextafter(y1, np.inf)))
    left, right = np.searchsorted(columns, (x0, np.nextafter(x1, np.inf)))
    return slice(int(top), int(bottom)), slice(int(left), int(right))


def _mode(z_m: F32, half_depth_m: float) -> tuple[float, int]:
    """Return the middle of the nearest depth window that holds many samples [m], and how many.

    Many is `MANY` of what any window holds: people stand in front of furniture more often than behind it.
    """
    if len(z_m) == 0:
        return 0.0, 0
    counts = np.bincount((z_m / BIN_M).astype(np.int64))
    width = max(1, round(2.0 * half_depth_m / BIN_M))
    held = np.convolve(counts, np.ones(width, dtype=np.int64))
    last = int(np.argmax(held >= MANY * held.max()))
    # From where it starts to hold many on to where it holds most.
    while last + 1 < len(held) and held[last + 1] > held[last]:
        last += 1
    inside = np.sort(z_m[(z_m >= (last - width + 1) * BIN_M) & (z_m < (last + 1) * BIN_M)])
    return float(inside[len(inside) // 2]) if len(inside) else 0.0, int(held[last])


@dataclass(frozen=True)
class SegmentLimits:
    """How points become clusters.

    Attributes:
        voxel_m: Edge of the voxel filter [m].
        tolerance_m: Points no further apart than this are one cluster [m] …
        tolerance_share: … or than this share of their depth, if it is more: points lie thinner far away.
        min_points: Fewest points of a cluster, after the voxel filter.
        limb_share: Largest size of a piece beyond a box, as a share of the box's cluster, that counts as a limb which
            the box cut off.
        limb_reach: How far beyond the box it may reach, as a share of the box's width.
    """

    voxel_m: float = bounded(0.02, above=0)
    tolerance_m: float = bounded(0.04, above=0)
    tolerance_share: float = bounded(0.018, least=0)
    min_points: int = bounded(40, least=1)
    limb_share: float = 0.25
    limb_reach: float = 0.25


@dataclass(frozen=True)
class CloudSegments:
    """K clusters, largest first.

    Attributes:
        segment_of: Cluster of each sample (h, w), −1 for none.
        box: The box whose foreground each is (K,), −1 for none.
        n_points: Voxels of each (K,).
        centroid_m: Mean of their samples (K, 3) [m].
        lower_m, upper_m: Corners of the boxes around them (K, 3) [m].
    """

    segment_of: I32
    box: I32
    n_points: I32
    centroid_m: F32
    lower_m: F32
    upper_m: F32


@dataclass(frozen=True)
class _Pieces:
    """Euclidean clusters before they are merged: of samples (N,), of voxels (M,) with means and weights."""

    of_sample: I32
    of_voxel: I32
    mean_m: F64
    weight: I32
    box: I32

    @property
    def sizes(self) -> I64:
        return np.bincount(self.of_voxel, minlength=len(self.box))


def segment(
    points_m: F32, free: Bool, owner: I16, boxes_xyxy_px: Floats, grid: RayGrid, limits: SegmentLimits
) -> CloudSegments:
    """Cluster the foreground of each box, and separately what belongs to none (OC-SLAM 2.4).

    What a box's edge cut off a person, a hand or the head, is merged with it; small fragments in a box join its largest
    cluster.

    Args:
        points_m: Organised cloud (h, w, 3) [m, camera frame].
        free: Samples to be clustered (h, w): known, and on no plane.
        owner: Box that claims each sample (h, w), −1 for none.
        boxes_xyxy_px: Edges of the boxes (B, 4) [px].
        grid: The samples' pixels.
        limits: How points become clusters.
    """
    pieces = _pieces(points_m[free], owner[free], len(boxes_xyxy_px), limits)
    target = np.arange(len(pieces.box), dtype=np.int32)
    _gather_crumbs(pieces, target, limits)
    piece_of = np.full(free.shape, NO_SEGMENT, dtype=np.int32)
    piece_of[free] = pieces.of_sample
    _give_limbs_back(pieces, piece_of, points_m[..., 2], boxes_xyxy_px, grid, target, limits)
    return _largest_first(pieces, target, piece_of, limits)


def _pieces(points_m: F32, owner: I16, n_boxes: int, limits: SegmentLimits) -> _Pieces:
    of_sample = np.full(len(points_m), NO_SEGMENT, dtype=np.int32)
    of_voxel, means, weights = [np.zeros(0, np.int32)], [np.zeros((0, 3))], [np.zeros(0, np.int32)]
    boxes: list[int] = []
    for box in range(NO_BOX, n_boxes):
        chosen = np.flatnonzero(owner == box)
        if len(chosen) == 0:
            continue
        voxels = voxel_filter(points_m[chosen], limits.voxel_m)
        scaled = depth_scaled(voxels.mean_m, limits.tolerance_m, limits.tolerance_share)
        piece = euclidean_clusters(scaled, 1.0) + np.int32(len(boxes))
        of_sample[chosen] = piece[voxels.voxel_of]
        of_voxel.append(piece)
        means.append(voxels.mean_m)
        weights.append(voxels.n_points)
        boxes += [box] * (int(piece.max()) + 1 - len(boxes))
    box_of = np.array(boxes, dtype=np.int32)
    return _Pieces(of_sample, np.concatenate(of_voxel), np.concatenate(means), np.concatenate(weights), box_of)


def _gather_crumbs(pieces: _Pieces, target: I32, limits: SegmentLimits) -> None:
    """Merge fragments too small for a cluster, in a box's foreground, with the largest cluster there."""
    sizes = pieces.sizes
    for box in range(int(pieces.box.max(initial=NO_BOX)) + 1):
        own = np.flatnonzero(pieces.box == box)
        if len(own):
            target[own[sizes[own] < limits.min_points]] = own[np.argmax(sizes[own])]


def _give_limbs_back(
    pieces: _Pieces, piece_of: I32, z_m: F32, boxes_px: Floats, grid: RayGrid, target: I32, limits: SegmentLimits
) -> None:
    """Merge small pieces beyond a box with the box's cluster that they touch most."""
    if not np.any(pieces.box >= 0):
        return
    total = np.bincount(target, pieces.sizes, len(target))
    sizes = pieces.sizes
    low, high = _bounds(piece_of, grid, len(target))
    for limb, body in _contacts(piece_of, z_m, limits):
        if pieces.box[limb] != NO_BOX or pieces.box[body] == NO_BOX or target[limb] != limb:
            continue
        box = boxes_px[pieces.box[body]]
        reach_px = limits.limb_reach * (box[2] - box[0])
        inside = np.all(low[limb] >= box[:2] - reach_px) and np.all(high[limb] <= box[2:] + reach_px)
        if inside and sizes[limb] <= limits.limb_share * total[target[body]]:
            target[limb] = target[body]


def _contacts(piece_of: I32, z_m: F32, limits: SegmentLimits) -> list[tuple[int, int]]:
    """Return the pairs of pieces that touch in the image and in depth, both ways round, the longest contact first."""
    pairs = []
    n = int(piece_of.max(initial=0)) + 1
    for here, there in (((slice(None), slice(None, -1)), (slice(None), slice(1, None))), (np.s_[:-1], np.s_[1:])):
        a, b = piece_of[here], piece_of[there]
        step = np.maximum(np.float32(limits.tolerance_m), np.float32(limits.tolerance_share) * z_m[here])
        touch = (a != b) & (a >= 0) & (b >= 0) & (np.abs(z_m[here] - z_m[there]) <= step)
        first, second = a[touch].astype(np.int64), b[touch].astype(np.int64)
        pairs += [first * n + second, second * n + first]
    keys, counts = np.unique(np.concatenate(pairs), return_counts=True)
    ordered = keys[np.argsort(-counts, kind="stable")]
    return [(int(key) // n, int(key) % n) for key in ordered]


def _bounds(piece_of: I32, grid: RayGrid, n: int) -> tuple[F64, F64]:
    """Return the corners of the image boxes around n pieces (n, 2) each [px]."""
    low, high = np.full((n, 2), np.inf), np.full((n, 2), -np.inf)
    stretch(piece_of, grid.columns.astype(np.float64), grid.rows.astype(np.float64), low, high)
    return low, high


def _largest_first(pieces: _Pieces, target: I32, piece_of: I32, limits: SegmentLimits) -> CloudSegments:
    """Merge pieces, drop what is too small, and measure the rest."""
    of_voxel = target[pieces.of_voxel]
    size = np.bincount(of_voxel, minlength=len(target))
    order = np.argsort(-size, kind="stable")[: int((size >= limits.min_points).sum())]
    rank = np.full(len(target) + 1, NO_SEGMENT, dtype=np.int32)  # the last is that of no piece
    rank[order] = np.arange(len(order))
    total, centroid, lower, upper = measure(pieces.mean_m, pieces.weight, rank[of_voxel], len(order))
    return CloudSegments(
        segment_of=np.where(piece_of >= 0, rank[np.append(target, len(target))[piece_of]], NO_SEGMENT).astype(np.int32),
        box=pieces.box[order],
        n_points=size[order].astype(np.int32),
        centroid_m=(centroid / np.maximum(total, 1.0)[:, None]).astype(np.float32),
        lower_m=lower.astype(np.float32),
        upper_m=upper.astype(np.float32),
    )


@njit(nogil=True, cache=True)
def stretch(piece_of: I32, columns_px: F64, rows_px: F64, low: F64, high: F64) -> None:
    """Move the corners `low` and `high` (n, 2) of the pieces' boxes apart until all samples (h, w) lie in them."""
    for row in range(piece_of.shape[0]):
        for column in range(piece_of.shape[1]):
            piece = piece_of[row, column]
            if piece >= 0:
                low[piece, 0] = min(low[piece, 0], columns_px[column])
                low[piece, 1] = min(low[piece, 1], rows_px[row])
                high[piece, 0] = max(high[piece, 0], columns_px[column])
                high[piece, 1] = max(high[piece, 1], rows_px[row])


@njit(nogil=True, cache=True)
def measure(points: F64, weight: I32, segment_of: I32, n: int) -> tuple[F64, F64, F64, F64]:
    """Return weights (n,), weighted sums, lower and upper corners (n, 3) each of n segments of points (N, 3)."""
    total, sums = np.zeros(n), np.zeros((n, 3))
    lower, upper = np.full((n, 3), np.inf), np.full((n, 3), -np.inf)
    for i in range(len(points)):
        s = segment_of[i]
        if s >= 0:
            total[s] += weight[i]
            for k in range(3):
                sums[s, k] += weight[i] * points[i, k]
                lower[s, k] = min(lower[s, k], points[i, k])
                upper[s, k] = max(upper[s, k], points[i, k])
    return total, sums, lower, upper
