"""Communities of moving points: their convex hulls, and growing these by ΔZ until nothing new is found."""

import numba
import numpy as np

from stillroom.geometry.arrays import F64, I64, Bool

NONE = -1
"""The community of a point that is in none."""


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
def convex_hull(points_px: F64, from_left: I64, is_member: Bool, hull_px: F64) -> int:
    """Write the corners of the convex hull of the members (N,) among points (N, 2); return their number.

    Andrew's monotone chain: the lower side from left to right, the upper one back. The points' order `from_left` (N,)
    is by x, and by y where x is the same.
    """
    n, m = 0, len(from_left)
    for side in range(2):
        start = n
        for step in range(m):
            i = from_left[step] if side == 0 else from_left[m - 1 - step]
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


@numba.njit(nogil=True, cache=True)
def widen(
    points_px: F64,
    order: I64,
    from_left: I64,
    grow_px: float,
    is_tested: Bool,
    is_dynamic: Bool,
    community: I64,
    is_open: Bool,
    untested: I64,
) -> int:
    """Grow all communities as far as what is known leads, and collect what must be tested to lead on.

    A community takes up whatever moves in the band around its hull, other communities with all that they have. Points
    that move and are in none found one, in a given order.

    Args:
        points_px: All points (N, 2).
        order: The points in the order in which they found communities (N,).
        from_left: The points from left to right; see `convex_hull`.
        grow_px: ΔZ, the width of the band.
        is_tested, is_dynamic: What is known of the points (N,); what is to be tested counts as tested from here on.
        community: Of each point (N,), NONE for most; changes.
        is_open: Which communities, by number, have something new in their band (N,); changes.
        untested: Points around them to test now (N,); filled in.

    Returns:
        How many points are to be tested.
    """
    n = len(points_px)
    is_near, is_member = np.empty(n, dtype=np.bool_), np.empty(n, dtype=np.bool_)
    hull_px, n_untested = np.empty((n + 1, 2)), 0
    n_known = community.max() + 1 if n > 0 else 0
    n_founded = n_known
    for step in range(n_known + n):
        c = step
        if step < n_known:
            if not is_open[c]:
                continue
        else:
            i = order[step - n_known]
            if not is_dynamic[i] or community[i] != NONE:
                continue
            c = n_founded
            n_founded += 1
            community[i] = c
        is_open[c] = False
        if not _gather(points_px, from_left, grow_px, is_dynamic, community, is_open, c, is_member, is_near, hull_px):
            continue
        for i in range(n):
            if is_near[i] and not is_tested[i]:
                untested[n_untested] = i
                is_tested[i] = is_open[c] = True
                n_untested += 1
    return n_untested


@numba.njit(nogil=True, cache=True)
def _gather(
    points_px: F64,
    from_left: I64,
    grow_px: float,
    is_dynamic: Bool,
    community: I64,
    is_open: Bool,
    c: int,
    is_member: Bool,
    is_near: Bool,
    hull_px: F64,
) -> bool:
    """Let community `c` take up all known moving points in the band around it, again and again.

    Writes which points lie in the band in the end. Returns False for one that another has taken up.
    """
    grew = True
    while grew:
        if not _members(community, c, is_member):
            return False
        n_corners = convex_hull(points_px, from_left, is_member, hull_px)
        within(points_px, hull_px[:n_corners], grow_px, is_near)
        grew = _take_up(c, is_near, is_dynamic, community, is_open)
    return True


@numba.njit(nogil=True, cache=True)
def _members(community: I64, c: int, is_member: Bool) -> bool:
    """Write which points (N,) are in community `c`; tell whether any is."""
    any_is = False
    for i in range(len(community)):
        is_member[i] = community[i] == c
        any_is |= is_member[i]
    return any_is


@numba.njit(nogil=True, cache=True)
def _take_up(c: int, is_near: Bool, is_dynamic: Bool, community: I64, is_open: Bool) -> bool:
    """Make community `c` of what moves among the near points (N,), and of what is in a community with such a point."""
    grew = False
    for i in range(len(community)):
        other = community[i]
        if is_near[i] and is_dynamic[i] and other != c:
            grew = True
            community[i] = c
            if other != NONE:
                is_open[other] = False
                for k in range(len(community)):
                    if community[k] == other:
                        community[k] = c
    return grew
