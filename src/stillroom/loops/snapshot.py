"""The map as it was, so that a loop that turns out wrong can be undone."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from stillroom.data.map import Map
from stillroom.geometry import se3
from stillroom.geometry.arrays import F64, I64
from stillroom.loops.moving import apply_motions, carry_newer

_LINKS = ("point", "next_row")
_TO_WRITE = "is_unsaved"


class Snapshot:
    """What a correction may change of a map: poses, points, and who sees what. Keypoints themselves never change."""

    def __init__(self, world: Map) -> None:
        """Copy it."""
        self._keyframes = _copy(world.keyframes.views)
        self._points = _copy(world.points.views)
        self._links = _copy({name: world.keypoints.views[name] for name in _LINKS})
        self._edges = world.covisibility.edges()
        self._loop_edges = list(world.loop_edges)

    @property
    def T_world_cam(self) -> F64:
        """The keyframes' poses then (K, 4, 4)."""
        return self._keyframes["T_world_cam"]

    @property
    def seen(self) -> tuple[I64, I64, F64]:
        """Rows that saw a point then (O,), the point of each (O,), and where all points were (P, 3) [m]."""
        rows = np.flatnonzero(self._links["point"] >= 0)
        return rows, self._links["point"][rows].astype(np.int64), self._points["position_m"]

    def restore(self, world: Map) -> None:
        """Make the map what it was. Keyframes and points that came since stay, and go where their parents go."""
        n_keyframes, n_points, n_rows = len(self.T_world_cam), len(self._points["is_alive"]), len(self._links["point"])
        table, points, keyframes = world.keypoints, world.points, world.keyframes
        is_new = (table.point >= n_points) | ((np.arange(len(table)) >= n_rows) & (table.point >= 0))
        rows = np.flatnonzero(is_new)
        seen = table.point[rows].copy()
        T_world_wrong = keyframes.T_world_cam.copy()
        for view, old in ((keyframes.views, self._keyframes), (points.views, self._points), (table.views, self._links)):
            for name, values in old.items():
                view[name][: len(values)] = values
        keyframes.is_unsaved[:], points.is_unsaved[:] = True, True
        for name in _LINKS:
            table.views[name][n_rows:] = -1
        points.first_row[n_points:] = -1
        points.n_observations[n_points:], points.n_keyframes[n_points:] = 0, 0
        world.observe(seen, rows)
        world.covisibility.restore(self._edges)
        world.loop_edges[:] = self._loop_edges
        self._carry_along(n_keyframes, n_points, T_world_wrong, world)

    def _carry_along(self, n_keyframes: int, n_points: int, T_world_wrong: F64, world: Map) -> None:
        """Move keyframes and points that came since with what they hang on."""
        carry_newer(n_keyframes, T_world_wrong, world)
        for keyframe in range(n_keyframes, len(world.keyframes)):
            world.connect(keyframe)
        new = np.arange(n_points, len(world.points))
        T_right_wrong = world.keyframes.T_world_cam @ se3.inverse(T_world_wrong)
        apply_motions(new, T_right_wrong[world.points.first_keyframe[new]], world)
        world.refresh_geometry(new[world.points.is_alive[new]])


def _copy(views: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    return {name: view.copy() for name, view in views.items() if name != _TO_WRITE}
