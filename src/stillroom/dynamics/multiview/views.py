"""The last keyframes: subsampled depth images, and points to project into the present image."""

from collections import deque
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from stillroom.bounds import bounded
from stillroom.data.frame import Frame
from stillroom.data.map import Map
from stillroom.geometry import se3
from stillroom.geometry.arrays import F32, F64, I64, Bool
from stillroom.geometry.pixels import Shape, element, values_at

STRIDE = 4
"""Stride of a keyframe's stored depth image [px]."""

NEAREST, FARTHEST, SPREAD = "nearest", "farthest", "spread"
CHOICES = (NEAREST, FARTHEST, SPREAD)

DISTANCE_WEIGHT, ROTATION_WEIGHT = 0.7, 0.3
"""Weights of the two differences of pose, each as a share of the largest (docs/reference.md#dynaslam)."""


@dataclass(frozen=True)
class KeyframesConfig:
    """Which keyframes are compared.

    Attributes:
        kept: Keyframes whose depth is stored; the oldest is dropped first.
        asked: Of those, how many a frame is compared with.
        least: With fewer than this there is no result.
        choice: "nearest" or "farthest" by distance and rotation, or "spread": evenly over time.
        max_turn_rad: A keyframe that looks farther away than this does not overlap.
        far_m: Points farther from the keyframe than this are not used.
        grid_px: Distance of the grid pixels that are points in addition to the keypoints; 0 for keypoints only.
        apart_s: Depth and colour are up to this far apart in time: when the camera turns, depth is displaced, and depth
            that near to an edge is ignored.
    """

    kept: int = bounded(20, least=1)
    asked: int = bounded(5, least=1)
    least: int = bounded(1, least=1)
    choice: str = bounded(SPREAD, one_of=CHOICES)
    max_turn_rad: float = bounded(0.8, above=0)
    far_m: float = bounded(6.0, above=0)
    grid_px: int = bounded(12, least=0, pixels=1)
    apart_s: float = bounded(0.03, least=0)


@dataclass(frozen=True)
class KeyframeView:
    """A keyframe.

    Attributes:
        keyframe: Its id in the map.
        depth_m: Its small depth image, and the nearest and farthest of each pixel and its neighbours, (h, w, 3);
            0 where unknown or moving.
        points_cam_m: Static points that it saw (P, 3) [m, its camera's frame].
    """

    keyframe: int
    depth_m: F32 = field(repr=False)
    points_cam_m: F64 = field(repr=False)


@dataclass(frozen=True)
class AskedViews:
    """The keyframes that a frame is compared with, as arrays.

    Attributes:
        T_world_cam: Their poses as known now (K, 4, 4).
        T_cam_world: Their inverses (K, 4, 4).
        depth_m: Their small depth images (K, h, w, 3), as `KeyframeView` has them.
        points_cam_m: All their points (N, 3) [m, frame of the keyframe's camera].
        seen_in: Place in the arrays above of the keyframe that saw each point (N,).
    """

    T_world_cam: F64
    T_cam_world: F64
    depth_m: F32 = field(repr=False)
    points_cam_m: F64 = field(repr=False)
    seen_in: I64 = field(repr=False)

    def __len__(self) -> int:
        """Number of keyframes."""
        return len(self.T_world_cam)


@dataclass(frozen=True)
class _Noted:
    timestamp_s: float
    T_cam_world: F64
    displaced_px: float


