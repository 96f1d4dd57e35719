"""What earlier images saw, kept small: asked whether a place was free before anything appeared there."""

from dataclasses import dataclass, field

import cv2
import numpy as np

from stillroom.data.map import Map
from stillroom.dense.keyframe_cloud import UNIT_M
from stillroom.dense.voxels.evidence_kernels import count_in_view
from stillroom.geometry import se3
from stillroom.geometry.arrays import F32, F64, U8, U16, Bool
from stillroom.geometry.camera import Camera

UNKNOWN_M = np.float32(1e3)
SAMPLES = 64
LEAST_SHARE = 0.1
"""A witness is asked when it has at least this share of the points in view."""


@dataclass
class Witness:
    """A small depth image (h, w), hung on a keyframe.

    Attributes:
        keyframe: The keyframe.
        T_keyframe_cam: Pose in it (4, 4).
        depth: Depths in units of `UNIT_M`.
        is_moving: Pixels that show what moves, packed to bits.
        T_cam_world: Where it was last known to be (4, 4).
    """

    keyframe: int
    T_keyframe_cam: F64
    depth: U16 = field(repr=False)
    is_moving: U8 = field(repr=False)
    T_cam_world: F64

    def views(self) -> F32:
        """Return what `look` reads."""
        moving = np.unpackbits(self.is_moving, count=self.depth.size).reshape(self.depth.shape)
        return views_of(self.depth, moving.astype(np.bool_))


def views_of(depth: U16, is_moving: Bool) -> F32:
    """Return depth, nearest and farthest of the neighbourhood (h, w, 3) [m]; see `evidence_kernels.look`."""
    depth_m = np.multiply(depth, UNIT_M, dtype=np.float32)
    square = np.ones((3, 3), dtype=np.uint8)
    nearest = cv2.erode(np.where(depth > 0, depth_m, UNKNOWN_M), square)
    farthest = cv2.dilate(depth_m, square)
    return np.stack((np.where(is_moving, -depth_m, depth_m), nearest, farthest), axis=-1)


class Witnesses:
    """The small images in order of time; when there are too many, every second of the older half goes."""

    def __init__(self, camera: Camera, most: int) -> None:
        """Start without any; keep at most `most`."""
        self.most = most
        self._size_px = camera.width, camera.height
        self._lens = lens_of(camera)
        self._all: list[Witness] = []

    def __len__(self) -> int:
        """How many there are."""
        return len(self._all)

    @property
    def n_bytes(self) -> int:
        """Memory that is held."""
        return sum(witness.depth.nbytes + witness.is_moving.nbytes for witness in self._all)

    def remember(self, keyframe: int, T_keyframe_cam: F64, T_world_cam: F64, depth: U16, is_moving: Bool) -> None:
        """Keep a small depth image (h, w)."""
        T_cam_world = se3.inverse(T_world_cam)
        self._all.append(Witness(keyframe, T_keyframe_cam, depth, np.packbits(is_moving), T_cam_world))
        if len(self._all) > self.most:
            half = len(self._all) // 2
            self._all = self._all[:half:2] + self._all[half:]

    def choose(self, points_m: F32, far_m: float, n: int, world: Map) -> list[Witness]:
        """Return at most `n` that have points (M, 3) [m, world] in view, spread over time, placed by the map."""
        if not self._all or len(points_m) == 0:
            return []
        sample = np.ascontiguousarray(points_m[:: max(1, len(points_m) // SAMPLES)])
        poses = np.array([witness.T_cam_world for witness in self._all])
        counts = count_in_view(sample, poses, self._lens, *self._size_px, far_m)
        able = np.flatnonzero(counts >= max(1.0, LEAST_SHARE * len(sample)))
        if len(able) > n:
            able = able[np.rint(np.linspace(0, len(able) - 1, n)).astype(np.int64)]
        chosen = [self._all[i] for i in able]
        for witness in chosen:
            witness.T_cam_world = se3.inverse(world.keyframe_pose(witness.keyframe) @ witness.T_keyframe_cam)
        return chosen


def lens_of(camera: Camera) -> F64:
    """Return fx fy cx cy k1 k2 p1 p2 k3 (9,)."""
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion], dtype=np.float64)
