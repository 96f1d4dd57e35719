"""Under which poses keyframes were fused, and which of them the map has moved since."""

import numpy as np

from stillroom.data.map import Map
from stillroom.geometry import se3
from stillroom.geometry.arrays import F64, I64

TYPICAL_DEPTH_M = 2.5
NOT_FUSED = -1


class FusedKeyframes:
    """Poses and times by keyframe id."""

    def __init__(self) -> None:
        """Start with none."""
        self._poses = np.zeros((64, 4, 4))
        self._added_at = np.full(64, NOT_FUSED, dtype=np.int64)

    def note(self, keyframe: int, T_world_cam: F64, now: int) -> None:
        """Note that a keyframe was fused under a pose (4, 4)."""
        while keyframe >= len(self._added_at):
            self._poses = np.concatenate((self._poses, np.zeros_like(self._poses)))
            self._added_at = np.concatenate((self._added_at, np.full_like(self._added_at, NOT_FUSED)))
        self._poses[keyframe] = T_world_cam
        self._added_at[keyframe] = now

    def of(self, keyframe: int) -> tuple[F64, int]:
        """Return the pose (4, 4) under which, and the time at which a keyframe was fused."""
        return self._poses[keyframe], int(self._added_at[keyframe])

    def forget(self, keyframe: int) -> None:
        """Leave a keyframe as it was fused for ever."""
        self._added_at[keyframe] = NOT_FUSED

    def moved(self, world: Map, tolerance_m: float, with_culled: bool) -> list[int]:
        """Return the keyframes whose pose in the map has changed, the farthest moved first.

        Args:
            world: The map.
            tolerance_m: How far a point at a typical depth may move.
            with_culled: Whether to follow culled keyframes to what they hang on, one by one.
        """
        ids: I64 = np.flatnonzero(self._added_at != NOT_FUSED)
        alive = world.keyframes.is_alive[ids]
        if not with_culled:
            ids, alive = ids[alive], alive[alive]
        poses = world.keyframes.T_world_cam[ids].copy()
        for i in np.flatnonzero(~alive):
            poses[i] = world.keyframe_pose(int(ids[i]))
        change = se3.inverse(self._poses[ids]) @ poses
        moved_m = np.linalg.norm(change[:, :3, 3], axis=1) + TYPICAL_DEPTH_M * se3.angle_rad(change)
        order = np.argsort(-moved_m, kind="stable")
        finite = np.isfinite(moved_m[order])
        return [int(keyframe) for keyframe in ids[order][finite & (moved_m[order] > tolerance_m)]]
