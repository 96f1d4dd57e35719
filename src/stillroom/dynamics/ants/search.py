"""The search along the path: points near it are tested, and around what moves the search grows (PSPNet-SLAM III.C)."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numba
import numpy as np

from stillroom.dynamics.ants.path import PathConfig
from stillroom.geometry.arrays import F64, I64, Bool

Test = Callable[[I64], Bool]
"""Tells which of the points, given by number (K,), move (K,)."""


@dataclass(frozen=True)
class ReverseSearchConfig:
    """The reverse ant colony search.

    Attributes:
        path: The path L.
        radius_px: R, how far from a node points are tested [px].
        grow_px: ΔZ, how far around the hull of moving points the search goes on [px].
        min_community: Moving points that a hull needs; fewer are no community, only themselves.
    """

    path: PathConfig = field(default_factory=PathConfig)
    radius_px: float = 26.0
    grow_px: float = 64.0
    min_community: int = 3

    def search(self, points_px: F64, test: Test, seed: int = 0) -> "Found":
        """Lay a path through points (N, 2) [px] and search along it."""
        return search(points_px, self.path.lay(points_px, seed), test, self)


@dataclass(frozen=True)
class Found:
    """What the search came upon, for N points.

    Attributes:
        is_dynamic: Which points move (N,).
        is_tested: Which were tested (N,).
        path_px: The nodes Kᵢ in order (n, 2) [px].
        hulls: Corners (k, 2) [px] of each community's convex hull.
        members: Numbers of the moving points of each community.
    """

    is_dynamic: Bool
    is_tested: Bool
    path_px: F64
    hulls: tuple[F64, ...] = field(repr=False)
    members: tuple[I64, ...] = field(repr=False)

    @property
    def share_tested(self) -> float:
        """Share of the points that were tested."""
        return float(self.is_tested.mean()) if len(self.is_tested) else 0.0


def exhaustive(points_px: F64, test: Test) -> Bool:
    """Test every point (N, 2), as DynaSLAM does; return which move (N,)."""
    return test(np.arange(len(points_px), dtype=np.int64))


def search(points_px: F64, path_px: F64, test: Test, config: ReverseSearchConfig) -> Found:
    """Go along the path; at a node test what lies within R, and grow around what moves until nothing new is found.

    All that lies near any node is tested sooner or later, and the order changes no verdict; so it is tested at once,
    which spares calls. The order of the nodes decides in which order communities are found, nothing else.

    Args:
        points_px: Points (N, 2) [px].
        path_px: The nodes in order (n, 2) [px].
        test: Tells which points move; asked of each point at most once.
        config: R and ΔZ.
    """
    points_px = np.ascontiguousarray(points_px, dtype=np.float64)
    node = np.full(len(points_px), -1, dtype=np.int64)
    first_node_near(points_px, path_px, config.radius_px, node)
    is_tested = node >= 0
    is_dynamic = np.zeros(len(points_px), dtype=np.bool_)
    near = np.flatnonzero(is_tested)
    if len(near):
        is_dynamic[near] = test(near)
    in_community = np.zeros(len(points_px), dtype=np.bool_)
    hulls, communities = [], []
    hits = np.flatnonzero(is_dynamic)
    for k in np.unique(node[hits]):
        seeds = hits[(node[hits] == k) & ~in_community[hits]]
        if len(seeds) == 0:
            continue
        members, hull_px = _grow(points_px, seeds, test, config.grow_px, is_tested, is_dynamic)
        in_community[members] = True
        if len(members) >= config.min_community:
            hulls.append(hull_px)
            communities.append(members)
    return Found(is_dynamic, is_tested, path_px, tuple(hulls), tuple(communities))


def _grow(points_px: F64, seeds: I64, test: Test, grow_px: float, is_tested: Bool, is_dynamic: Bool) -> tuple[I64, F64]:
    """Widen the hull of moving points by ΔZ until that finds no new one; return its members and corners.

    Args:
        points_px: All points (N, 2).
        seeds: Those that were found to move.
        test: The test.
        grow_px: ΔZ.
        is_tested, is_dynamic: What is known of all points (N,); what the search finds out is entered.
    """
    is_member = np.zeros(len(points_px), dtype=np.bool_)
    is_member[seeds] = True
    hull_px, untested = np.empty((len(points_px) + 1, 2)), np.empty(len(points_px), dtype=np.int64)
    while True:
        n_untested, n_corners = widen(points_px, grow_px, is_tested, is_dynamic, is_member, untested, hull_px)
        if n_untested == 0:
            return np.flatnonzero(is_member), hull_px[:n_corners].copy()
        is_dynamic[untested[:n_untested]] = test(untested[:n_untested])


@numba.njit(nogil=True, cache=True)
def first_node_near(points_px: F64, nodes_px: F64, radius_px: float, node: I64) -> None:
    """Write for each point (N, 2) the first node (n, 2) of the path that is at most a radius away; −1 for none."""
    for i in range(len(points_px)):
        node[i] = -1
        for k in range(len(nodes_px)):
            dx, dy = points_px[i, 0] - nodes_px[k, 0], points_px[i, 1] - nodes_px[k, 1]
            if dx * dx + dy * dy <= radius_px * radius_px:
                node[i] = k
                break


@numba.njit(nogil=True, cache=True)
def within(points_px: F64, hull_px: F64, margin_px: float, is_near: Bool) -> None:
    """Write which points (N, 2) lie in a convex hull (k, 2), or at most a margin beside it."""
    low_x, high_x = hull_px[:, 0].min() - margin_px, hull_px[:, 0].max() + margin_px
    low_y, high_y = hull_px[:, 1].min() - margin_px, hull_px[:, 1].max() + margin_px
    n = len(hull_px)
    for i in range(len(points_px)):
        x, y = points_px[i]
        is_near[i] = False
        if not (low_x <= x <= high_x and low_y <= y <= high_y):
            continue
        n_left, n_right, nearest2 = 0, 0, np.inf
        for k in range(n):
            ax, ay = hull_px[k]
            bx, by = hull_px[(k + 1) % n]
            ex, ey, px, py = bx - ax, by - ay, x - ax, y - ay
            cross = ex * py - ey * px
            n_left += cross >= 0.0
            n_right += cross <= 0.0
            along = min(1.0, max(0.0, (px * ex + py * ey) / max(ex * ex + ey * ey, 1e-12)))
            dx, dy = px - along * ex, py - along * ey
            nearest2 = min(nearest2, dx * dx + dy * dy)
        inside = n >= 3 and (n_left == n or n_right == n)
        is_near[i] = inside or nearest2 <= margin_px * margin_px


@numba.njit(nogil=True, cache=True)
def convex_hull(points_px: F64, is_member: Bool, hull_px: F64) -> int:
    """Write the corners of the convex hull of the members (N,) among points (N, 2); return their number.

    Andrew's monotone chain: the lower side from left to right, the upper one back.
    """
    members = np.flatnonzero(is_member)
    for axis in (1, 0):  # by x, and by y where x is the same
        members = members[np.argsort(points_px[members, axis], kind="mergesort")]
    n, m = 0, len(members)
    for side in range(2):
        start = n
        for step in range(m):
            x, y = points_px[members[step] if side == 0 else members[m - 1 - step]]
            while n >= start + 2:
                ax, ay, bx, by = hull_px[n - 2, 0], hull_px[n - 2, 1], hull_px[n - 1, 0], hull_px[n - 1, 1]
                if (bx - ax) * (y - ay) - (by - ay) * (x - ax) > 0.0:
                    break
                n -= 1
            hull_px[n, 0], hull_px[n, 1] = x, y
            n += 1
        n -= 1  # the last corner of a side is the first of the other
    if n == 2 and hull_px[0, 0] == hull_px[1, 0] and hull_px[0, 1] == hull_px[1, 1]:
        n = 1  # all in one place
    return max(1, n)


@numba.njit(nogil=True, cache=True)
def widen(
    points_px: F64, grow_px: float, is_tested: Bool, is_dynamic: Bool, is_member: Bool, untested: I64, hull_px: F64
) -> tuple[int, int]:
    """Grow a community by the moving points around it, until an untested one is among those around it, or none.

    Args:
        points_px: All points (N, 2).
        grow_px: ΔZ.
        is_tested, is_dynamic: What is known of them (N,); what is to be tested counts as tested from here on.
        is_member: The community (N,); grows.
        untested: Points around it to test now; filled in.
        hull_px: Corners of its hull (at most N + 1, 2); filled in.

    Returns:
        How many points are to be tested; how many corners the hull has.
    """
    is_near = np.empty(len(points_px), dtype=np.bool_)
    while True:
        n_corners = convex_hull(points_px, is_member, hull_px)
        within(points_px, hull_px[:n_corners], grow_px, is_near)
        n_untested, grew = 0, False
        for i in range(len(points_px)):
            if is_near[i] and not is_tested[i]:
                untested[n_untested] = i
                is_tested[i] = True
                n_untested += 1
            elif is_near[i] and is_dynamic[i] and not is_member[i]:
                is_member[i] = grew = True
        if n_untested > 0 or not grew:
            return n_untested, n_corners
