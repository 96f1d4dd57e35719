"""New points of a keyframe: from its depth at once, by triangulation with its neighbours later."""

import numpy as np

from stillroom.data.map import Map
from stillroom.data.result import Tracked
from stillroom.features.matching import Targets, search_epipolar
from stillroom.geometry import se3
from stillroom.geometry.arrays import F64, I32, I64, Bool
from stillroom.geometry.camera import Camera
from stillroom.geometry.epipolar import fundamental_from_motion, ray_cosines, triangulate

MIN_NEAREST = 100
"""A keyframe makes at least this many points from depth, however far (ORB-SLAM2)."""
_CHI2_2D, _CHI2_3D = 5.991, 7.815


def from_depth(keyframe: int, tracked: Tracked, close_depth_m: float, world: Map) -> I32:
    """Create points from static keypoints with depth that have none yet: all close ones, and the nearest 100.

    The first keyframe of a sub-map creates all it can (ORB-SLAM2: StereoInitialization): there is no other map yet.

    Args:
        keyframe: The keyframe that the frame became.
        tracked: The frame.
        close_depth_m: Depth up to which stereo is precise.
        world: Receives the points.

    Returns:
        Their ids.
    """
    keypoints, start = tracked.frame.keypoints, world.rows(keyframe).start
    static = world.keypoints.is_static[world.rows(keyframe)]
    candidates = np.flatnonzero((keypoints.depth_m > 0) & static)
    candidates = candidates[np.argsort(keypoints.depth_m[candidates], kind="stable")]
    n_close = int((keypoints.depth_m[candidates] < close_depth_m).sum())
    if world.keyframes.parent[keyframe] >= 0:
        candidates = candidates[: max(n_close, MIN_NEAREST)]
    free = candidates[world.points_of(keyframe)[candidates] < 0]
    points_cam = tracked.frame.camera.back_project(keypoints.px[free], keypoints.depth_m[free])
    return world.add_points(se3.transform(world.keyframes.T_world_cam[keyframe], points_cam), start + free)


def by_triangulation(keyframe: int, neighbours: list[int], camera: Camera, world: Map) -> I32:
    """Make points of static keypoints that this keyframe and a neighbour both see and that have no point yet.

    Where parallax is smaller than that of depth, depth is used (ORB-SLAM2: CreateNewMapPoints).
    """
    made = [np.zeros(0, dtype=np.int32)]
    centre = world.keyframes.T_world_cam[keyframe, :3, 3]
    for neighbour in neighbours:
        if np.linalg.norm(world.keyframes.T_world_cam[neighbour, :3, 3] - centre) < camera.baseline_m:
            continue
        first, second = _search(keyframe, neighbour, camera, world)
        if len(first) == 0:
            continue
        positions_m, good = _locate(first, second, camera, world)
        new = world.add_points(positions_m[good], first[good])
        world.observe(new, second[good])
        made.append(new)
    ids = np.concatenate(made)
    world.refresh(ids)
    return ids


def _search(keyframe: int, neighbour: int, camera: Camera, world: Map) -> tuple[I64, I64]:
    """Return rows (M,) of the keyframe and rows of the neighbour that match along epipolar lines."""
    T_neighbour_world = se3.inverse(world.keyframes.T_world_cam[neighbour])
    T_neighbour_keyframe = T_neighbour_world @ world.keyframes.T_world_cam[keyframe]
    F = fundamental_from_motion(T_neighbour_keyframe, camera.K)
    # The keyframe's centre seen from the neighbour; behind it or in its plane there is no epipole to avoid.
    tx, ty, tz = T_neighbour_keyframe[:3, 3]
    epipole_px = (
        np.array([camera.fx * tx / tz + camera.cx, camera.fy * ty / tz + camera.cy])
        if abs(tz) > 1e-6
        else np.full(2, 1e9)
    )
    rows, others = world.rows(keyframe), world.rows(neighbour)
    first, second = search_epipolar(
        F, _free_targets(rows, world), _free_targets(others, world), world.scales.factors, epipole_px
    )
    return rows.start + first.astype(np.int64), others.start + second.astype(np.int64)


def _free_targets(rows: slice, world: Map) -> Targets:
    table = world.keypoints
    usable = (table.point[rows] < 0) & table.is_static[rows]
    return Targets(table.px[rows], table.octave[rows], table.right_px[rows], table.descriptors[rows], usable)


