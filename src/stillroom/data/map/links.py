"""Kernels on the lists of observations. Rows are rows of `KeypointTable`, points rows of `PointTable`."""

from typing import NamedTuple

import numpy as np

from stillroom.compiled import njit
from stillroom.geometry.arrays import F32, F64, I32, I64, U64, Bool
from stillroom.geometry.hamming import popcount64

MAX_DESCRIPTORS = 20
"""Newest observations among which a point's typical descriptor is chosen; keeps the cost of old points bounded."""


class Links(NamedTuple):
    """The observations of all points, as linked lists.

    Attributes:
        point: The point that each row sees (R,), −1 for none.
        next_row: The row that saw the same point before (R,), −1 for none.
        keyframe: The keyframe of each row (R,).
        first_row: The newest row of each point's list (P,), −1 for none.
    """

    point: I32
    next_row: I32
    keyframe: I32
    first_row: I32


class Counts(NamedTuple):
    """Observations of each point (P,), where one with depth counts twice; and the number of keyframes that see it."""

    n_observations: I32
    n_keyframes: I32


class Unsaved(NamedTuple):
    """Which points (P,) and whose keyframes' (K,) observations changed since the map was last written to disk."""

    points: Bool
    keyframes: Bool


class Viewing(NamedTuple):
    """Where each point lies (P, 3) [m, world], its mean viewing direction (P, 3), and from how far it is found [m]."""

    position_m: F64
    normal: F64
    min_distance_m: F64
    max_distance_m: F64


@njit(nogil=True, cache=True)
def link(points: I32, rows: I64, links: Links, row_right_px: F32, counts: Counts, unsaved: Unsaved) -> int:
    """Link each row to its point, unless it has one already or its keyframe sees the point; count the links."""
    linked = 0
    for i in range(len(points)):
        unsaved.points[points[i]] = True
        unsaved.keyframes[links.keyframe[rows[i]]] = True
        linked += link_one(points[i], rows[i], links, row_right_px, counts)
    return linked


@njit(nogil=True, cache=True)
def link_one(point: int, row: int, links: Links, row_right_px: F32, counts: Counts) -> bool:
    """Link a row to a point; return whether neither the row has one already, nor its keyframe sees the point."""
    if links.point[row] >= 0:
        return False
    other = links.first_row[point]
    while other >= 0:
        if links.keyframe[other] == links.keyframe[row]:
            return False
        other = links.next_row[other]
    links.point[row] = point
    links.next_row[row] = links.first_row[point]
    links.first_row[point] = row
    counts.n_observations[point] += 2 if row_right_px[row] >= 0 else 1
    counts.n_keyframes[point] += 1
    return True


@njit(nogil=True, cache=True)
def unlink(rows: I64, links: Links, row_right_px: F32, counts: Counts, unsaved: Unsaved) -> None:
    """Remove the link of each row."""
    row_point, row_next, row_keyframe, first_row = links
    n_observations, n_keyframes = counts
    for i in range(len(rows)):
        row = rows[i]
        point = row_point[row]
        if point < 0:
            continue
        unsaved.points[point] = True
        # Other keyframes' rows of the point change too: the next of a list steps up to where one leaves.
        before, other = -1, first_row[point]
        while other >= 0:
            unsaved.keyframes[row_keyframe[other]] = True
            if row_next[other] == row:
                before = other
            other = row_next[other]
        if before < 0:
            first_row[point] = row_next[row]
        else:
            row_next[before] = row_next[row]
        row_point[row] = -1
        row_next[row] = -1
        n_observations[point] -= 2 if row_right_px[row] >= 0 else 1
        n_keyframes[point] -= 1


