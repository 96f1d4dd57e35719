"""The map as dictionaries and lists: slow, obvious, and what the linked lists must agree with."""

from dataclasses import dataclass, field


@dataclass
class NaiveMap:
    """Who sees what, kept as plainly as possible.

    Attributes:
        row_keyframe, row_has_depth: What is known of each keypoint row.
        sees: Row → point.
        rows_of: Point → rows that see it, newest first.
        alive: Points that were not removed.
        replaced_by: Point → point.
        n_found: Point → count.
    """

    row_keyframe: list[int] = field(default_factory=list)
    row_has_depth: list[bool] = field(default_factory=list)
    sees: dict[int, int] = field(default_factory=dict)
    rows_of: dict[int, list[int]] = field(default_factory=dict)
    alive: set[int] = field(default_factory=set)
    replaced_by: dict[int, int] = field(default_factory=dict)
    n_found: dict[int, int] = field(default_factory=dict)

    def add_points(self, ids: list[int], rows: list[int]) -> None:
        for point in ids:
            self.rows_of[point], self.n_found[point] = [], 1
            self.alive.add(point)
        self.observe(ids, rows)

    def observe(self, points: list[int], rows: list[int]) -> int:
        linked = 0
        for point, row in zip(points, rows, strict=True):
            keyframes = {self.row_keyframe[other] for other in self.rows_of[point]}
            if row not in self.sees and self.row_keyframe[row] not in keyframes:
                self.sees[row] = point
                self.rows_of[point].insert(0, row)
                linked += 1
        return linked

    def unlink(self, rows: list[int]) -> set[int]:
        touched = set()
        for row in rows:
            if row in self.sees:
                point = self.sees.pop(row)
                self.rows_of[point].remove(row)
                touched.add(point)
        return touched

    def n_observations(self, point: int) -> int:
        return sum(2 if self.row_has_depth[row] else 1 for row in self.rows_of[point])

    def remove_observations(self, rows: list[int]) -> None:
        self.remove_points([point for point in self.unlink(rows) if self.n_observations(point) <= 2])

    def remove_points(self, points: list[int]) -> None:
        for point in points:
            self.unlink(list(self.rows_of[point]))
            self.alive.discard(point)

    def replace_points(self, olds: list[int], news: list[int]) -> None:
        rows = [list(self.rows_of[old]) for old in olds]
        for own in rows:
            self.unlink(own)
        for own, old, new in zip(rows, olds, news, strict=True):
            self.observe([new] * len(own), own)
            self.alive.discard(old)
            self.replaced_by[old] = new
            self.n_found[new] += self.n_found[old]

    def current(self, point: int) -> int:
        while point >= 0 and point not in self.alive:
            point = self.replaced_by.get(point, -1)
        return point
