"""The search compared with testing every point: what it saves, and what it misses.

PSPNet-SLAM's Table 2 (docs/reference.md#pspnet-slam).
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from stillroom.dynamics.ants.colony import length_px
from stillroom.dynamics.ants.search import ReverseSearch, SearchResult, Test, exhaustive
from stillroom.geometry.arrays import F64, Bool

T = TypeVar("T")


@dataclass(frozen=True)
class SearchComparison:
    """Sets of points, tested one by one and searched; sums over images.

    Attributes:
        n_images: How many images there are.
        n_points, n_tested: How many points there are, and how many the search tested.
        n_dynamic, n_found, n_wrong: Moving points by exhaustive testing; those of them that the search found; and what
            it found besides.
        path_length_px: Length of the paths [px].
        exhaustive_s, search_s: Time of testing all points, and of the search, its path and memory included [s].
        path_s: Time of laying the path, which is part of the search's [s].
        exhaustive_growing_s, growing_s: Time of growing regions from what the one and the other found [s].
    """

    n_images: int
    n_points: int
    n_tested: int
    n_dynamic: int
    n_found: int
    n_wrong: int
    path_length_px: float
    exhaustive_s: float
    search_s: float
    path_s: float
    exhaustive_growing_s: float = 0.0
    growing_s: float = 0.0

    @property
    def share_tested(self) -> float:
        """Share of the points that the search tested."""
        return self.n_tested / self.n_points if self.n_points else 0.0

    @property
    def recall(self) -> float:
        """Share of the moving points that the search found; 1 where nothing moves."""
        return self.n_found / self.n_dynamic if self.n_dynamic else 1.0

    @property
    def precision(self) -> float:
        """Share of what the search found that moves; 1 where it found nothing."""
        found = self.n_found + self.n_wrong
        return self.n_found / found if found else 1.0

    @property
    def test_s(self) -> float:
        """Time of testing one point [s]."""
        return self.exhaustive_s / max(1, self.n_points)

    @property
    def time_ratio(self) -> float:
        """Time of the search over that of exhaustive testing."""
        return _ratio(self.search_s, self.exhaustive_s)

    @property
    def time_ratio_with_growing(self) -> float:
        """The same with region growing, as DynaSLAM's geometry thread has it (the paper: 0.67–0.87)."""
        return _ratio(self.search_s + self.growing_s, self.exhaustive_s + self.exhaustive_growing_s)


@dataclass(frozen=True)
class PointSet:
    """Points of one image, and the test of which of them move.

    Attributes:
        points_px: The points (N, 2) [px].
        test: Returns which of them move; every search uses it.
        grow: Grows regions from the points that move (N,); None for no growing.
        mask: What a network masked (H, W); none of the points lies there.
    """

    points_px: F64
    test: Test
    grow: Callable[[Bool], object] | None = None
    mask: Bool | None = None


def compare(
    points: PointSet,
    searches: Mapping[str, ReverseSearch],
    repeats: int = 3,
    clock: Callable[[], float] = time.thread_time,
) -> dict[str, SearchComparison]:
    """Test all points one by one, then search; each `repeats` times, of which the fastest counts.

    Args:
        points: The points of an image.
        searches: By name; each keeps what it found for the next image.
        repeats: How often each is timed.
        clock: Returns a time [s]; by default the processor time of this thread.

    Returns:
        A comparison for each search, by name.
    """
    expected, exhaustive_s = _timed(lambda: exhaustive(points.points_px, points.test), repeats, clock)
    growing_s = _growing_s(points, expected, repeats, clock)
    comparisons = {}
    for name, ants in searches.items():
        found, seconds, path = _searched(points, ants, repeats, clock)
        comparisons[name] = SearchComparison(
            n_images=1,
            n_points=len(expected),
            n_tested=int(found.is_tested.sum()),
            n_dynamic=int(expected.sum()),
            n_found=int((expected & found.is_dynamic).sum()),
            n_wrong=int((found.is_dynamic & ~expected).sum()),
            path_length_px=length_px(found.path_px, np.arange(len(found.path_px))),
            exhaustive_s=exhaustive_s,
            search_s=seconds,
            path_s=path,
            exhaustive_growing_s=growing_s,
            growing_s=_growing_s(points, found.is_dynamic, repeats, clock),
        )
    return comparisons


def _searched(
    points: PointSet, ants: ReverseSearch, repeats: int, clock: Callable[[], float]
) -> tuple[SearchResult, float, float]:
    """Return the result of a search, its time with path and memory, and the time of the path alone [s]."""
    _, path_s = _timed(lambda: ants.path.lay(points.points_px), repeats, clock)
    found, search_s = _timed(lambda: ants.search(points.points_px, points.test, points.mask), repeats, clock)
    _, memory_s = _timed(lambda: ants.remember(points.points_px, found), 1, clock)  # once, because it evaporates
    return found, search_s + memory_s, path_s


def _growing_s(points: PointSet, is_dynamic: Bool, repeats: int, clock: Callable[[], float]) -> float:
    """Return the time of growing regions from what moves (N,) [s]."""
    grow = points.grow
    return 0.0 if grow is None else _timed(lambda: grow(is_dynamic), repeats, clock)[1]


def total(parts: Sequence[SearchComparison]) -> SearchComparison:
    """Add up comparisons of several images."""
    sums = {name: sum(getattr(part, name) for part in parts) for name in SearchComparison.__dataclass_fields__}
    return SearchComparison(**sums)


def _ratio(part_s: float, whole_s: float) -> float:
    return part_s / whole_s if whole_s > 0 else float("nan")


def _timed(work: Callable[[], T], repeats: int, clock: Callable[[], float]) -> tuple[T, float]:
    """Return the result of the function and its shortest time [s]."""
    best_s = float("inf")
    for _ in range(max(1, repeats)):
        start_s = clock()
        answer = work()
        best_s = min(best_s, clock() - start_s)
    return answer, best_s