@njit(nogil=True, cache=True)
def relink(old: I64, new: I64, links: Links, row_right_px: F32, counts: Counts, unsaved: Unsaved) -> None:
    """Move the links of old points (N,) to new ones (N,), none of which is an old one, newest first."""
    for i in range(len(old)):
        unsaved.points[old[i]] = unsaved.points[new[i]] = True
        row = links.first_row[old[i]]
        links.first_row[old[i]] = -1
        counts.n_observations[old[i]] = counts.n_keyframes[old[i]] = 0
        while row >= 0:
            following = links.next_row[row]
            unsaved.keyframes[links.keyframe[row]] = True
            links.point[row] = links.next_row[row] = -1
            link_one(new[i], row, links, row_right_px, counts)
            row = following


class Found(NamedTuple):
    """How often each point (P,) should have been found and was, whether it is alive, and which point replaced it."""

    n_visible: I32
    n_found: I32
    is_alive: Bool
    replaced_by: I32


@njit(nogil=True, cache=True)
def replace(
    old: I64, new: I64, links: Links, row_right_px: F32, counts: Counts, unsaved: Unsaved, found: Found
) -> None:
    """Move all that is known of old points (N,) to new ones (N,), none of which is an old one; the old ones die."""
    relink(old, new, links, row_right_px, counts, unsaved)
    for i in range(len(old)):
        found.n_visible[new[i]] += found.n_visible[old[i]]
        found.n_found[new[i]] += found.n_found[old[i]]
        found.is_alive[old[i]] = False
        found.replaced_by[old[i]] = new[i]


@njit(nogil=True, cache=True)
def join(
    points: I32, rows: I64, links: Links, row_right_px: F32, counts: Counts, unsaved: Unsaved, found: Found
) -> None:
    """Let rows (N,) of a keyframe observe points (N,), which it does not see; or join these with those the rows see.

    Of two points the one with more observations stays. No point and no row comes twice.
    """
    n = 0
    other, old, new = np.empty(len(rows), np.int32), np.empty(len(rows), np.int64), np.empty(len(rows), np.int64)
    for i in range(len(rows)):
        other[i] = links.point[rows[i]]
        if other[i] < 0:
            unsaved.points[points[i]] = unsaved.keyframes[links.keyframe[rows[i]]] = True
            link_one(points[i], rows[i], links, row_right_px, counts)
    for i in range(len(rows)):
        if other[i] >= 0:
            weaker = counts.n_observations[points[i]] <= counts.n_observations[other[i]]
            old[n], new[n] = (points[i], other[i]) if weaker else (other[i], points[i])
            n += 1
    replace(old[:n], new[:n], links, row_right_px, counts, unsaved, found)


@njit(nogil=True, cache=True)
def gather(points: I32, row_next: I32, first_row: I32, n_keyframes: I32) -> tuple[I32, I32]:
    """Return for all observations of the points: place in `points` (M,), row (M,); newest first within a point."""
    total = 0
    for i in range(len(points)):
        total += n_keyframes[points[i]]
    place = np.empty(total, np.int32)
    rows = np.empty(total, np.int32)
    n = 0
    for i in range(len(points)):
        row = first_row[points[i]]
        while row >= 0:
            place[n] = i
            rows[n] = row
            n += 1
            row = row_next[row]
    return place, rows


@njit(nogil=True, cache=True)
def count_by_keyframe(points: I32, row_next: I32, first_row: I32, row_keyframe: I32, n_keyframes: int) -> I32:
    """Count in how many of the points each keyframe shares, (K,)."""
    counts = np.zeros(n_keyframes, np.int32)
    for i in range(len(points)):
        if points[i] < 0:
            continue
        row = first_row[points[i]]
        while row >= 0:
            counts[row_keyframe[row]] += 1
            row = row_next[row]
    return counts


@njit(nogil=True, cache=True)
def current_ids(points: I32, is_alive: Bool, replaced_by: I32) -> I32:
    """Return the points that replaced points (N,), which may be −1; −1 for those that were removed."""
    ids = points.copy()
    for i in range(len(ids)):
        while ids[i] >= 0 and not is_alive[ids[i]]:
            ids[i] = replaced_by[ids[i]]
    return ids


