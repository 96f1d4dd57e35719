"""Keyframes by their poses alone: all of the sparse map that the dense one asks for."""

import numpy as np

from stillroom.data.map import Map
from stillroom.data.map.map_lock import MapLock
from stillroom.data.map.tables import KeyframeTable


class PosedKeyframes(Map):
    """A map of keyframes without points."""

    n_submaps = 1

    def __init__(self, poses: np.ndarray) -> None:
        self.lock = MapLock()
        self.keyframes = KeyframeTable(max(1, len(poses)))
        for k, T_world_cam in enumerate(poses):
            self.keyframes.append(1, T_world_cam=T_world_cam, parent=k - 1, T_parent_cam=np.eye(4))

    def cull(self, keyframe: int) -> None:
        """Let a keyframe hang on the one before it."""
        table = self.keyframes
        parent = int(table.parent[keyframe])
        table.T_parent_cam[keyframe] = np.linalg.inv(self.keyframe_pose(parent)) @ table.T_world_cam[keyframe]
        table.is_alive[keyframe] = False