class KeyframeViews:
    """The last keyframes. Updated with every frame; those that became keyframes are stored."""

    def __init__(self, config: KeyframesConfig) -> None:
        """Start without any."""
        self.config = config
        self._views: deque[KeyframeView] = deque(maxlen=config.kept)
        self._last: _Noted | None = None
        self._asked: tuple[tuple[KeyframeView, ...], F32, F64, I64] | None = None

    def __len__(self) -> int:
        """How many keyframes are stored."""
        return len(self._views)

    @property
    def n_bytes(self) -> int:
        """Memory that they take."""
        return sum(view.depth_m.nbytes + view.points_cam_m.nbytes for view in self._views)

    def displaced_px(self, frame: Frame, T_cam_world: F64) -> float:
        """Return how far a frame's depth may be displaced by the turn of the camera since the frame before."""
        if self._last is None or frame.timestamp_s < self._last.timestamp_s:
            return 0.0
        elapsed_s = frame.timestamp_s - self._last.timestamp_s
        if elapsed_s == 0.0:
            return self._last.displaced_px
        turn_rad = float(se3.angle_rad(T_cam_world @ se3.inverse(self._last.T_cam_world)))
        return self.config.apart_s * frame.camera.fx * turn_rad / elapsed_s

    def note(self, frame: Frame, T_cam_world: F64, moving: Bool, keyframe: int = -1) -> None:
        """Process a frame; store its depth if it became a keyframe.

        Args:
            frame: The frame.
            T_cam_world: Its pose (4, 4).
            moving: Its dynamic pixels (H, W).
            keyframe: Its id in the map; −1 where it is no keyframe.
        """
        displaced_px = self.displaced_px(frame, T_cam_world)
        self._last = _Noted(frame.timestamp_s, T_cam_world.copy(), displaced_px)
        if keyframe >= 0:
            self._views.append(self._view(keyframe, frame, moving, displaced_px))

    def follow(self, T_new_old: F64) -> None:
        """Move the last pose by a motion (4, 4) of the world's coordinates; the map knows the keyframes'."""
        if self._last is not None:
            self._last = replace(self._last, T_cam_world=self._last.T_cam_world @ se3.inverse(T_new_old))

    def ask(self, T_world_cam: F64, world: Map) -> AskedViews | None:
        """Return the keyframes to compare a pose (4, 4) with, as the config chooses; None if too few."""
        views = [view for view in self._views if view.keyframe < len(world.keyframes)]
        poses = np.array([world.keyframe_pose(view.keyframe) for view in views]).reshape(-1, 4, 4)
        apart = se3.inverse(poses) @ T_world_cam
        turn_rad = np.arccos(np.clip(apart[:, 2, 2], -1.0, 1.0))
        overlapping = np.flatnonzero(turn_rad <= self.config.max_turn_rad)
        if len(overlapping) < max(1, self.config.least):
            return None
        chosen = overlapping[self._choose(apart[overlapping])]
        poses = poses[chosen]
        return AskedViews(poses, se3.inverse(poses), *self._together([views[i] for i in chosen]))

    def _together(self, views: list[KeyframeView]) -> tuple[F32, F64, I64]:
        """Return depths, points, and who saw them, as `AskedViews` has them; the same ones until others are asked."""
        if self._asked is None or [id(view) for view in self._asked[0]] != [id(view) for view in views]:
            sizes = [len(view.points_cam_m) for view in views]
            depth_m = np.stack([view.depth_m for view in views])
            points_cam_m = np.concatenate([view.points_cam_m for view in views])
            self._asked = tuple(views), depth_m, points_cam_m, np.repeat(np.arange(len(views)), sizes)
        return self._asked[1:]

    def _choose(self, apart: F64) -> I64:
        """Return the indices of those to compare with, given present poses (K, 4, 4) in each, oldest first."""
        n = min(self.config.asked, len(apart))
        if self.config.choice == SPREAD:
            return np.unique(np.rint(np.linspace(0, len(apart) - 1, n)).astype(np.int64))
        distance_m = np.linalg.norm(apart[:, :3, 3], axis=1)
        angle_rad = se3.angle_rad(apart)
        score = DISTANCE_WEIGHT * distance_m / max(float(distance_m.max()), 1e-9)
        score += ROTATION_WEIGHT * angle_rad / max(float(angle_rad.max()), 1e-9)
        order = np.argsort(-score if self.config.choice == FARTHEST else score, kind="stable")
        return np.asarray(np.sort(order[:n]), dtype=np.int64)

    def _view(self, keyframe: int, frame: Frame, moving: Bool, displaced_px: float) -> KeyframeView:
        stride = frame.camera.in_pixels(STRIDE)
        small = frame.image.depth_m[::stride, ::stride].copy()
        small[moving[::stride, ::stride]] = 0
        kp = frame.keypoints
        usable = (kp.depth_m > 0) & (kp.depth_m < self.config.far_m) & ~values_at(moving, kp.raw_px)
        points = frame.camera.back_project(kp.px[usable], kp.depth_m[usable])
        if self.config.grid_px > 0:
            points = np.concatenate((points, self._on_a_grid(frame, small, stride)))
        return KeyframeView(keyframe, with_neighbours(small, 1 + round(displaced_px / stride)), points)

    def _on_a_grid(self, frame: Frame, small_m: F32, stride: int) -> F64:
        """Return the points (P, 3) of a depth image at a stride, at that of the grid."""
        step = max(1, round(self.config.grid_px / stride))
        depth_m = small_m[::step, ::step]
        row, column = np.nonzero((depth_m > 0) & (depth_m < self.config.far_m))
        raw_px = np.stack((column, row), axis=1).astype(np.float32) * np.float32(step * stride)
        return frame.camera.back_project(frame.camera.undistort(raw_px), depth_m[row, column])


def with_neighbours(depth_m: F32, reach: int = 1) -> F32:
    """Return depths (h, w), 0 where unknown, with the nearest and farthest known within `reach` pixels, (h, w, 3)."""
    square = element(reach, Shape.SQUARE)
    nearest = cv2.erode(np.where(depth_m > 0, depth_m, np.float32(np.inf)), square)
    nearest[np.isinf(nearest)] = 0
    return np.ascontiguousarray(np.dstack((depth_m, nearest, cv2.dilate(depth_m, square))), dtype=np.float32)
