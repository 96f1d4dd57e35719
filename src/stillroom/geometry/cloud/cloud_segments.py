"""Clusters of a cloud in which the foreground of each box is clustered separately."""

from dataclasses import dataclass

import numpy as np

from stillroom.bounds import bounded
from stillroom.compiled import njit
from stillroom.geometry.arrays import F32, F64, I16, I32, I64, Bool, Floats
from stillroom.geometry.cloud.backproject import RayGrid
from stillroom.geometry.cloud.euclidean import depth_scaled, euclidean_clusters, is_near, join
from stillroom.geometry.cloud.voxels import voxel_filter

NO_BOX = -1
BIN_M = 0.05
MANY = 0.6
NO_SEGMENT = -1


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
    first = [_mode(unclaimed_depths(z_m[at], free[at], owner[at]), half_depth_m) for at in windows]
    # Of boxes at one depth the one with most support claims first; the other's foreground may be what is left of it.
    for k in sorted(range(len(windows)), key=lambda k: (round(first[k][0] / half_depth_m), -first[k][1], k)):
        at = windows[k]
        is_cut = bool((owner[at] != NO_BOX).any())
        centre_m, support = _mode(unclaimed_depths(z_m[at], free[at], owner[at]), half_depth_m) if is_cut else first[k]
        if support and support >= min_share * owner[at].size:
            claim(z_m[at], free[at], np.float32(centre_m), np.float32(half_depth_m), np.int16(k), owner[at])
    return owner


@njit(nogil=True, cache=True)
def unclaimed_depths(z_m: F32, free: Bool, owner: I16) -> F32:
    """Return the depths (N,) [m] of samples (h, w) that are free, and that no box has claimed."""
    depths_m = np.empty(z_m.size, dtype=np.float32)
    n = 0
    for i in range(z_m.shape[0]):
        for j in range(z_m.shape[1]):
            depths_m[n] = z_m[i, j]
            n += free[i, j] and owner[i, j] == NO_BOX
    return depths_m[:n]


@njit(nogil=True, cache=True)
def claim(z_m: F32, free: Bool, centre_m: float, half_depth_m: float, box: int, owner: I16) -> None:
    """Give the free samples (h, w) that no box has claimed, and that are near in depth, to a box."""
    for i in range(z_m.shape[0]):
        for j in range(z_m.shape[1]):
            if free[i, j] and owner[i, j] == NO_BOX and abs(z_m[i, j] - centre_m) <= half_depth_m:
                owner[i, j] = box


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
    inside, held = fullest_window(z_m, max(1, round(2.0 * half_depth_m / BIN_M)), np.float32(BIN_M), MANY)
    middle = len(inside) // 2
    return float(np.partition(inside, middle)[middle]) if len(inside) else 0.0, held


@njit(nogil=True, cache=True, error_model="numpy")
def fullest_window(z_m: F32, width: int, bin_m: float, many: float) -> tuple[F32, int]:
    """Return the depths (N,) in the nearest window that holds many, and how many it holds by its bins; see `_mode`.

    Args:
        z_m: Depths [m], above 0.
        width: Width of the window [bins].
        bin_m: Width of a bin [m].
        many: Share of what any window holds.
    """
    n_bins = int(z_m.max() / bin_m) + 1
    held = np.zeros(n_bins + width - 1, dtype=np.int64)  # by the last bin of the window
    for z in z_m:
        held[int(z / bin_m)] += 1
    counts = held.copy()
    for last in range(1, len(held)):
        held[last] = held[last - 1] + counts[last] - (counts[last - width] if last >= width else 0)
    last, enough = 0, many * held.max()
    while held[last] < enough:
        last += 1
    # From where it starts to hold many on to where it holds most.
    while last + 1 < len(held) and held[last + 1] > held[last]:
        last += 1
    low, high = np.float32((last - width + 1) * BIN_M), np.float32((last + 1) * BIN_M)
    inside = np.empty(len(z_m), dtype=np.float32)
    n = 0
    for z in z_m:
        if z >= low and z < high:
            inside[n] = z
            n += 1
    return inside[:n], held[last]


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
    """P Euclidean clusters of M voxels before they are merged.

    Attributes:
        voxel_at: Voxel of each sample (h, w), −1 for none.
        of_voxel: Piece of each voxel (M,).
        mean_m: Mean of each voxel (M, 3) [m].
        weight: Samples of each voxel (M,).
        box: Box whose foreground each piece is (P,), −1 for none.
        sizes: Voxels of each piece (P,).
    """

    voxel_at: I32
    of_voxel: I32
    mean_m: F64
    weight: I32
    box: I32
    sizes: I64


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
    pieces = _pieces(points_m, free, owner, len(boxes_xyxy_px), limits)
    target = np.arange(len(pieces.box), dtype=np.int32)
    if np.any(pieces.box >= 0):
        _gather_crumbs(pieces, target, limits)
        _give_limbs_back(pieces, points_m, boxes_xyxy_px, grid, target, limits)
    return _largest_first(pieces, target, limits)


