"""The search along the path: points near it are tested, and around what moves the search grows (PSPNet-SLAM III.C)."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from stillroom.bounds import bounded
from stillroom.compiled import njit
from stillroom.dynamics.ants.colony import STEP, ColonyConfig, PathConfig
from stillroom.dynamics.ants.communities import NONE, KnownPoints, convex_hull, from_left, widen
from stillroom.geometry.arrays import F64, I64, Bool

GRID = 128
"""Cells of the pheromone map a side; points beyond count in the last."""
MASK_STEP_PX = 8
"""Stride in rows and columns at which a mask is read [px]."""
Test = Callable[[I64], Bool]
"""Returns which of the points, given by number (K,), move (K,)."""
ALL, REVERSE_ANTS = "all", "reverse-ants"
SEARCHES = ALL, REVERSE_ANTS
"""Which points a geometry tests: every one, or those that the ants come to."""


# The pheromone map: where points moved in the last images, and what a network masked in this one.


@dataclass(frozen=True)
class PheromoneMapConfig:
    """The pheromone map: cells that are searched first, because points moved there in the last images.

    Attributes:
        enabled: Whether it is used. If not, every image is searched as if it were the first.
        cell_px: Side of a cell of the image [px].
        reach: How many cells around moving points, and around masked pixels, are marked too: what a network misses of a
            person lies beside what it masked.
        rho: Share of the pheromone that evaporates from image to image (ρ of Eq. 14).
        least: Cells with less pheromone than this are left to the path.
    """

    enabled: bool = True
    cell_px: int = bounded(24, least=1, pixels=1)
    reach: int = 1
    rho: float = 0.3
    least: float = 0.3


class PheromoneMap:
    """Pheromone by cells of the image, 1 where points moved in the last image."""

    def __init__(self, config: PheromoneMapConfig) -> None:
        """Start with pheromone everywhere: in the first image all points are tested."""
        self.config = config
        self._strength = np.ones((GRID, GRID))

    def mark(self, points_px: F64, mask: Bool | None, is_marked: Bool) -> None:
        """Mark the points (N, 2) in cells with pheromone, (N,), or near a mask (H, W)."""
        config, strength = self.config, self._strength
        if not config.enabled:
            return
        if mask is not None:
            strength = strength.copy()
            renew_by_mask(mask[::MASK_STEP_PX, ::MASK_STEP_PX], strength, config.cell_px / MASK_STEP_PX, config.reach)
        smell(points_px, strength, config.cell_px, config.least, is_marked)

    def leave(self, points_px: F64) -> None:
        """Let the pheromone evaporate, and renew it around moving points (M, 2)."""
        self._strength *= 1.0 - self.config.rho
        renew(points_px, self._strength, self.config.cell_px, self.config.reach)


@njit(nogil=True, cache=True)
def smell(points_px: F64, strength: F64, cell_px: int, least: float, is_marked: Bool) -> None:
    """Mark the points (N, 2) in cells of at least a strength; the others are left as they are."""
    for i in range(len(points_px)):
        column = min(max(int(points_px[i, 0] / cell_px), 0), strength.shape[1] - 1)
        row = min(max(int(points_px[i, 1] / cell_px), 0), strength.shape[0] - 1)
        if strength[row, column] >= least:
            is_marked[i] = True


@njit(nogil=True, cache=True)
def renew(points_px: F64, strength: F64, cell_px: int, reach: int) -> None:
    """Set the strength of the cells of points (M, 2), and of those within `reach`, to 1."""
    height, width = strength.shape
    for i in range(len(points_px)):
        column = min(max(int(points_px[i, 0] / cell_px), 0), width - 1)
        row = min(max(int(points_px[i, 1] / cell_px), 0), height - 1)
        strength[max(0, row - reach) : row + reach + 1, max(0, column - reach) : column + reach + 1] = 1.0


@njit(nogil=True, cache=True)
def renew_by_mask(mask: Bool, strength: F64, cell: float, reach: int) -> None:
    """Set the strength of the cells of masked pixels (h, w), and of those within `reach`, to 1; `cell` is in pixels."""
    height, width = strength.shape
    for v in range(mask.shape[0]):
        for u in range(mask.shape[1]):
            if mask[v, u]:
                row, column = min(int(v / cell), height - 1), min(int(u / cell), width - 1)
                strength[max(0, row - reach) : row + reach + 1, max(0, column - reach) : column + reach + 1] = 1.0


@dataclass(frozen=True)
class ReverseSearchConfig:
    """The reverse ant colony search.

    Attributes:
        path: The path L.
        radius_px: R, how far from a node points are tested [px].
        grow_px: ΔZ, how far the hull of moving points is dilated in each step [px].
        min_community: Fewest moving points of a community.
        scent: The pheromone map: where points moved in the last images.
    """

    path: PathConfig = field(default_factory=PathConfig)
    radius_px: float = bounded(14.0, least=0, pixels=1)
    grow_px: float = bounded(32.0, least=0, pixels=1)
    min_community: int = 3
    scent: PheromoneMapConfig = field(default_factory=PheromoneMapConfig)

    def build(self, seed: int = 0) -> "ReverseSearch":
        """Return the search; the seed is that of the ants.

        Raises:
            ConfigError: There is no such kind of path.
        """
        return ReverseSearch(self, seed)

    def search(self, points_px: F64, test: Test, seed: int = 0) -> "SearchResult":
        """Search points (N, 2) [px] along the path alone, without a pheromone map."""
        return search(points_px, self.path.build(seed).lay(points_px), test, self)


def papers_search() -> ReverseSearchConfig:
    """Return the search as the paper prints it: a path by ants who lay pheromone at each step, and no pheromone map.

    The cells from which the nodes are made do not shift. The paper gives no numbers: R, ΔZ and the colony's are ours.
    """
    colony = ColonyConfig(deposit=STEP)
    path = PathConfig(kind="ants", shifts=False, colony=colony)
    return ReverseSearchConfig(path=path, scent=PheromoneMapConfig(enabled=False))


@dataclass(frozen=True)
class SearchResult:
    """The result of the search, for N points.

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


