"""DynaSLAM's multi-view geometry (III.C): from the last keyframes to a mask of dynamic pixels."""

from dataclasses import dataclass, field
from functools import lru_cache

import cv2
import numpy as np

from stillroom.bounds import bounded
from stillroom.data.frame import Frame
from stillroom.data.map import Map
from stillroom.dynamics.ants.search import ReverseSearch, SearchResult
from stillroom.dynamics.multiview.multiview_kernels import (
    BORDER,
    DYNAMIC,
    UNSEEN,
    Growth,
    Here,
    KeyframeDepths,
    Limits,
    Points,
    PointVerdicts,
    grow,
    judge_points,
    project,
)
from stillroom.dynamics.multiview.views import STRIDE, AskedViews, KeyframesConfig, KeyframeViews
from stillroom.geometry import se3
from stillroom.geometry.arrays import F32, F64, I32, I64, U8, Bool
from stillroom.geometry.camera import Camera
from stillroom.geometry.pixels import Shape, grown

__all__ = ["BORDER", "DYNAMIC", "UNSEEN", "Geometry", "GeometryConfig", "PointsInView"]


@dataclass(frozen=True)
class GeometryConfig:
    """How a point is tested, and how regions grow from those that fail.

    Kinect noise grows with the squared depth; so do the tolerances that have a `per_m`.

    Attributes:
        keyframes: Which keyframes are compared.
        max_parallax_deg: A point is not tested where the keyframe saw it from a direction farther off [°].
        parallax_of_translations: Whether the translation of `T_cam_world` is used instead of the camera centre in the
            parallax, as in DynaSLAM's code.
        tau_m, tau_per_m: A point is occluded by something nearer by more than this.
        far_m: Points farther from the present camera than this are not tested.
        window_px: Half the window in which something nearer is searched; the nearest pixel counts.
        patch_px: Half the side of the patch whose depth variance must be small.
        patch_std_m, patch_std_per_m: Largest standard deviation of depth in it.
        seen_through: Whether the keyframe must have seen through the place where something stands now, and regions
            stop at what more keyframes saw there than saw through it. If not, occlusion by parallax counts as motion
            too.
        tolerance_m, tolerance_share: Two depths agree within the larger of the first and this share of the depth.
        growing: Whether regions grow from dynamic points; if not, the mask is a patch around each point.
        growing_stride: Stride of the pixels that regions grow over.
        mean_m, mean_per_m: Largest difference from the region's mean.
        step_m, step_per_m: Largest difference from the neighbour.
        min_area_px: Smaller regions are dropped.
        min_seen_through: With `seen_through`, regions are dropped of which keyframes saw through a smaller share:
            what was never in view is not therefore dynamic.
    """

    keyframes: KeyframesConfig = field(default_factory=KeyframesConfig)
    max_parallax_deg: float = 30.0
    parallax_of_translations: bool = False
    tau_m: float = 0.12
    tau_per_m: float = 0.02
    far_m: float = 7.0
    window_px: int = bounded(0, least=0, pixels=1)
    patch_px: int = bounded(3, least=0, pixels=1)
    patch_std_m: float = 0.03
    patch_std_per_m: float = 0.004
    seen_through: bool = True
    tolerance_m: float = 0.08
    tolerance_share: float = 0.04
    growing: bool = True
    growing_stride: int = bounded(2, least=1, pixels=1)
    mean_m: float = 0.3
    mean_per_m: float = 0.02
    step_m: float = 0.03
    step_per_m: float = 0.008
    min_area_px: int = bounded(200, least=0, pixels=2)
    min_seen_through: float = 0.1

    def build(self) -> "Geometry":
        """Return the geometry, without keyframes."""
        return Geometry(self)


