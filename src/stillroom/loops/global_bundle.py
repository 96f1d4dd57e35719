"""Bundle adjustment after a correction: of a connected component, or of the keyframes around one place."""

from collections.abc import Callable

import numpy as np

from stillroom.data.map import Map
from stillroom.geometry import se3
from stillroom.geometry.arrays import I64
from stillroom.geometry.camera import Camera
from stillroom.loops.freedom import freedom_of
from stillroom.loops.moves import Places, carry_newer, follow_keyframes
from stillroom.optimize import observations
from stillroom.optimize.bundle import BundleAdjuster, BundleProblem, BundleResult


class GlobalBundle:
    """One full bundle adjustment in three steps, so that the map may grow during the long one in the middle.

    The constructor copies what it needs of the map, `solve` works on the copy, `commit` writes the result back.
    Keyframes and points that were added in between move with their parents.
    """

    def __init__(self, keyframes: I64, world: Map, in_place: bool = False) -> None:
        """Copy keyframes (K,) and the points that several of them see.

        Args:
            keyframes: What is to be adjusted, ascending.
            world: The map.
            in_place: Whether all other keyframes that observe the points are included as fixed; else the others are
                left out, and the first of the keyframes is fixed.
        """
        table, points = world.keypoints, world.points
        seen = world.points_seen_by(keyframes)
        self._points = seen[points.n_keyframes[seen] > 1]
        place, rows = world.observations(self._points)
        involved = np.unique(table.keyframe[rows]).astype(np.int64) if in_place else keyframes
        is_fixed = ~np.isin(involved, keyframes)
        if not is_fixed.any():
            is_fixed[:1] = True
        node = np.full(len(world.keyframes), -1, dtype=np.int64)
        node[involved] = np.arange(len(involved))
        within = node[table.keyframe[rows]] >= 0
        self._rows, place = rows[within], place[within]
        self._row_points = self._points[place]
        self._keyframes, self._moves, self._n_known = involved, ~is_fixed, len(world.keyframes)
        right_px = table.right_px[self._rows]
        self._problem = BundleProblem(
            T_cam_world=se3.inverse(world.keyframes.T_world_cam[involved]),
            is_fixed=is_fixed,
            points_world_m=points.position_m[self._points].copy(),
            obs_keyframe=node[table.keyframe[self._rows]].astype(np.int32),
            obs_point=place,
            observed_px=observations.observed_px(table.px[self._rows], right_px),
            weights=observations.weights(table.octave[self._rows], right_px, world.scales.inverse_variances),
            p_static=table.p_static[self._rows],
        )

    def solve(self, camera: Camera, adjust: BundleAdjuster, stop: Callable[[], bool] | None = None) -> BundleResult:
        """Adjust the copy; `stop` is called before each step and ends it early."""
        return adjust(self._problem, camera, stop)

    def commit(self, result: BundleResult, world: Map) -> None:
        """Write the result to the map, and remove outliers."""
        keyframes, points, table = world.keyframes, world.points, world.keypoints
        before = Places.of(world)
        problem = self._problem
        result = freedom_of(world).in_gauge(result, np.asarray(problem.points_world_m), problem.is_fixed)
        moved = keyframes.is_alive[self._keyframes] & self._moves
        keyframes.T_world_cam[self._keyframes[moved]] = se3.inverse(result.T_cam_world[moved])
        carry_newer(self._n_known, before, world)
        is_other = points.is_alive.copy()
        is_other[self._points] = False
        follow_keyframes(np.flatnonzero(is_other), before, world)
        alive = points.is_alive[self._points]
        points.position_m[self._points[alive]] = result.points_world_m[alive]
        unchanged = table.point[self._rows] == self._row_points
        world.remove_observations(self._rows[~result.is_inlier & unchanged])
        world.refresh_geometry(np.flatnonzero(points.is_alive))
