"""Background inpainting: what moves is replaced by the last keyframes' colours and depths (DynaSLAM III.D)."""

from collections import deque
from dataclasses import dataclass, field

import cv2
import numpy as np

from stillroom.bounds import bounded, check, in_pixels_of
from stillroom.data.dense_cloud import DenseCloud
from stillroom.data.image import Image
from stillroom.data.map import Map
from stillroom.dense.inpainting_kernels import Canvas, Cubes, Paint, Surface, splat_cloud, splat_colour, splat_depth
from stillroom.geometry import se3
from stillroom.geometry.arrays import F32, F64, I64, U8, Bool
from stillroom.geometry.camera import Camera
from stillroom.geometry.pixels import Shape, element, grown

EVERY_PX = 8
FEWEST = 100
SAME_SHARE = 0.05
MOST = 2.0
BESIDE_PX = 24
TYPICAL_DEPTH_M = 2.5
DARKEST, BRIGHTEST = 20, 235
NEAR_M, FAR_M = 0.5, 10.0


# How much brighter a frame is than a keyframe: cameras set their exposure and white balance as people come and go.


def gains(rgb: U8, depth_m: F32, rays: F32, T_here_there: F64, camera: Camera, here: Image, still: Bool) -> F32:
    """Return what a keyframe's red, green and blue are multiplied by to look as in a frame (3,); ones where unknown.

    The median over a grid of the keyframe's pixels that the frame shows at the same depth, neither black nor white.

    Args:
        rgb, depth_m: The keyframe's colours (H, W, 3) and usable depths (H, W).
        rays: Rays of the pixels at unit depth (H, W, 2).
        T_here_there: Pose of the keyframe's camera in the frame's (4, 4).
        camera: The calibration of both.
        here: The frame.
        still: Its pixels that do not move (H, W).
    """
    every_px = camera.in_pixels(EVERY_PX)
    grid = slice(every_px // 2, None, every_px)
    z_m = depth_m[grid, grid].ravel().astype(np.float64)
    colours = rgb[grid, grid].reshape(-1, 3).astype(np.float64)
    points = np.column_stack((rays[grid, grid].reshape(-1, 2) * z_m[:, None], z_m))
    points = se3.transform(T_here_there, points)
    ahead = (z_m > 0) & (points[:, 2] > 0.1)
    points, colours = points[ahead], colours[ahead]
    column, row = np.rint(camera.distort(camera.project(points))).T
    inside = (column >= 0) & (row >= 0) & (column < camera.width) & (row < camera.height)
    column, row = column[inside].astype(np.int64), row[inside].astype(np.int64)
    points, colours = points[inside], colours[inside]
    seen_m, seen = here.depth_m[row, column], here.rgb[row, column].astype(np.float64)
    same = still[row, column] & (np.abs(seen_m - points[:, 2]) < SAME_SHARE * points[:, 2])
    for each in (colours, seen):
        same &= (each.min(axis=1) > DARKEST) & (each.max(axis=1) < BRIGHTEST)
    if np.count_nonzero(same) < FEWEST:
        return np.ones(3, dtype=np.float32)
    ratio = np.median(seen[same] / colours[same], axis=0)
    return np.asarray(np.clip(ratio, 1.0 / MOST, MOST), dtype=np.float32)


@dataclass(frozen=True)
class InpaintingConfig:
    """Background inpainting.

    Attributes:
        keyframes: How many of the last keyframes are used.
        min_depth_m: Nearer than this no pixel is projected (docs/reference.md#dynaslam).
        same_share: What lies behind the nearest surface by no more than this share of its depth is the same surface.
        margin_px: Dilation of dynamic pixels, in the frame and in keyframes: depth is ragged at their edges.
        least_weight: A pixel is filled when at least this much of a pixel, bilinear shares added, fell on it.
        sharpness: How strongly keyframes near the view are preferred: each weighs
            1 / (distance and turn, in metres at a typical depth, + 1 cm) to this power.
        match_brightness: Whether keyframes' colours are scaled to the frame's exposure and white balance.
        close_px: Holes narrower than twice this take the colours around them; they stay marked as holes.
        hole_grey: Brightness of the others.
    """

    keyframes: int = bounded(20, least=1)
    min_depth_m: float = 0.2
    same_share: float = 0.03
    margin_px: int = bounded(6, least=0, pixels=1)
    least_weight: float = 0.3
    sharpness: float = 1.0
    match_brightness: bool = True
    close_px: int = bounded(4, least=0, pixels=1)
    hole_grey: int = bounded(0, least=0, most=255)

    def build(self, camera: Camera) -> "BackgroundPainter":
        """Return a painter for a camera.

        Raises:
            ConfigError: A value is impossible.
        """
        check(self, "inpainting")
        return BackgroundPainter(in_pixels_of(self, camera.pixel_scale), camera)


@dataclass(frozen=True)
class Painted:
    """A frame without what moves.

    Attributes:
        rgb: Colours (H, W, 3) uint8.
        depth_m: Depths (H, W) float32 [m]; 0 where unknown.
        is_filled: Pixels that were painted (H, W).
        is_hole: Pixels that were to be painted, but no keyframe has seen what is there (H, W).
    """

    rgb: U8 = field(repr=False)
    depth_m: F32 = field(repr=False)
    is_filled: Bool = field(repr=False)
    is_hole: Bool = field(repr=False)


@dataclass(frozen=True)
class _KeyframeImage:
    """A keyframe: its id, colours (H, W, 3) and usable depths (H, W)."""

    keyframe: int
    rgb: U8 = field(repr=False)
    depth_m: F32 = field(repr=False)


class BackgroundPainter:
    """Keeps the last keyframes and paints frames from them."""

    def __init__(self, config: InpaintingConfig, camera: Camera) -> None:
        """Start without keyframes."""
        self.config = config
        self._lens = camera.lens
        self._camera = camera
        self._rays = _rays(camera)
        self._seen: deque[_KeyframeImage] = deque(maxlen=config.keyframes)

    def __len__(self) -> int:
        """How many keyframes are kept."""
        return len(self._seen)

    def remember(self, keyframe: int, image: Image, moving: Bool) -> None:
        """Keep a keyframe of the map, without its dynamic pixels (H, W)."""
        usable = ~grown(moving, self.config.margin_px, Shape.SQUARE)
        self._seen.append(_KeyframeImage(keyframe, image.rgb, np.where(usable, image.depth_m, np.float32(0))))

    def paint(
        self, image: Image, T_world_cam: F64, moving: Bool, world: Map, cloud: DenseCloud | None = None
    ) -> Painted:
        """Return the frame without what moves.

        Args:
            image: The frame.
            T_world_cam: Where it was taken (4, 4).
            moving: Its dynamic pixels (H, W).
            world: The map, which knows where the keyframes are.
            cloud: The dense map, for pixels that no keyframe saw.
        """
        moving = grown(moving, self.config.margin_px, Shape.SQUARE)
        rgb, depth_m = image.rgb.copy(), image.depth_m.copy()
        rgb[moving], depth_m[moving] = self.config.hole_grey, 0
        is_filled = np.zeros_like(moving)
        if moving.any():
            total = self._gathered(image, moving, T_world_cam, world)
            is_filled = total[..., 5] >= self.config.least_weight
            mean = total[is_filled, :4] / total[is_filled, 4:5]
            rgb[is_filled] = np.rint(np.minimum(mean[:, :3], 255)).astype(np.uint8)
            depth_m[is_filled] = mean[:, 3]
            if cloud is not None:
                is_filled |= self._from_cloud(cloud, moving & ~is_filled, T_world_cam, rgb, depth_m)
        holes = moving & ~is_filled
        return Painted(_closed(rgb, holes, self.config.close_px), depth_m, is_filled, holes)

    def _gathered(self, image: Image, wanted: Bool, T_world_cam: F64, world: Map) -> F32:
        """Return sums over what falls on each pixel; see `splat_colour`."""
        views = [(seen, se3.inverse(T_world_cam) @ world.keyframe_pose(seen.keyframe)) for seen in self._seen]
        nearest_m = np.full(wanted.shape, np.inf, dtype=np.float32)
        total = np.zeros((*wanted.shape, 6), dtype=np.float32)
        surfaces = [Surface(seen.depth_m, self._rays, self._window(wanted, T), T) for seen, T in views]
        lens, least_m = self._lens, self.config.min_depth_m
        for surface in surfaces:
            splat_depth(surface, lens, least_m, wanted.view(np.uint8), nearest_m)
        weights = self._weights([T_here_there for _, T_here_there in views])
        for (seen, T), surface, weight in zip(views, surfaces, weights, strict=True):
            paint = Paint(seen.rgb, self._gain(seen, T, image, wanted), weight)
            splat_colour(surface, paint, lens, least_m, self.config.same_share, nearest_m, total)
        return total

    def _gain(self, seen: _KeyframeImage, T_here_there: F64, image: Image, wanted: Bool) -> F32:
        """Return what a keyframe's red, green and blue are multiplied by (3,)."""
        if not self.config.match_brightness:
            return np.ones(3, dtype=np.float32)
        there = seen.rgb, seen.depth_m, self._rays, T_here_there
        return gains(*there, self._camera, image, ~wanted)

    def _weights(self, poses: list[F64]) -> list[float]:
        """Return how much each keyframe counts, given its pose (4, 4) in the present camera; the best counts 1."""
        apart_m = [float(np.linalg.norm(T[:3, 3]) + TYPICAL_DEPTH_M * float(se3.angle_rad(T))) for T in poses]
        best_m = min(apart_m, default=0.0) + 0.01
        return [(best_m / (distance_m + 0.01)) ** self.config.sharpness for distance_m in apart_m]

    def _window(self, wanted: Bool, T_here_there: F64) -> I64:
        """Return rows and columns (4,) of a keyframe that can come to lie on the wanted pixels."""
        height, width = wanted.shape
        x, y, w, h = cv2.boundingRect(wanted.view(np.uint8))
        # The edge of the box, at the nearest and at the farthest that things are.
        across, down = np.linspace(x, x + w - 1, 5), np.linspace(y, y + h - 1, 5)
        edge = [(u, v) for u in across for v in (down[0], down[-1])] + [
            (u, v) for u in (across[0], across[-1]) for v in down
        ]
        px = self._camera.undistort(np.array(edge, dtype=np.float32))
        points = [self._camera.back_project(px, np.full(len(px), depth_m)) for depth_m in (NEAR_M, FAR_M)]
        there = se3.transform(se3.inverse(T_here_there), np.concatenate(points))
        if (there[:, 2] < NEAR_M / 2).any():
            return np.array([0, height, 0, width], dtype=np.int64)
        seen_px, beside_px = self._camera.distort(self._camera.project(there)), self._camera.in_pixels(BESIDE_PX)
        low = np.clip(np.floor(seen_px.min(axis=0)) - beside_px, 0, (width, height)).astype(np.int64)
        high = np.clip(np.ceil(seen_px.max(axis=0)) + beside_px, 0, (width, height)).astype(np.int64)
        return np.array([low[1], high[1], low[0], high[0]], dtype=np.int64)

    def _from_cloud(self, cloud: DenseCloud, holes: Bool, T_world_cam: F64, rgb: U8, depth_m: F32) -> Bool:
        """Draw the dense map into holes (H, W), colours and depths in place; return where."""
        state = holes.astype(np.uint8)
        positions_m = np.ascontiguousarray(cloud.positions_m, dtype=np.float32)
        cubes = Cubes(positions_m, np.ascontiguousarray(cloud.rgb), cloud.voxel_m)
        T_cam_world, canvas = se3.inverse(T_world_cam), Canvas(state, rgb, depth_m)
        splat_cloud(cubes, T_cam_world, self._lens, self.config.min_depth_m, canvas)
        return np.asarray(state == 2)


def _closed(rgb: U8, holes: Bool, reach_px: int) -> U8:
    """Return an image (H, W, 3) whose narrow holes (H, W) have the colours around them."""
    if reach_px <= 0 or not holes.any():
        return rgb
    square = element(reach_px, Shape.SQUARE)
    # What lies beyond the edge of the image is no hole.
    border = cv2.BORDER_CONSTANT
    wide = cv2.morphologyEx(holes.view(np.uint8), cv2.MORPH_OPEN, square, borderType=border, borderValue=0)
    narrow = (holes & (wide == 0)).view(np.uint8)
    return np.asarray(cv2.inpaint(rgb, narrow, 3, cv2.INPAINT_TELEA), dtype=np.uint8)


def _rays(camera: Camera) -> F32:
    """Return the rays of all pixels of the image as taken at unit depth (H, W, 2)."""
    column, row = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    px = camera.undistort(np.stack((column.ravel(), row.ravel()), axis=1).astype(np.float32))
    rays = (px - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    return np.ascontiguousarray(rays.reshape(camera.height, camera.width, 2), dtype=np.float32)
