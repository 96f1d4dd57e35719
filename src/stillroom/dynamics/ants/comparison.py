"""What the search saves, and what it misses, against testing every point (PSPNet-SLAM, Table 2)."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from stillroom.dynamics.ants.colony import length_px
from stillroom.dynamics.ants.search import ReverseSearchConfig, Test, exhaustive, search
from stillroom.geometry.arrays import F64

T = TypeVar("T")


@dataclass(frozen=True)
class SearchComparison:
    """One set of points, tested one by one and searched.

    Attributes:
        n_points, n_tested: How many points there are, and how many the search tested.
        n_dynamic, n_found, n_wrong: Moving points by exhaustive testing; those of them that the search found; and what
            it found besides.
        path_length_px: Length of the path [px].
        exhaustive_s, path_s, search_s: Time of testing all points, of laying the path, and of searching along it [s].
        test_s: Time of testing one point [s].
    """

    n_points: int
    n_tested: int
    n_dynamic: int
    n_found: int
    n_wrong: int
    path_length_px: float
    exhaustive_s: float
    path_s: float
    search_s: float
    test_s: float

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
    def time_ratio(self) -> float:
        """Time of the search, its path included, over that of exhaustive testing (the paper: 0.67–0.87)."""
        return (self.path_s + self.search_s) / self.exhaustive_s if self.exhaustive_s > 0 else float("nan")


def compare(
    points_px: F64,
    test: Test,
    config: ReverseSearchConfig,
    seed: int = 0,
    repeats: int = 3,
    clock: Callable[[], float] = time.thread_time,
) -> SearchComparison:
    """Test all points (N, 2) one by one, then search; both `repeats` times, of which the fastest counts.

    Args:
        points_px: The points [px].
        test: Tells which of them move; both ways go through it.
        config: The search.
        seed: Of the ants.
        repeats: How often each is timed.
        clock: Returns a time [s]; by default the processor time of this thread.
    """
    expected, exhaustive_s = _timed(lambda: exhaustive(points_px, test), repeats, clock)
    path_px, path_s = _timed(lambda: config.path.lay(points_px, seed), repeats, clock)
    found, search_s = _timed(lambda: search(points_px, path_px, test, config), repeats, clock)
    return SearchComparison(
        n_points=len(points_px),
        n_tested=int(found.is_tested.sum()),
        n_dynamic=int(expected.sum()),
        n_found=int((expected & found.is_dynamic).sum()),
        n_wrong=int((found.is_dynamic & ~expected).sum()),
        path_length_px=length_px(path_px, np.arange(len(path_px))),
        exhaustive_s=exhaustive_s,
        path_s=path_s,
        search_s=search_s,
        test_s=exhaustive_s / max(1, len(points_px)),
    )


def total(parts: list[SearchComparison]) -> SearchComparison:
    """Add up comparisons of several images; the time of one test is that of all tests over their number."""
    sums = {name: sum(getattr(part, name) for part in parts) for name in SearchComparison.__dataclass_fields__}
    sums["test_s"] = sums["exhaustive_s"] / max(1, sums["n_points"])
    return SearchComparison(**sums)


def _timed(work: Callable[[], T], repeats: int, clock: Callable[[], float]) -> tuple[T, float]:
    """Return the answer of the work and the shortest time that it took [s]."""
    best_s = float("inf")
    for _ in range(max(1, repeats)):
        start_s = clock()
        answer = work()
        best_s = min(best_s, clock() - start_s)
    return answer, best_s
