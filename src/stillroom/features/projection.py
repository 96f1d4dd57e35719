"""Where map points should appear in an image (ORB-SLAM2's isInFrustum), and the guided search there."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from stillroom.compiled import njit
from stillroom.data.frame import ScaleLevels
from stillroom.data.map import Map
from stillroom.features.matching import FAR_BITS, TargetArrays, Targets, Wanted, find_in_windows
from stillroom.geometry.arrays import F32, F64, I32, U64, Bool
from stillroom.geometry.camera import Camera, Lens
from stillroom.geometry.hamming import words

MIN_VIEW_COS = 0.5
"""Below this cosine between present and mean viewing direction a point is not looked for (ORB-SLAM2)."""
HEAD_ON_COS = 0.998
"""From this cosine between present and mean viewing direction on, a point is seen almost head-on (ORB-SLAM2)."""


@dataclass(frozen=True)
class Projection:
    """Where P points appear.

    Attributes:
        px: Undistorted pixel (P, 2) float32.
        right_px: Right coordinate (P,) float32.
        octave: Level on which the point should be found (P,) int32.
        view_cos: Cosine between present and mean viewing direction (P,) float32.
        depth_m: Depth (P,) float64 [m].
        visible: Whether it should be found at all (P,).
    """

    px: F32
    right_px: F32
    octave: I32
    view_cos: F32
    depth_m: F64
    visible: Bool


class PointGeometry(NamedTuple):
    """Points and from where they can be seen.

    Attributes:
        position_m: (P, 3) float64 [m, world].
        normal: Mean viewing directions (P, 3) float64.
        min_distance_m, max_distance_m: Between which distances they can be found (P,) float64 [m].
    """

    position_m: F64
    normal: F64
    min_distance_m: F64
    max_distance_m: F64


class Viewer(NamedTuple):
    """A camera as the kernel takes it.

    Attributes:
        T_cam_world, lens, bf, bounds_px: Its pose, projection, baseline and the extent of its images.
        log_factor: Logarithm of the ratio of neighbouring levels.
        n_levels: Their number.
        reach: How many times as far as from the map's camera points have the same size on the same level.
    """

    T_cam_world: F64
    lens: Lens
    bf: float
    bounds_px: tuple[float, float, float, float]
    log_factor: float
    n_levels: int
    reach: float


class _Projected(NamedTuple):
    """`Projection` as the kernel writes it."""

    px: F32
    right_px: F32
    octave: I32
    view_cos: F32
    depth_m: F64
    visible: Bool


def project_points(
    T_cam_world: F64,
    camera: Camera,
    scale_factors: F64,
    points: PointGeometry,
    min_view_cos: float = MIN_VIEW_COS,
    ids: I32 | None = None,
    reach: float = 1.0,
) -> Projection:
    """Project points with their viewing geometry into a camera.

    Args:
        T_cam_world: Its pose (4, 4).
        camera: Its calibration.
        scale_factors: Size of the pixels of its levels (L,).
        points: The points.
        min_view_cos: Least cosine between present and mean viewing direction.
        ids: Which of them (P,); all by default.
        reach: How many times as far as from the camera that the viewing geometry is of, points have the same size on
            the same level (`ScaleLevels.reach`).
    """
    ids = np.arange(len(points.position_m), dtype=np.int32) if ids is None else ids
    n = len(ids)
    seen = _Projected(
        np.zeros((n, 2), np.float32),
        np.zeros(n, np.float32),
        np.zeros(n, np.int32),
        np.zeros(n, np.float32),
        np.zeros(n, np.float64),
        np.zeros(n, np.bool_),
    )
    _project(viewer_of(T_cam_world, camera, scale_factors, reach), points, ids, min_view_cos, seen)
    return Projection(*seen)


def viewer_of(T_cam_world: F64, camera: Camera, scale_factors: F64, reach: float = 1.0) -> Viewer:
    """Return a camera at a pose (4, 4), with levels (L,) of this size [px], as kernels take it."""
    n_levels = len(scale_factors)
    log_factor = float(np.log(scale_factors[1] / scale_factors[0])) if n_levels > 1 else 1.0
    pose, bounds_px = np.ascontiguousarray(T_cam_world), camera.undistorted_bounds_px
    return Viewer(pose, camera.lens, float(camera.bf), bounds_px, log_factor, n_levels, float(reach))


@njit(nogil=True, cache=True)
def _project(viewer: Viewer, points: PointGeometry, ids: I32, min_view_cos: float, seen: _Projected) -> None:
    T, lens, bf, bounds_px, log_factor, n_levels, reach = viewer
    position_m, normals, min_distance_m, max_distance_m = points
    px, right_px, octave, view_cos, depth_m, visible = seen
    ox = -(T[0, 0] * T[0, 3] + T[1, 0] * T[1, 3] + T[2, 0] * T[2, 3])
    oy = -(T[0, 1] * T[0, 3] + T[1, 1] * T[1, 3] + T[2, 1] * T[2, 3])
    oz = -(T[0, 2] * T[0, 3] + T[1, 2] * T[1, 3] + T[2, 2] * T[2, 3])
    for i in range(len(ids)):
        p = ids[i]
        X, Y, Z = position_m[p, 0], position_m[p, 1], position_m[p, 2]
        z = T[2, 0] * X + T[2, 1] * Y + T[2, 2] * Z + T[2, 3]
        depth_m[i] = z
        if z <= 0.05:
            continue
        u = lens.fx * (T[0, 0] * X + T[0, 1] * Y + T[0, 2] * Z + T[0, 3]) / z + lens.cx
        v = lens.fy * (T[1, 0] * X + T[1, 1] * Y + T[1, 2] * Z + T[1, 3]) / z + lens.cy
        px[i, 0], px[i, 1] = u, v
        right_px[i] = u - bf / z
        if u < bounds_px[0] or v < bounds_px[1] or u > bounds_px[2] or v > bounds_px[3]:
            continue
        dx, dy, dz = X - ox, Y - oy, Z - oz
        distance = np.sqrt(dx * dx + dy * dy + dz * dz)
        # As far as from the map's camera, where it looks the same: ORB-SLAM2 has one camera.
        equal = distance / reach
        if equal < 0.8 * min_distance_m[p] or equal > 1.2 * max_distance_m[p]:
            continue
        cosine = (dx * normals[p, 0] + dy * normals[p, 1] + dz * normals[p, 2]) / distance
        view_cos[i] = cosine
        if cosine < min_view_cos:
            continue
        level = int(np.ceil(np.log(max_distance_m[p] / equal) / log_factor))
        octave[i] = min(max(level, 0), n_levels - 1)
        visible[i] = True


class Around(NamedTuple):
    """`Window` as the kernel takes it."""

    head_on_px: float
    radius_px: float
    levels_above: int
    max_bits: int
    ratio: float


@dataclass(frozen=True)
class Window:
    """The window of a guided search around projections, and what counts as a match.

    Attributes:
        radius_px: Search radius on the finest level; wider on coarser ones.
        head_on_px: The same for points that are seen almost head-on; None for no difference.
        levels_above: How many levels above the expected one are searched; one below it always is.
        max_bits: Largest distance of descriptors.
        ratio: The best must be nearer than this share of the second best of the same octave; 1 switches it off.
    """

    radius_px: float
    head_on_px: float | None = None
    levels_above: int = 1
    max_bits: int = FAR_BITS
    ratio: float = 1.0

    @property
    def around(self) -> Around:
        """The same as kernels take it."""
        head_on_px = self.radius_px if self.head_on_px is None else self.head_on_px
        return Around(float(head_on_px), float(self.radius_px), self.levels_above, self.max_bits, float(self.ratio))


@dataclass(frozen=True)
class ProjectionMatches:
    """What a search around projections found.

    Attributes:
        visible: Points that should be seen (V,).
        point_ids: Points that were found (M,).
        target: Which of the targets each is (M,).
        px: Where it was expected (M, 2) float32 [px, undistorted].
        right_px: Its expected right coordinate (M,) float32.
    """

    visible: I32
    point_ids: I32
    target: I32
    px: F32
    right_px: F32


def projected(ids: I32, T_cam_world: F64, camera: Camera, world: Map, scales: ScaleLevels | None = None) -> Projection:
    """Project points (P,) of a map into a camera at `T_cam_world` (4, 4); `scales` as for `search_around`."""
    scales = scales or world.scales
    reach = scales.reach(world.scales)
    return project_points(T_cam_world, camera, scales.factors, geometry_of(world), ids=ids, reach=reach)


def geometry_of(world: Map) -> PointGeometry:
    """Return the points of a map as kernels take them; views are invalid after the table grows."""
    points = world.points
    return PointGeometry(points.position_m, points.normal, points.min_distance_m, points.max_distance_m)


def keyframe_targets(keyframe: int, world: Map) -> Targets:
    """Return a keyframe's keypoints as search targets; dynamic ones are left out."""
    table, rows = world.keypoints, world.rows(keyframe)
    return Targets(
        table.px[rows], table.octave[rows], table.right_px[rows], table.descriptors[rows], table.is_static[rows]
    )