@njit(nogil=True, cache=True)
def oldest_rows(points: I32, row_next: I32, first_row: I32) -> I32:
    """Return the row (N,) that saw each point (N,) first; −1 for a point that nothing sees. Lists run to the oldest."""
    rows = np.empty(len(points), np.int32)
    for i in range(len(points)):
        row = first_row[points[i]]
        rows[i] = row
        while row >= 0:
            rows[i] = row
            row = row_next[row]
    return rows


@njit(nogil=True, cache=True)
def typical_descriptors(points: I32, row_next: I32, first_row: I32, words: U64, chosen: I32) -> None:
    """Choose for each point the row whose descriptor has the least median distance to the others.

    Args:
        points: Points (N,).
        row_next, first_row: The lists of observations.
        words: Descriptors of the rows as (R, 4) uint64.
        chosen: Receives the rows (N,); −1 for a point that nothing sees.
    """
    rows = np.empty(MAX_DESCRIPTORS, np.int32)
    distances = np.empty((MAX_DESCRIPTORS, MAX_DESCRIPTORS), np.int32)
    nearest = np.empty(MAX_DESCRIPTORS, np.int32)
    for i in range(len(points)):
        n = 0
        row = first_row[points[i]]
        while row >= 0 and n < MAX_DESCRIPTORS:
            rows[n] = row
            n += 1
            row = row_next[row]
        chosen[i] = rows[0] if n > 0 else -1
        if n < 3:
            continue
        for a in range(n):
            distances[a, a] = 0
            for b in range(a + 1, n):
                d = 0
                for w in range(4):
                    d += popcount64(words[rows[a], w] ^ words[rows[b], w])
                distances[a, b] = d
                distances[b, a] = d
        best = 1 << 30
        for a in range(n):
            median = kth_smallest(distances[a], n, (n - 1) // 2, nearest)
            if median < best:
                best = median
                chosen[i] = rows[a]


@njit(nogil=True, cache=True)
def kth_smallest(values: I32, n: int, k: int, smallest: I32) -> int:
    """Return what stands at place `k` of the first `n` values in order; `smallest` is scratch for more than `k`."""
    kept = 0
    for i in range(n):
        value = values[i]
        if kept > k:
            if value >= smallest[k]:
                continue
            kept = k
        at = kept
        while at > 0 and smallest[at - 1] > value:
            smallest[at] = smallest[at - 1]
            at -= 1
        smallest[at] = value
        kept += 1
    found: int = smallest[k]
    return found


@njit(nogil=True, cache=True)
def viewing_geometry(
    points: I32, links: Links, row_octave: I32, T_world_cam: F64, scale_factors: F64, seen: Viewing
) -> None:
    """Update the mean viewing direction and the distances at which each point can be found again.

    The oldest observation sets the scale, as ORB-SLAM2's reference keyframe does.
    """
    _, row_next, row_keyframe, first_row = links
    positions_m, normals, min_distance_m, max_distance_m = seen
    for i in range(len(points)):
        p = points[i]
        row = first_row[p]
        if row < 0:
            continue
        nx, ny, nz = 0.0, 0.0, 0.0
        distance, octave = 0.0, 0
        while row >= 0:
            k = row_keyframe[row]
            dx = positions_m[p, 0] - T_world_cam[k, 0, 3]
            dy = positions_m[p, 1] - T_world_cam[k, 1, 3]
            dz = positions_m[p, 2] - T_world_cam[k, 2, 3]
            distance = np.sqrt(dx * dx + dy * dy + dz * dz) + 1e-12
            octave = row_octave[row]
            nx += dx / distance
            ny += dy / distance
            nz += dz / distance
            row = row_next[row]
        length = np.sqrt(nx * nx + ny * ny + nz * nz) + 1e-12
        normals[p, 0], normals[p, 1], normals[p, 2] = nx / length, ny / length, nz / length
        max_distance_m[p] = distance * (scale_factors[octave] / scale_factors[0])
        min_distance_m[p] = max_distance_m[p] / (scale_factors[-1] / scale_factors[0])