def _pieces(points_m: F32, free: Bool, owner: I16, n_boxes: int, limits: SegmentLimits) -> _Pieces:
    at, points, box = sorted_by_box(points_m, free, owner, n_boxes)
    voxels = voxel_filter(points, limits.voxel_m, box)
    scaled = depth_scaled(voxels.mean_m, limits.tolerance_m, limits.tolerance_share)
    voxel_at = np.full(free.shape, NO_SEGMENT, dtype=np.int32)
    joined = np.arange(len(voxels), dtype=np.int32)
    join_adjacent(at, voxels.voxel_of, voxels.group, scaled, voxel_at, joined)
    of_voxel = euclidean_clusters(scaled, 1.0, voxels.group, joined)
    sizes = np.bincount(of_voxel)
    box_of = np.empty(len(sizes), dtype=np.int32)
    box_of[of_voxel] = voxels.group
    return _Pieces(voxel_at, of_voxel, voxels.mean_m, voxels.n_points, box_of, sizes)


def _gather_crumbs(pieces: _Pieces, target: I32, limits: SegmentLimits) -> None:
    """Merge fragments too small for a cluster, in a box's foreground, with the largest cluster there."""
    for box in range(int(pieces.box.max(initial=NO_BOX)) + 1):
        own = np.flatnonzero(pieces.box == box)
        if len(own):
            target[own[pieces.sizes[own] < limits.min_points]] = own[np.argmax(pieces.sizes[own])]


def _give_limbs_back(
    pieces: _Pieces, points_m: F32, boxes_px: Floats, grid: RayGrid, target: I32, limits: SegmentLimits
) -> None:
    """Merge small pieces beyond a box with the box's cluster that they touch most."""
    n, steps = len(target), (np.float32(limits.tolerance_m), np.float32(limits.tolerance_share))
    touching = contacts(points_m, pieces.voxel_at, pieces.of_voxel, pieces.box, *steps)
    if len(touching) == 0:
        return
    keys, counts = np.unique(touching, return_counts=True)
    low, high = np.full((n, 2), np.inf), np.full((n, 2), -np.inf)
    stretch(pieces.voxel_at, pieces.of_voxel, grid.columns, grid.rows, low, high)
    reach_px = limits.limb_reach * (boxes_px[:, 2:3] - boxes_px[:, :1])
    least_px, most_px = boxes_px[:, :2] - reach_px, boxes_px[:, 2:] + reach_px
    most_voxels = limits.limb_share * np.bincount(target, pieces.sizes, n)
    for key in keys[np.argsort(-counts, kind="stable")].tolist():  # the longest contact first
        limb, body = divmod(key, n)
        if target[limb] != limb or pieces.sizes[limb] > most_voxels[target[body]]:
            continue
        box = pieces.box[body]
        if (low[limb] >= least_px[box]).all() and (high[limb] <= most_px[box]).all():
            target[limb] = target[body]


def _largest_first(pieces: _Pieces, target: I32, limits: SegmentLimits) -> CloudSegments:
    """Merge pieces, drop what is too small, and measure the rest."""
    size = np.bincount(target, pieces.sizes, len(target)).astype(np.int64)
    order = np.argsort(-size, kind="stable")[: int((size >= limits.min_points).sum())]
    rank = np.full(len(target), NO_SEGMENT, dtype=np.int32)
    rank[order] = np.arange(len(order))
    of_voxel = rank[target][pieces.of_voxel]
    total, centroid, lower, upper = measure(pieces.mean_m, pieces.weight, of_voxel, len(order))
    return CloudSegments(
        segment_of=renumbered(pieces.voxel_at, of_voxel),
        box=pieces.box[order],
        n_points=size[order].astype(np.int32),
        centroid_m=(centroid / np.maximum(total, 1.0)[:, None]).astype(np.float32),
        lower_m=lower.astype(np.float32),
        upper_m=upper.astype(np.float32),
    )