class ReverseSearch:
    """Searches image after image; where points moved, the next image is searched first."""

    def __init__(self, config: ReverseSearchConfig, seed: int = 0) -> None:
        """Start without earlier images."""
        self.config = config
        self.path = config.path.build(seed)
        self.scent = PheromoneMap(config.scent)

    def search(self, points_px: F64, test: Test, mask: Bool | None = None) -> SearchResult:
        """Go along a path through points (N, 2) [px], none of which lies in the mask (H, W); see the function `search`.

        Changes nothing that is remembered.
        """
        points_px = np.ascontiguousarray(points_px, dtype=np.float64)
        marked = np.zeros(len(points_px), dtype=np.bool_)
        self.scent.mark(points_px, mask, marked)
        return search(points_px, self.path.lay(points_px), test, self.config, marked)

    def remember(self, points_px: F64, found: SearchResult) -> None:
        """Update the pheromone map with what was found of points (N, 2), for the next image."""
        self.path.remember()
        self.scent.leave(np.ascontiguousarray(points_px[found.is_dynamic], dtype=np.float64))


def exhaustive(points_px: F64, test: Test) -> Bool:
    """Test every point (N, 2), as DynaSLAM does; return which move (N,)."""
    return test(np.arange(len(points_px), dtype=np.int64))


def communities_of(points_px: F64, is_dynamic: Bool, config: ReverseSearchConfig) -> SearchResult:
    """Return the communities of points (N, 2) that are all known."""
    again = config.search(points_px, lambda which: is_dynamic[which])
    return SearchResult(is_dynamic, np.ones(len(points_px), dtype=np.bool_), again.path_px, again.hulls, again.members)


def search(
    points_px: F64, path_px: F64, test: Test, config: ReverseSearchConfig, marked: Bool | None = None
) -> SearchResult:
    """Go along the path; at a node test what lies within R, and grow around what moves until nothing new is found.

    All that lies near any node is tested eventually, and the order changes no result; so it is tested at once, which
    saves calls, and so are the bands around all communities. The order of the nodes only decides the order of the
    communities.

    Args:
        points_px: Points (N, 2) [px].
        path_px: The nodes in order (n, 2) [px].
        test: Returns which points move; called for each point at most once.
        config: R and ΔZ.
        marked: Points (N,) that are tested wherever the path leads.
    """
    n = len(points_px)
    points_px = np.ascontiguousarray(points_px, dtype=np.float64)
    node = np.full(n, len(path_px), dtype=np.int64)
    first_node_near(points_px, path_px, config.radius_px, node)
    is_tested = node < len(path_px)
    if marked is not None:
        is_tested |= marked
    is_dynamic, is_open = np.zeros(n, dtype=np.bool_), np.zeros(n + 1, dtype=np.bool_)
    community, untested = np.full(n, NONE, dtype=np.int64), np.flatnonzero(is_tested)
    wanted, known = np.empty(n, dtype=np.int64), KnownPoints(is_tested, is_dynamic, community, is_open)
    while len(untested):
        is_dynamic[untested] = test(untested)
        n_wanted = widen(points_px, node, config.grow_px, known, wanted)
        untested = wanted[:n_wanted].copy()
    hulls, members = _communities(points_px, community, config.min_community)
    return SearchResult(is_dynamic, is_tested, path_px, hulls, members)


def _communities(points_px: F64, community: I64, least: int) -> tuple[tuple[F64, ...], tuple[I64, ...]]:
    """Return hulls and members of the communities (N,) that have at least `least` points."""
    grouped = from_left(points_px, np.flatnonzero(community != NONE))
    number, hull_px = community[grouped], np.empty((len(grouped) + 1, 2))
    hulls, members = [], []
    for c in np.flatnonzero(np.bincount(number) >= least) if len(grouped) else ():
        n_corners = convex_hull(points_px[grouped], number == c, hull_px)
        hulls.append(hull_px[:n_corners].copy())
        members.append(np.sort(grouped[number == c]))
    return tuple(hulls), tuple(members)


@njit(nogil=True, cache=True)
def first_node_near(points_px: F64, nodes_px: F64, radius_px: float, node: I64) -> None:
    """Write for each point (N, 2) the first node (n, 2) of the path at most a radius away; others are left."""
    for i in range(len(points_px)):
        for k in range(len(nodes_px)):
            dx, dy = points_px[i, 0] - nodes_px[k, 0], points_px[i, 1] - nodes_px[k, 1]
            if dx * dx + dy * dy <= radius_px * radius_px:
                node[i] = k
                break
