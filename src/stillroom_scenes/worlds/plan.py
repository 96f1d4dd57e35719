"""The floor plan: cells, the openings between them, and which cells can be seen from a place.

Walls are opaque, so what is seen of another cell is seen through openings. From the camera's cell the horizontal cone
of view is clipped by each opening, and what is left continues into the cell beyond. A building may so be of any size: a
frame costs what lies behind the doors in view.
"""

from dataclasses import dataclass

import numpy as np

from stillroom.geometry.arrays import F64
from stillroom.geometry.camera import Camera

AT_HAND_M = 0.3  # an opening so near is looked through in whatever direction
MARGIN = 1e-6
Point = tuple[float, float]


@dataclass(frozen=True)
class Cell:
    """A convex part of the floor: an axis-aligned rectangle, world [m].

    Attributes:
        name: What it is, for messages and tests.
        low_m, high_m: Its corners.
    """

    name: str
    low_m: Point
    high_m: Point

    def distance_m(self, x_m: float, y_m: float) -> float:
        """Return how far a point lies outside; 0 inside."""
        beside = max(self.low_m[0] - x_m, x_m - self.high_m[0], 0.0)
        before = max(self.low_m[1] - y_m, y_m - self.high_m[1], 0.0)
        return float(np.hypot(beside, before))


@dataclass(frozen=True)
class Opening:
    """What two neighbouring cells share, a stretch of both their borders from start to end, world [m]."""

    cells: tuple[int, int]
    start_m: Point
    end_m: Point

    def beyond(self, cell: int) -> int:
        """Return the other cell."""
        return self.cells[1] if self.cells[0] == cell else self.cells[0]

    def distance_m(self, x_m: float, y_m: float) -> float:
        """Return how far a point is."""
        along_x, along_y = self.end_m[0] - self.start_m[0], self.end_m[1] - self.start_m[1]
        gone = (x_m - self.start_m[0]) * along_x + (y_m - self.start_m[1]) * along_y
        share = min(1.0, max(0.0, gone / (along_x**2 + along_y**2)))
        return float(np.hypot(self.start_m[0] + share * along_x - x_m, self.start_m[1] + share * along_y - y_m))


@dataclass(frozen=True)
class Cone:
    """The directions between two, less than half a turn: from the right one leftwards to the left one."""

    right: Point
    left: Point


class Plan:
    """Cells and openings, with the question that matters: what can be seen from here?"""

    def __init__(self, cells: tuple[Cell, ...], openings: tuple[Opening, ...]) -> None:
        """Keep the plan; cells must not overlap."""
        self.cells, self.openings = cells, openings
        self._of_cell: list[list[Opening]] = [[] for _ in cells]
        for opening in openings:
            for cell in opening.cells:
                self._of_cell[cell].append(opening)
        self._bounds_m = np.array([(*cell.low_m, *cell.high_m) for cell in cells])

    def cell_at(self, x_m: float, y_m: float) -> int:
        """Return the cell that holds a point, or the nearest."""
        low, high = self._bounds_m[:, :2], self._bounds_m[:, 2:]
        outside = np.maximum(np.maximum(low - (x_m, y_m), (x_m, y_m) - high), 0.0)
        return int(np.argmin((outside**2).sum(axis=1)))

    def seen(self, camera: Camera, T_world_cam: F64) -> list[int]:
        """Return the cells that may be seen from a pose (4, 4), in ascending order.

        None that can be seen is left out; some that are hidden by furniture, or lie above or below the view, are in.
        """
        x_m, y_m = float(T_world_cam[0, 3]), float(T_world_cam[1, 3])
        start = self.cell_at(x_m, y_m)
        found = {start}
        self._look(start, (x_m, y_m), _cone_of(camera, T_world_cam), (start,), found)
        return sorted(found)

    def _look(self, cell: int, eye_m: Point, cone: Cone | None, way: tuple[int, ...], found: set[int]) -> None:
        """Go on through the openings of a cell; a straight look never comes back to a (convex) cell it has left."""
        for opening in self._of_cell[cell]:
            beyond = opening.beyond(cell)
            if beyond in way:
                continue
            if opening.distance_m(*eye_m) < AT_HAND_M:
                narrowed = cone
            else:
                clipped = _clipped(opening, eye_m, cone)
                if clipped is None:
                    continue
                narrowed = clipped
            found.add(beyond)
            self._look(beyond, eye_m, narrowed, (*way, beyond), found)


def _cross(a: Point, b: Point) -> float:
    return a[0] * b[1] - a[1] * b[0]


def _cone_of(camera: Camera, T_world_cam: F64) -> Cone | None:
    """Return the horizontal directions that the image shows; None for all round, when it looks steeply up or down."""
    corners_px = np.array(
        [[x, y] for x in (-0.5, camera.width - 0.5) for y in (-0.5, camera.height - 0.5)], dtype=np.float64
    )
    rays = camera.back_project(corners_px, np.ones(4)) @ T_world_cam[:3, :3].T
    forward = T_world_cam[:3, 2]
    along = rays[:, :2] @ forward[:2]
    across = rays[:, 1] * forward[0] - rays[:, 0] * forward[1]
    if along.min() <= 0.05:
        return None
    # Along an edge of the image the azimuth has no extremum, so that of the corners bound it.
    right, left = (rays[int(np.argmin(across / along))], rays[int(np.argmax(across / along))])
    return Cone((float(right[0]), float(right[1])), (float(left[0]), float(left[1])))


def _clipped(opening: Opening, eye_m: Point, cone: Cone | None) -> Cone | None:
    """Return the part of a cone that goes through an opening; None where nothing does."""
    a = opening.start_m[0] - eye_m[0], opening.start_m[1] - eye_m[1]
    b = opening.end_m[0] - eye_m[0], opening.end_m[1] - eye_m[1]
    first, last = 0.0, 1.0
    for side, sign in ((cone.right, 1.0), (cone.left, -1.0)) if cone else ():
        at_a, at_b = sign * _cross(side, a), sign * _cross(side, b)
        if max(at_a, at_b) < -MARGIN:
            return None
        if at_a < 0.0 < at_b:
            first = max(first, at_a / (at_a - at_b) - MARGIN)
        elif at_b < 0.0 < at_a:
            last = min(last, at_a / (at_a - at_b) + MARGIN)
    if first > last:
        return None
    p = a[0] + first * (b[0] - a[0]), a[1] + first * (b[1] - a[1])
    q = a[0] + last * (b[0] - a[0]), a[1] + last * (b[1] - a[1])
    return Cone(p, q) if _cross(p, q) >= 0.0 else Cone(q, p)