@njit(nogil=True, cache=True)
def sorted_by_box(points: F32, free: Bool, owner: I16, n_boxes: int) -> tuple[I32, F64, I32]:
    """Sort the free samples (h, w) by the box that owns them, those of none first, each box's as they come.

    Returns:
        Flat index of each (N,), its point (N, 3) [m], and its box (N,).
    """
    start = np.zeros(n_boxes + 2, dtype=np.int64)
    for i in range(free.shape[0]):
        for j in range(free.shape[1]):
            if free[i, j]:
                start[owner[i, j] + 2] += 1
    # Not by np.cumsum: for it numba imports scipy.linalg.
    for b in range(1, len(start)):
        start[b] += start[b - 1]
    n = start[-1]
    at, sorted_points, box = np.empty(n, dtype=np.int32), np.empty((n, 3)), np.empty(n, dtype=np.int32)
    for i in range(free.shape[0]):
        for j in range(free.shape[1]):
            if free[i, j]:
                k = start[owner[i, j] + 1]
                start[owner[i, j] + 1] += 1
                at[k], box[k] = i * free.shape[1] + j, owner[i, j]
                sorted_points[k, 0], sorted_points[k, 1] = points[i, j, 0], points[i, j, 1]
                sorted_points[k, 2] = points[i, j, 2]
    return at, sorted_points, box


@njit(nogil=True, cache=True)
def join_adjacent(at: I32, voxel_of: I32, group: I32, scaled: F64, voxel_at: I32, joined: I32) -> None:
    """Paint the samples' voxels, and join those of samples beside each other: most neighbours are found so.

    Args:
        at: Flat index of each sample (N,).
        voxel_of: Its voxel (N,).
        group: Group of each voxel (M,).
        scaled: Where each voxel is (M, 3), in tolerances.
        voxel_at: Voxel of each sample (h, w), −1 for none; written to.
        joined: The forest of voxels (M,), written to.
    """
    width = voxel_at.shape[1]
    for i in range(len(at)):
        voxel_at[at[i] // width, at[i] % width] = voxel_of[i]
    for r in range(voxel_at.shape[0]):
        for c in range(width):
            here = voxel_at[r, c]
            if here < 0:
                continue
            for before in (voxel_at[r, c - 1] if c else NO_SEGMENT, voxel_at[r - 1, c] if r else NO_SEGMENT):
                if before < 0 or before == here or group[before] != group[here]:
                    continue
                if joined[before] != joined[here] and is_near(scaled, here, before, 1.0):
                    join(joined, here, before)


@njit(nogil=True, cache=True)
def contacts(points: F32, voxel_at: I32, of_voxel: I32, box: I32, tolerance_m: float, tolerance_share: float) -> I64:
    """Return limb · P + body for each contact in image and depth of a piece in no box with a piece of a box.

    Args:
        points: Organised cloud (h, w, 3) [m].
        voxel_at: Voxel of each sample (h, w), −1 for none.
        of_voxel: Piece of each voxel (M,).
        box: Box of each of the P pieces (P,), −1 for none.
        tolerance_m, tolerance_share: Largest step in depth of a contact; see `SegmentLimits`.
    """
    found = np.empty(2 * voxel_at.size, dtype=np.int64)
    n = 0
    for i in range(voxel_at.shape[0]):
        for j in range(voxel_at.shape[1]):
            if voxel_at[i, j] < 0:
                continue
            here, z = of_voxel[voxel_at[i, j]], points[i, j, 2]
            for k, m in ((i, j + 1), (i + 1, j)):
                if k == voxel_at.shape[0] or m == voxel_at.shape[1] or voxel_at[k, m] < 0:
                    continue
                there = of_voxel[voxel_at[k, m]]
                if (box[here] == NO_BOX) == (box[there] == NO_BOX):
                    continue
                if abs(z - points[k, m, 2]) <= max(tolerance_m, tolerance_share * z):
                    limb, body = (here, there) if box[here] == NO_BOX else (there, here)
                    found[n] = np.int64(limb) * len(box) + body
                    n += 1
    return found[:n]


@njit(nogil=True, cache=True)
def stretch(voxel_at: I32, of_voxel: I32, columns_px: I32, rows_px: I32, low: F64, high: F64) -> None:
    """Move the corners `low` and `high` (P, 2) [px] of the pieces' boxes apart until all their samples lie in them."""
    for row in range(voxel_at.shape[0]):
        for column in range(voxel_at.shape[1]):
            if voxel_at[row, column] >= 0:
                piece = of_voxel[voxel_at[row, column]]
                low[piece, 0] = min(low[piece, 0], columns_px[column])
                low[piece, 1] = min(low[piece, 1], rows_px[row])
                high[piece, 0] = max(high[piece, 0], columns_px[column])
                high[piece, 1] = max(high[piece, 1], rows_px[row])


@njit(nogil=True, cache=True)
def renumbered(voxel_at: I32, of_voxel: I32) -> I32:
    """Return what each sample's (h, w) voxel (M,) belongs to, `NO_SEGMENT` where it has none."""
    found = np.empty_like(voxel_at)
    for i in range(voxel_at.shape[0]):
        for j in range(voxel_at.shape[1]):
            found[i, j] = of_voxel[voxel_at[i, j]] if voxel_at[i, j] >= 0 else NO_SEGMENT
    return found


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