def search_around(
    ids: I32,
    T_cam_world: F64,
    camera: Camera,
    world: Map,
    targets: Targets,
    window: Window,
    scales: ScaleLevels | None = None,
) -> ProjectionMatches:
    """Search points (P,) of a map around their projections at a pose (4, 4).

    Args:
        ids: The points.
        T_cam_world: Pose of the camera that saw the targets.
        camera: Its calibration.
        world: The map.
        targets: Keypoints to search among.
        window: Search radius and thresholds.
        scales: The pyramid that the targets were found on; by default the map's, as for targets of its keyframes.
    """
    scales = scales or world.scales
    found = find_around(
        viewer_of(T_cam_world, camera, scales.factors, scales.reach(world.scales)),
        geometry_of(world),
        ids,
        scales.factors,
        words(world.points.descriptors),
        targets.arrays,
        window.around,
    )
    return ProjectionMatches(*found)


@njit(nogil=True, cache=True)
def find_around(
    viewer: Viewer,
    points: PointGeometry,
    ids: I32,
    scale_factors: F64,
    descriptors: U64,
    there: TargetArrays,
    around: Around,
) -> tuple[I32, I32, I32, F32, F32]:
    """Return what `ProjectionMatches` holds; descriptors of the points as words (P, 4)."""
    n = len(ids)
    seen = _Projected(
        np.empty((n, 2), np.float32),
        np.empty(n, np.float32),
        np.empty(n, np.int32),
        np.empty(n, np.float32),
        np.empty(n, np.float64),
        np.zeros(n, np.bool_),
    )
    _project(viewer, points, ids, MIN_VIEW_COS, seen)
    visible, px, radius_px, octave, right_px = _windows(ids, seen, around.head_on_px, around.radius_px, scale_factors)
    low, high = np.empty_like(octave), np.empty_like(octave)
    for i in range(len(octave)):
        low[i], high[i] = octave[i] - 1, octave[i] + around.levels_above
    wanted = Wanted(px, radius_px, low, high, right_px, descriptors, visible)
    query, target = find_in_windows(wanted, there, around.max_bits, around.ratio)
    return visible, visible[query], target, px[query], right_px[query]


@njit(nogil=True, cache=True)
def _windows(
    ids: I32, seen: _Projected, head_on_px: float, radius_px: float, scale_factors: F64
) -> tuple[I32, F32, F32, I32, F32]:
    """Return the visible points (V,), where they are expected, their windows, octaves and right coordinates."""
    px, right_px, octave, view_cos, _, visible = seen
    n_visible = np.count_nonzero(visible)
    point, wide_px = np.empty(n_visible, np.int32), np.empty(n_visible, np.float32)
    at = np.empty(n_visible, np.int64)
    n = 0
    for i in range(len(ids)):
        if visible[i]:
            base_px = head_on_px if view_cos[i] > np.float32(HEAD_ON_COS) else radius_px
            at[n], point[n], wide_px[n] = i, ids[i], base_px * scale_factors[octave[i]]
            n += 1
    return point, px[at], wide_px, octave[at], right_px[at]
