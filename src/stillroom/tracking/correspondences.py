"""The searches of the three tracking stages: correspondences between keypoints and map points."""

import numpy as np

from stillroom.compiled import njit
from stillroom.data.frame import Frame
from stillroom.data.map import Map
from stillroom.data.matches import Matches
from stillroom.data.result import Tracked
from stillroom.features.matching import Queries, Targets, consistent_rotation, match_anywhere, search_windows
from stillroom.features.projection import Window, search_around
from stillroom.geometry import se3
from stillroom.geometry.arrays import F64, I32, I64, Bool


def targets_of(frame: Frame, usable: Bool) -> Targets:
    """Return the frame's keypoints as search targets."""
    kp = frame.keypoints
    return Targets(kp.px, kp.octave, kp.right_px, kp.descriptors, usable)


def with_last_frame(frame: Frame, last: Tracked, T_cam_world: F64, world: Map, radius_px: float) -> Matches:
    """Search the last frame's points around their predicted projections.

    The pyramid levels to search depend on the direction of travel (ORB-SLAM2), where lengths are in metres.

    Args:
        frame: The present frame.
        last: The last frame, its points as known now.
        T_cam_world: Predicted pose (4, 4).
        world: The map.
        radius_px: Window on the finest level; wider on coarser ones.
    """
    assert last.T_world_cam is not None
    # Points that mapping fused since the last frame are searched once.
    seen = _first_sights(last.point_ids, len(world.points))
    ids = last.point_ids[seen]
    points_cam = se3.transform(T_cam_world, world.points.position_m[ids])
    ahead = points_cam[:, 2] > 0.05
    seen, ids, points_cam = seen[ahead], ids[ahead], points_cam[ahead]
    camera, keypoints = frame.camera, last.frame.keypoints
    px = camera.project(points_cam).astype(np.float32)
    octave = keypoints.octave[seen]
    travel_m = float((se3.inverse(last.T_world_cam) @ se3.inverse(T_cam_world))[2, 3])
    low, high = octave - 1, octave + 1
    baseline_m = camera.baseline_m if world.sensor.is_metric else np.inf
    if travel_m > baseline_m:
        low, high = octave, np.full_like(octave, frame.scales.count - 1)
    elif travel_m < -baseline_m:
        low, high = np.zeros_like(octave), octave
    queries = Queries(
        px,
        (radius_px * frame.scales.factors[octave]).astype(np.float32),
        low,
        high,
        camera.right_coordinate(px[:, 0], points_cam[:, 2]),
        world.points.descriptors,
        ids,
    )
    query, target = search_windows(queries, targets_of(frame, frame.is_static))
    steady = consistent_rotation(keypoints.angle_rad[seen[query]], frame.keypoints.angle_rad[target])
    return Matches(target, ids[query], keypoints.px[seen[query]]).keep(steady)


@njit(nogil=True, cache=True)
def _first_sights(point_ids: I32, n_points: int) -> I64:
    """Return the keypoints (K,) that see a point, −1 for none, which no keypoint before them sees."""
    is_seen = np.zeros(n_points, np.bool_)
    first = np.empty(len(point_ids), np.int64)
    n = 0
    for i in range(len(point_ids)):
        if point_ids[i] >= 0 and not is_seen[point_ids[i]]:
            is_seen[point_ids[i]] = True
            first[n] = i
            n += 1
    return first[:n]


def with_keyframe(frame: Frame, keyframe: int, world: Map) -> Matches:
    """Match with a keyframe's points by descriptors alone."""
    rows = world.rows(keyframe)
    point = world.keypoints.point[rows]
    seen = np.flatnonzero(point >= 0)
    usable = np.flatnonzero(frame.is_static)
    mine, theirs = match_anywhere(
        frame.keypoints.descriptors[usable], world.keypoints.descriptors[rows][seen], ratio=0.75
    )
    target, place = usable[mine].astype(np.int32), seen[theirs]
    steady = consistent_rotation(world.keypoints.angle_rad[rows][place], frame.keypoints.angle_rad[target])
    return Matches(target, point[place], world.keypoints.px[rows][place], keyframe).keep(steady)


def with_points(
    frame: Frame, ids: I32, free: Bool, T_cam_world: F64, world: Map, widen: float, ratio: float = 0.8
) -> tuple[Matches, I32]:
    """Search map points around their projections at a good pose.

    Args:
        frame: The present frame.
        ids: Points to search (P,).
        free: Keypoints that may still be matched (N,).
        T_cam_world: Pose (4, 4).
        world: The map.
        widen: Factor on the window.
        ratio: Ratio test.

    Returns:
        The matches, and the points (V,) that should have been visible.
    """
    # ORB-SLAM2: the window is smaller for a point seen almost head-on.
    window = Window(4.0 * widen, head_on_px=2.5 * widen, levels_above=0, ratio=ratio)
    targets = targets_of(frame, free & frame.is_static)
    found = search_around(ids, T_cam_world, frame.camera, world, targets, window, frame.scales)
    unknown_px = np.full((len(found.target), 2), np.nan, dtype=np.float32)
    return Matches(found.target, found.point_ids, unknown_px), found.visible
