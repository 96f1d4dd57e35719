"""The clusters of a cloud whose boxes' foregrounds are clustered apart from the rest."""

from dataclasses import dataclass

import numpy as np
from numba import njit

from stillroom.geometry.arrays import F32, F64, I16, I32, I64, Bool, Floats
from stillroom.geometry.cloud.backproject import RayGrid
from stillroom.geometry.cloud.euclidean import depth_scaled, euclidean_clusters
from stillroom.geometry.cloud.foreground import NO_BOX
from stillroom.geometry.cloud.voxels import voxel_filter

NO_SEGMENT = -1


@dataclass(frozen=True)
class SegmentLimits:
    """How points become clusters.

    Attributes:
        voxel_m: Edge of the voxel filter [m].
        tolerance_m: Points no further apart than this are one cluster [m] …
        tolerance_share: … or than this share of their depth, if it is more: points lie thinner far away.
        min_points: Fewest points of a cluster, after the voxel filter.
        limb_share: Largest size of a piece beyond a box, as a share of the box's cluster, that is taken for a limb
            which the box cut off.
        limb_reach: How far beyond the box it may reach, as a share of the box's width.
    """

    voxel_m: float = 0.02
    tolerance_m: float = 0.04
    tolerance_share: float = 0.018
    min_points: int = 40
    limb_share: float = 0.25
    limb_reach: float = 0.25


@dataclass(frozen=True)
class Segments:
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
    """Euclidean clusters before they are put together: of samples (N,), of voxels (M,) with means and weights."""

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
) -> Segments:
    """Cluster the foreground of each box, and apart from them what belongs to none (OC-SLAM 2.4).

    What a box's edge cut off a person, a hand or the head, is given back; crumbs in a box join its largest cluster.

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
    """Give what is too small for a cluster, in a box's foreground, to the largest there: what it is a crumb of."""
    sizes = pieces.sizes
    for box in range(int(pieces.box.max(initial=NO_BOX)) + 1):
        own = np.flatnonzero(pieces.box == box)
        if len(own):
            target[own[sizes[own] < limits.min_points]] = own[np.argmax(sizes[own])]


def _give_limbs_back(
    pieces: _Pieces, piece_of: I32, z_m: F32, boxes_px: Floats, grid: RayGrid, target: I32, limits: SegmentLimits
) -> None:
    """Give small pieces beyond a box to the box's cluster that they touch most."""
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


def _largest_first(pieces: _Pieces, target: I32, piece_of: I32, limits: SegmentLimits) -> Segments:
    """Put pieces together, drop what is too small, and measure what is left."""
    of_voxel = target[pieces.of_voxel]
    size = np.bincount(of_voxel, minlength=len(target))
    order = np.argsort(-size, kind="stable")[: int((size >= limits.min_points).sum())]
    rank = np.full(len(target) + 1, NO_SEGMENT, dtype=np.int32)  # the last is that of no piece
    rank[order] = np.arange(len(order))
    total, centroid, lower, upper = measure(pieces.mean_m, pieces.weight, rank[of_voxel], len(order))
    return Segments(
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
