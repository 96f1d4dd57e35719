"""A small world of described points, seen by cameras without rendering: who matches whom is known beforehand."""

from dataclasses import dataclass, field

import numpy as np

from stillroom.data.frame import Frame, Keypoints, ScaleLevels
from stillroom.data.image import RgbdImage
from stillroom.data.map import Map
from stillroom.data.motion import Motion
from stillroom.data.result import Tracked, TrackingState
from stillroom.data.semantics import Semantics, nothing
from stillroom.geometry import se3
from stillroom.geometry.camera import Camera
from stillroom.schedule import Done

CAMERA = Camera(640, 480, 520.0, 523.0, 318.0, 241.0)
SCALES = ScaleLevels()
BLACK = np.zeros((CAMERA.height, CAMERA.width, 3), dtype=np.uint8)
NO_DEPTH = np.zeros((CAMERA.height, CAMERA.width), dtype=np.float32)


def no_semantics() -> Done[Semantics]:
    """An answer by a segmenter that knows of nothing."""
    return Done(nothing(CAMERA.height, CAMERA.width))


@dataclass
class SmallWorld:
    """P points (P, 3) [m, world] before the origin, each with a random descriptor, orientation and size."""

    points_m: np.ndarray
    descriptors: np.ndarray
    angle_rad: np.ndarray
    finest_at_m: np.ndarray

    @staticmethod
    def of(seed: int, n: int = 600, near_m: float = 1.5, far_m: float = 6.0) -> "SmallWorld":
        """Points spread evenly over the image of a camera at the origin, with room to turn."""
        rng = np.random.default_rng(seed)
        z = rng.uniform(near_m, far_m, n)
        px = np.stack((rng.uniform(-60, 700, n), rng.uniform(-60, 540, n)), axis=1)
        return SmallWorld(
            CAMERA.back_project(px, z),
            rng.integers(0, 256, (n, 32), dtype=np.uint8),
            rng.uniform(-np.pi, np.pi, n),
            z * rng.uniform(1.0, 3.0, n),
        )

    def look(
        self,
        T_world_cam: np.ndarray,
        seed: int = 0,
        noise_px: float = 0.0,
        flips: int = 0,
        depth_share: float = 1.0,
        index: int = 0,
    ) -> tuple[Frame, np.ndarray]:
        """Return a frame with a keypoint for every point in view, shuffled, and which point (N,) each one is.

        Args:
            noise_px: Standard deviation of the positions.
            flips: Bits of each descriptor that are turned over.
            depth_share: Share of the keypoints with depth.
        """
        rng = np.random.default_rng(seed)
        points_cam = se3.transform(se3.inverse(T_world_cam), self.points_m)
        px = CAMERA.project(points_cam)
        inside = (points_cam[:, 2] > 0.3) & np.all((px >= 0) & (px <= [639, 479]), axis=1)
        seen = rng.permutation(np.flatnonzero(inside))
        n = len(seen)
        px = (px[seen] + noise_px * rng.normal(size=(n, 2))).astype(np.float32)
        distance_m = np.linalg.norm(points_cam[seen], axis=1)
        level = np.rint(np.log(self.finest_at_m[seen] / distance_m) / np.log(SCALES.factor))
        bits = np.unpackbits(self.descriptors[seen], axis=1)
        for row in bits:
            row[rng.permutation(256)[:flips]] ^= 1
        depth_m = np.where(rng.random(n) < depth_share, points_cam[seen, 2], 0.0).astype(np.float32)
        keypoints = Keypoints(
            px=px,
            raw_px=px,
            octave=np.clip(level, 0, SCALES.count - 1).astype(np.int32),
            angle_rad=self.angle_rad[seen].astype(np.float32),
            descriptors=np.packbits(bits, axis=1),
            depth_m=depth_m,
            right_px=CAMERA.right_coordinate(px[:, 0], depth_m),
        )
        image = RgbdImage(index / 30.0, BLACK, NO_DEPTH, index)
        return Frame(image, CAMERA, SCALES, keypoints, np.ones(n, dtype=np.bool_)), seen


@dataclass
class SmallMap:
    """A map of a small world, and which of its points is which; `id_of` (P,) is −1 for a point not in the map."""

    world: SmallWorld
    map: Map = field(default_factory=lambda: Map(SCALES))
    id_of: np.ndarray = field(init=False)
    seen: list[np.ndarray] = field(default_factory=list)
    frames: list[Frame] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.id_of = np.full(len(self.world.points_m), -1, dtype=np.int32)

    @staticmethod
    def of(world: SmallWorld, poses: list[np.ndarray], **look: float) -> "SmallMap":
        """A map with a keyframe at each pose, each hung on the one before; every point that is seen is in it."""
        small = SmallMap(world)
        for pose in poses:
            small.add(pose, **look)
        return small

    def add(self, T_world_cam: np.ndarray, make_points: bool = True, **look: float) -> int:
        """Add a keyframe that sees the known points, and makes points of the others where asked."""
        k = len(self.map.keyframes)
        frame, seen = self.world.look(T_world_cam, seed=k, index=k, **look)
        self.map.add_keyframe(frame, T_world_cam, self.id_of[seen], frame.is_static, k - 1)
        self.seen.append(seen)
        self.frames.append(frame)
        if make_points:
            new = np.flatnonzero(self.id_of[seen] < 0)
            start = self.map.rows(k).start
            self.id_of[seen[new]] = self.map.add_points(self.world.points_m[seen[new]], start + new)
        self.map.refresh(self.id_of[self.id_of >= 0])
        self.map.connect(k)
        return k

    def tracked(self, keyframe: int) -> Tracked:
        """Return a keyframe's frame as tracking would have handed it over."""
        frame, T_world_cam = self.frames[keyframe], self.map.keyframes.T_world_cam[keyframe].copy()
        motion = Motion.none(len(frame), CAMERA.height, CAMERA.width)
        return Tracked(frame, TrackingState.OK, T_world_cam, self.map.points_of(keyframe).copy(), motion, keyframe)

    def number_of(self) -> np.ndarray:
        """Return which point of the world each point of the map is (Q,)."""
        number = np.full(len(self.map.points), -1)
        known = np.flatnonzero(self.id_of >= 0)
        number[self.id_of[known]] = known
        return number


def pose(x: float = 0.0, y: float = 0.0, z: float = 0.0, turn: tuple[float, float, float] = (0, 0, 0)) -> np.ndarray:
    """T_world_cam of a camera at (x, y, z) [m], turned by a rotation vector [rad]."""
    T_world_cam = se3.exp(np.array([0.0, 0.0, 0.0, *turn]))
    T_world_cam[:3, 3] = x, y, z
    return T_world_cam