@dataclass(frozen=True)
class PointsInView:
    """The data for testing the points of a frame.

    Attributes:
        frame: The frame.
        points: What the keyframes saw, and where it lies in the frame.
        here, there: The present depth image and the keyframes.
        verdict: Result of each point so far (N,); see `multiview_kernels`.
        before_px: The pixel of what occludes it (N, 2), column first.
        displaced_px: How far the depth image may be displaced by the camera's turn.
    """

    frame: Frame
    points: Points
    here: Here
    there: KeyframeDepths
    verdict: U8
    before_px: I32
    displaced_px: float

    @property
    def in_view(self) -> I64:
        """The points that lie in the image: all that can be tested at all."""
        return np.flatnonzero(self.points.px[:, 0] >= 0)

    @property
    def dynamic_px(self) -> I32:
        """Pixels (M, 2) of what occludes points that were found to be dynamic."""
        found: I32 = self.before_px[self.verdict == DYNAMIC]
        return found


class Geometry:
    """Compares a frame with the last keyframes. `mask` is the whole; the other methods are its steps."""

    def __init__(self, config: GeometryConfig) -> None:
        """Start without keyframes."""
        self.config = config
        self.views = KeyframeViews(config.keyframes)
        self._window = offsets(config.window_px)
        self._limits = Limits(
            float(np.cos(np.deg2rad(config.max_parallax_deg))),
            config.tau_m,
            config.tau_per_m,
            config.far_m,
            config.patch_px,
            config.patch_std_m,
            config.patch_std_per_m,
            config.seen_through,
            config.tolerance_m,
            config.tolerance_share,
        )
        min_pixels = max(1, round(config.min_area_px / config.growing_stride**2))
        share = config.min_seen_through if config.seen_through else 0.0
        self._growth = Growth(config.mean_m, config.mean_per_m, config.step_m, config.step_per_m, min_pixels, share)

    def mask(self, frame: Frame, T_cam_world: F64, world: Map, along: "AlongPath | None" = None) -> Bool | None:
        """Return what moves in a frame (H, W) taken at a pose (4, 4); None where there are too few keyframes.

        Args:
            frame: The frame.
            T_cam_world: Its pose.
            world: The map.
            along: Chooses the points to test; every one without it.
        """
        seen = self.points_in_view(frame, T_cam_world, world)
        if seen is None:
            return None
        if along is None:
            self.test(seen, seen.in_view)
        else:
            along.test(self, seen)
        return self.grow(seen, seen.dynamic_px)

    def points_in_view(self, frame: Frame, T_cam_world: F64, world: Map) -> PointsInView | None:
        """Project the keyframes' points into a frame; None where there are too few keyframes."""
        T_world_cam = se3.inverse(T_cam_world)
        views = self.views.ask(T_world_cam, world)
        if views is None:
            return None
        n, camera = len(views.seen_in), frame.camera
        points = Points(views.points_cam_m, views.seen_in, np.empty((n, 2), dtype=np.int32), np.empty(n))
        depth_m = np.ascontiguousarray(frame.image.depth_m, dtype=np.float32)
        here = Here(depth_m, rays_of(camera), T_world_cam, camera.lens)
        centres_m = self._centres_m(views, T_world_cam)
        T_here_cam, stride = T_cam_world @ views.T_world_cam, camera.in_pixels(STRIDE)
        there = KeyframeDepths(views.depth_m, views.T_cam_world, T_here_cam, centres_m, stride)
        project(points, there, here.lens, frame.image.height, frame.image.width)
        verdict, before_px = np.full(n, UNSEEN, dtype=np.uint8), np.full((n, 2), -1, dtype=np.int32)
        displaced_px = self.views.displaced_px(frame, T_cam_world)
        return PointsInView(frame, points, here, there, verdict, before_px, displaced_px)

    def test(self, seen: PointsInView, chosen: I64) -> U8:
        """Test chosen points (M,); return the results (M,) and store them in `seen`."""
        q = seen
        limits = self._limits._replace(patch_px=self.config.patch_px + round(q.displaced_px))
        judge_points(chosen, q.points, q.here, q.there, self._window, limits, PointVerdicts(q.verdict, q.before_px))
        verdicts: U8 = q.verdict[chosen]
        return verdicts

    def grow(self, seen: PointsInView, seeds_px: I32) -> Bool:
        """Return the mask (H, W) of regions grown from pixels (M, 2) over continuous depth."""
        stride, whole = self.config.growing_stride, seen.here
        height, width = whole.depth_m.shape
        if not self.config.growing:
            return _patches(seeds_px, height, width, max(1, self.config.patch_px))
        here = Here(
            np.ascontiguousarray(whole.depth_m[::stride, ::stride]),
            rays_of(seen.frame.camera, stride),
            whole.T_world_cam,
            whole.lens,
        )
        there = (
            seen.there
            if self.config.seen_through
            else seen.there._replace(depth_m=seen.there.depth_m[:0], T_cam_world=seen.there.T_cam_world[:0])
        )
        region = np.empty(here.depth_m.shape, dtype=np.uint8)
        grow(seeds_px // np.int32(stride), here, there, self._growth, self._limits, region)
        if stride == 1:
            return region.view(np.bool_)
        return np.asarray(cv2.resize(region, (width, height), interpolation=cv2.INTER_NEAREST)).view(np.bool_)

    def _centres_m(self, views: AskedViews, T_world_cam: F64) -> F64:
        """Return where each keyframe's camera and the present one stand in the keyframe's frame (K, 2, 3)."""
        there_m, here_m = views.T_world_cam[:, :3, 3], T_world_cam[:3, 3]
        if self.config.parallax_of_translations:
            there_m, here_m = views.T_cam_world[:, :3, 3], se3.inverse(T_world_cam)[:3, 3]
        places = zip(views.T_cam_world, there_m, strict=True)
        return np.stack([se3.transform(T, np.stack((place_m, here_m))) for T, place_m in places])


class AlongPath:
    """Tests the projected points that the reverse ant colony comes to, not every one (PSPNet-SLAM III.C).

    Attributes:
        found: What the last search found; its points are those in view.
    """

    def __init__(self, ants: ReverseSearch) -> None:
        """Take the search."""
        self._ants = ants
        self._points_px = np.zeros((0, 2))
        self.found: SearchResult | None = None

    def test(self, geometry: Geometry, seen: PointsInView) -> None:
        """Search the points in view; the results of the tested ones are stored in `seen`."""
        points = seen.in_view

        def is_dynamic(which: I64) -> Bool:
            return np.asarray(geometry.test(seen, points[which]) == DYNAMIC)

        self._points_px = seen.points.px[points].astype(np.float64)
        self.found = self._ants.search(self._points_px, is_dynamic)

    def remember(self) -> None:
        """Let the ants remember the last search, once."""
        if self.found is not None:
            self._ants.remember(self._points_px, self.found)
            self.found = None


def offsets(reach_px: int) -> I32:
    """Return the offsets (W, 2) of a square window, column first, the nearest first."""
    row, column = np.mgrid[-reach_px : reach_px + 1, -reach_px : reach_px + 1]
    every = np.stack((column.ravel(), row.ravel()), axis=1)
    return np.asarray(every[np.argsort((every**2).sum(axis=1), kind="stable")], dtype=np.int32)


@lru_cache(maxsize=4)
def rays_of(camera: Camera, stride: int = 1) -> F32:
    """Return the rays at unit depth of the pixels at a stride (h, w, 2) of the image as taken."""
    column, row = np.meshgrid(np.arange(0, camera.width, stride), np.arange(0, camera.height, stride))
    px = camera.undistort(np.stack((column.ravel(), row.ravel()), axis=1).astype(np.float32))
    rays = (px - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    return np.ascontiguousarray(rays.reshape(*column.shape, 2), dtype=np.float32)


def _patches(seeds_px: I32, height: int, width: int, reach_px: int) -> Bool:
    mask = np.zeros((height, width), dtype=np.bool_)
    mask[seeds_px[:, 1], seeds_px[:, 0]] = True
    return grown(mask, reach_px, Shape.SQUARE)
