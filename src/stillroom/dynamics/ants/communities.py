"""Communities of moving points: their convex hulls, and growing these by ΔZ until nothing new is found."""

from typing import NamedTuple

import numpy as np

from stillroom.compiled import njit
from stillroom.geometry.arrays import F64, I64, Bool

NONE = -1
"""The community of a point that is in none."""


@njit(nogil=True, cache=True)
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


@njit(nogil=True, cache=True)
def convex_hull(points_px: F64, is_member: Bool, hull_px: F64) -> int:
    """Write the corners of the convex hull of the members (N,) among points (N, 2); return their number.

    Andrew's monotone chain: the lower side from left to right, the upper one back. The points must be in order: by x,
    and by y where x is the same.
    """
    n, m = 0, len(points_px)
    for side in range(2):
        start = n
        for step in range(m):
            i = step if side == 0 else m - 1 - step
            if not is_member[i]:
                continue
            x, y = points_px[i]
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


@njit(nogil=True, cache=True)
def from_left(points_px: F64, chosen: I64) -> I64:
    """Return chosen points (M,) of all (N, 2) ordered by x, and by y where x is the same."""
    by_y = chosen[np.argsort(points_px[chosen, 1], kind="mergesort")]
    return by_y[np.argsort(points_px[by_y, 0], kind="mergesort")]


class KnownPoints(NamedTuple):
    """What is known of the points (N,) so far.

    Attributes:
        is_tested: Which were tested; what is to be tested next counts as tested.
        is_dynamic: Which of them move.
        community: The community of each, NONE for most.
        is_open: Which communities, by number, have a new point in their band (N + 1,).
    """

    is_tested: Bool
    is_dynamic: Bool
    community: I64
    is_open: Bool


@njit(nogil=True, cache=True)
def widen(points_px: F64, rank: I64, grow_px: float, known: KnownPoints, untested: I64) -> int:
    """Grow all communities as far as what is known leads, and collect what must be tested to lead on.

    A community absorbs all moving points in the band around its hull, and their communities. Moving points in no
    community start a new one, those of the lowest rank first.

    Args:
        points_px: All points (N, 2).
        rank: Order in which points start communities (N,).
        grow_px: ΔZ, the width of the band.
        known: What is known of the points; changes.
        untested: Points around them to test now (N,); filled in.

    Returns:
        How many points are to be tested.
    """
    is_tested, is_dynamic, community, is_open = known
    moving = from_left(points_px, np.flatnonzero(is_dynamic))
    unknown = np.flatnonzero(~is_tested)
    moving_px, unknown_px = points_px[moving], points_px[unknown]
    number = community[moving]
    is_near, is_wanted = np.empty(len(moving), dtype=np.bool_), np.empty(len(unknown), dtype=np.bool_)
    hull_px, n_untested = np.empty((len(moving) + 1, 2)), 0
    n_known = number.max() + 1 if len(moving) > 0 else 0
    n_founded = n_known
    founders = np.argsort(rank[moving], kind="mergesort")
    for step in range(n_known + len(moving)):
        c = step
        if step >= n_known:
            if number[founders[step - n_known]] != NONE:
                continue
            c = n_founded
            n_founded += 1
            number[founders[step - n_known]] = c
        elif not is_open[c]:
            continue
        is_open[c] = False
        n_corners = _gather(moving_px, grow_px, number, is_open, c, is_near, hull_px)
        if n_corners == 0:
            continue
        within(unknown_px, hull_px[:n_corners], grow_px, is_wanted)
        for k in range(len(unknown)):
            if is_wanted[k] and not is_tested[unknown[k]]:
                untested[n_untested] = unknown[k]
                is_tested[unknown[k]] = is_open[c] = True
                n_untested += 1
    community[moving] = number
    return n_untested


@njit(nogil=True, cache=True)
def _gather(points_px: F64, grow_px: float, number: I64, is_open: Bool, c: int, is_near: Bool, hull_px: F64) -> int:
    """Let community `c` absorb all moving points (M, 2) in the band around it, and their communities (M,).

    Returns how many corners its hull has in the end; 0 for one that another has absorbed.
    """
    while True:
        if not np.any(number == c):
            return 0
        n_corners: int = convex_hull(points_px, number == c, hull_px)
        within(points_px, hull_px[:n_corners], grow_px, is_near)
        grew = False
        for i in range(len(number)):
            other = number[i]
            if is_near[i] and other != c:
                grew = True
                number[i] = c
                if other != NONE:
                    is_open[other] = False
                    for k in range(len(number)):
                        if number[k] == other:
                            number[k] = c
        if not grew:
            return n_corners