def _locate(first: I64, second: I64, camera: Camera, world: Map) -> tuple[F64, Bool]:
    """Return positions (M, 3) [m, world] of matched rows and which of them are reliable."""
    table, keyframes = world.keypoints, world.keyframes
    T_world_first = keyframes.T_world_cam[table.keyframe[first[0]]]
    T_world_second = keyframes.T_world_cam[table.keyframe[second[0]]]
    rays_first, rays_second = _rays(first, camera, world), _rays(second, camera, world)
    cosine = ray_cosines(T_world_first, T_world_second, rays_first, rays_second)
    cosine_first, cosine_second = _stereo_cosine(first, camera, world), _stereo_cosine(second, camera, world)
    cosine_stereo = np.minimum(cosine_first, cosine_second)
    has_depth = cosine_stereo < 1.0
    parallax = (cosine > 0) & (cosine < cosine_stereo) & (has_depth | (cosine < 0.9998))
    positions_m = triangulate(se3.inverse(T_world_first), se3.inverse(T_world_second), rays_first, rays_second)
    for rows, T_world_cam, mine, other in (
        (first, T_world_first, cosine_first, cosine_second),
        (second, T_world_second, cosine_second, cosine_first),
    ):
        use = ~parallax & (mine < 1.0) & (mine <= other)
        points_cam = camera.back_project(table.px[rows[use]], table.depth_m[rows[use]])
        positions_m[use] = se3.transform(T_world_cam, points_cam)
    good = np.isfinite(positions_m).all(axis=1) & (parallax | has_depth)
    positions_m[~good] = 0.0
    for rows, T_world_cam in ((first, T_world_first), (second, T_world_second)):
        good &= _agrees(positions_m, rows, T_world_cam, camera, world)
    return positions_m, good & _scale_agrees(positions_m, first, second, world)


def _rays(rows: I64, camera: Camera, world: Map) -> F64:
    return camera.back_project(world.keypoints.px[rows], np.ones(len(rows)))[:, :2]


def _stereo_cosine(rows: I64, camera: Camera, world: Map) -> F64:
    """Return the cosine (M,) of the parallax that depth stands for; above 1 where there is none."""
    depth_m = world.keypoints.depth_m[rows].astype(np.float64)
    known = depth_m > 0
    angle_rad = 2.0 * np.arctan2(camera.baseline_m / 2.0, np.where(known, depth_m, 1.0))
    return np.where(known, np.cos(angle_rad), 2.0)


def _agrees(positions_m: F64, rows: I64, T_world_cam: F64, camera: Camera, world: Map) -> Bool:
    """Return which positions (M, 3) lie before the camera and project to where their rows saw them."""
    table = world.keypoints
    points_cam = se3.transform(se3.inverse(T_world_cam), positions_m)
    ahead = points_cam[:, 2] > 0
    points_cam[~ahead, 2] = 1.0
    px = camera.project(points_cam)
    error2 = ((px - table.px[rows]) ** 2).sum(axis=1)
    has_depth = table.right_px[rows] >= 0
    right_error = px[:, 0] - camera.bf / points_cam[:, 2] - table.right_px[rows]
    error2 += np.where(has_depth, right_error**2, 0.0)
    error2 *= world.scales.inverse_variances[table.octave[rows]]
    return np.asarray(ahead & (error2 <= np.where(has_depth, _CHI2_3D, _CHI2_2D)))


def _scale_agrees(positions_m: F64, first: I64, second: I64, world: Map) -> Bool:
    """Return where the ratio of distances (M,) fits the ratio of the levels that the keypoints were found on."""
    table = world.keypoints
    centres = world.keyframes.T_world_cam[:, :3, 3]
    near = np.linalg.norm(positions_m - centres[table.keyframe[first]], axis=1)
    far = np.linalg.norm(positions_m - centres[table.keyframe[second]], axis=1)
    factors = world.scales.factors
    ratio_of_levels = factors[table.octave[first]] / factors[table.octave[second]]
    slack = 1.5 * world.scales.factor
    with np.errstate(divide="ignore", invalid="ignore"):
        quotient = (far / near) / ratio_of_levels
    return np.asarray((near > 0) & (far > 0) & (quotient < slack) & (quotient > 1.0 / slack))
