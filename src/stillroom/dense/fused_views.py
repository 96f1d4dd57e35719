"""Under which poses images were fused, and which of them the map has moved since."""

import numpy as np

from stillroom.data.map import Map
from stillroom.geometry import se3
from stillroom.geometry.arrays import F64, I64

TYPICAL_DEPTH_M = 2.5
NOT_FUSED = -1
FIRST_CAPACITY = 64


class FusedViews:
    """What is known of each view: a keyframe, or a frame that hangs on one. Views are numbered as they come."""

    def __init__(self) -> None:
        """Start with none."""
        self._keyframe = np.zeros(FIRST_CAPACITY, dtype=np.int64)
        self._T_keyframe_cam = np.zeros((FIRST_CAPACITY, 4, 4))
        self._T_world_cam = np.zeros((FIRST_CAPACITY, 4, 4))
        self._added_at = np.zeros(FIRST_CAPACITY, dtype=np.int64)
        self._n = 0

    def new(self, keyframe: int, T_keyframe_cam: F64) -> int:
        """Number a view that hangs on a keyframe at a pose (4, 4) in it; it is not fused yet."""
        view = self._n
        if view == len(self._keyframe):
            for name in ("_keyframe", "_T_keyframe_cam", "_T_world_cam", "_added_at"):
                column = getattr(self, name)
                setattr(self, name, np.concatenate((column, np.zeros_like(column))))
        self._keyframe[view], self._T_keyframe_cam[view] = keyframe, T_keyframe_cam
        self._added_at[view] = NOT_FUSED
        self._n += 1
        return view

    def note(self, view: int, T_world_cam: F64, now: int) -> None:
        """Note that a view was fused under a pose (4, 4)."""
        self._T_world_cam[view], self._added_at[view] = T_world_cam, now

    def fused_under(self, view: int) -> tuple[F64, int]:
        """Return the pose (4, 4) under which, and the time at which a view was fused."""
        return self._T_world_cam[view], int(self._added_at[view])

    def pose_now(self, view: int, world: Map) -> F64:
        """Return `T_world_cam` (4, 4) of a view by the map as it is."""
        pose: F64 = world.keyframe_pose(int(self._keyframe[view])) @ self._T_keyframe_cam[view]
        return pose

    def forget(self, view: int) -> None:
        """Leave a view as it was fused for ever."""
        self._added_at[view] = NOT_FUSED

    def moved(self, world: Map, tolerance_m: float, with_culled: bool) -> list[int]:
        """Return the views whose pose in the map has changed, the farthest moved first.

        Args:
            world: The map.
            tolerance_m: How far a point at a typical depth may move.
            with_culled: Whether to follow culled keyframes to what they hang on, one by one.
        """
        views: I64 = np.flatnonzero(self._added_at[: self._n] != NOT_FUSED)
        alive = world.keyframes.is_alive[self._keyframe[views]]
        if not with_culled:
            views, alive = views[alive], alive[alive]
        poses = world.keyframes.T_world_cam[self._keyframe[views]] @ self._T_keyframe_cam[views]
        for i in np.flatnonzero(~alive):
            poses[i] = self.pose_now(int(views[i]), world)
        change = se3.inverse(self._T_world_cam[views]) @ poses
        moved_m = np.linalg.norm(change[:, :3, 3], axis=1) + TYPICAL_DEPTH_M * se3.angle_rad(change)
        order = np.argsort(-moved_m, kind="stable")
        finite = np.isfinite(moved_m[order])
        return [int(view) for view in views[order][finite & (moved_m[order] > tolerance_m)]]
