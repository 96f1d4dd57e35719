"""What earlier images saw, kept small: asked whether a place was free before anything appeared there."""

from dataclasses import dataclass, field

import cv2
import numpy as np

from stillroom.data.map import Map
from stillroom.dense.keyframe_cloud import in_units
from stillroom.dense.voxels.evidence_kernels import count_in_view
from stillroom.geometry import se3
from stillroom.geometry.arrays import F32, F64, U16, Bool
from stillroom.geometry.camera import Camera
from stillroom.geometry.growing import Shape, element

SAMPLES = 64
LEAST_SHARE = 0.1
"""A witness is asked when it has at least this share of the points in view."""


@dataclass(frozen=True)
class Witness:
    """A small depth image (h, w), hung on a keyframe.

    Attributes:
        keyframe: The keyframe.
        T_keyframe_cam: Pose in it (4, 4).
        depth: Depths in units, the lowest bit set where a pixel shows what moves.
    """

    keyframe: int
    T_keyframe_cam: F64
    depth: U16 = field(repr=False)


def small_depth(depth_m: F32, is_moving: Bool | None, stride: int) -> U16:
    """Return every so many-th depth (H, W) [m] in units; the lowest bit stands for whether it moves (H, W)."""
    depth: U16 = in_units(depth_m, stride) & np.uint16(0xFFFE)
    if is_moving is not None:
        depth |= is_moving[::stride, ::stride] & (depth > 0)
    return depth


def views_of(depth: U16) -> U16:
    """Return depth, nearest and farthest of the neighbourhood (h, w, 3); see `evidence_kernels.look`."""
    square = element(1, Shape.SQUARE)
    # What is unknown, 0, becomes the farthest: 0 − 1 wraps around.
    nearest = cv2.erode(depth - np.uint16(1), square) + np.uint16(1)
    return np.asarray(cv2.merge((depth, nearest, cv2.dilate(depth, square))), dtype=np.uint16)


class Witnesses:
    """The small images in order of time; when there are too many, every second of the older half goes."""

    def __init__(self, camera: Camera, most: int) -> None:
        """Start without any; keep at most `most`."""
        self.most = most
        self._size_px = camera.width, camera.height
        self._lens = camera.lens
        self._all: list[Witness] = []
        self._T_cam_world = np.zeros((most + 1, 4, 4))

    def __len__(self) -> int:
        """How many there are."""
        return len(self._all)

    @property
    def n_bytes(self) -> int:
        """Memory that is held."""
        return len(self._all) * self._all[0].depth.nbytes if self._all else 0

    def remember(self, keyframe: int, T_keyframe_cam: F64, T_world_cam: F64, depth: U16) -> None:
        """Keep a small depth image (h, w) as `small_depth` gives it."""
        self._T_cam_world[len(self._all)] = se3.inverse(T_world_cam)
        self._all.append(Witness(keyframe, T_keyframe_cam, depth))
        if len(self._all) > self.most:
            half = len(self._all) // 2
            kept = [*range(0, half, 2), *range(half, len(self._all))]
            self._all = [self._all[i] for i in kept]
            self._T_cam_world[: len(kept)] = self._T_cam_world[kept]

    def refresh(self, world: Map) -> None:
        """Bring all to where their keyframes are now; `choose` does so only for those that it returns."""
        for i, witness in enumerate(self._all):
            self._T_cam_world[i] = se3.inverse(world.keyframe_pose(witness.keyframe) @ witness.T_keyframe_cam)

    def choose(self, points_m: F32, far_m: float, n: int, world: Map) -> list[tuple[F64, U16]]:
        """Return pose and depth of at most `n` that have points in view, spread over time, placed by the map.

        Args:
            points_m: The points (M, 3) [m, world].
            far_m: How far witnesses see.
            n: How many.
            world: The map that holds their keyframes.
        """
        if not self._all or len(points_m) == 0:
            return []
        sample = np.ascontiguousarray(points_m[:: max(1, len(points_m) // SAMPLES)])
        counts = count_in_view(sample, self._T_cam_world[: len(self._all)], self._lens, *self._size_px, far_m)
        able = np.flatnonzero(counts >= max(1.0, LEAST_SHARE * len(sample)))
        if len(able) > n:
            able = able[np.rint(np.linspace(0, len(able) - 1, n)).astype(np.int64)]
        for i in able:
            pose = world.keyframe_pose(self._all[i].keyframe) @ self._all[i].T_keyframe_cam
            self._T_cam_world[i] = se3.inverse(pose)
        return [(self._T_cam_world[i].copy(), self._all[i].depth) for i in able]
