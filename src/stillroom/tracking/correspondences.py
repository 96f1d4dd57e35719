"""The searches of the three tracking stages: correspondences between keypoints and map points."""

from typing import NamedTuple

import numpy as np

from stillroom.compiled import njit
from stillroom.data.frame import Frame
from stillroom.data.map import Map
from stillroom.data.matches import Matches
from stillroom.data.result import Tracked
from stillroom.features.matching import (
    FAR_BITS,
    TargetArrays,
    Targets,
    Wanted,
    consistent_rotation,
    find_in_windows,
    match_anywhere,
    steady_turns,
)
from stillroom.features.projection import Window, search_around
from stillroom.geometry import se3
from stillroom.geometry.arrays import F32, F64, I32, I64, U64, Bool
from stillroom.geometry.camera import Lens
from stillroom.geometry.hamming import words
from stillroom.optimize.observations import to_camera

_NEAREST_M = 0.05
"""Points nearer to the camera than this are not looked for."""


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
    camera, then, now = frame.camera, last.frame.keypoints, frame.keypoints
    travel_m = float((se3.inverse(last.T_world_cam) @ se3.inverse(T_cam_world))[2, 3])
    baseline_m = camera.baseline_m if world.sensor.is_metric else np.inf
    way = 1 if travel_m > baseline_m else -1 if travel_m < -baseline_m else 0
    keypoint, point_ids, reference_px = _search_again(
        _Sights(last.point_ids, then.px, then.octave, then.angle_rad),
        (np.ascontiguousarray(T_cam_world), camera.lens, float(camera.bf)),
        (world.points.position_m, words(world.points.descriptors)),
        targets_of(frame, frame.is_static).arrays,
        now.angle_rad,
        (float(radius_px), way, frame.scales.factors),
    )
    return Matches(keypoint, point_ids, reference_px)


class _Sights(NamedTuple):
    """Keypoints of the last frame, and the points that they see (N,), −1 for none."""

    point_ids: I32
    px: F32
    octave: I32
    angle_rad: F32


@njit(nogil=True, cache=True)
def _search_again(
    last: _Sights,
    view: tuple[F64, Lens, float],
    points: tuple[F64, U64],
    there: TargetArrays,
    angle_rad: F32,
    search: tuple[float, int, F64],
) -> tuple[I32, I32, F32]:
    """Return the matches of `with_last_frame`: keypoints, points, and where the last frame saw them.

    Args:
        last: The last frame.
        view: Pose T_cam_world (4, 4), lens and bf of the present one.
        points: Positions (P, 3) [m, world], and descriptors as words (P, 4).
        there: Its keypoints.
        angle_rad: Their orientations (N,).
        search: The window on the finest level [px], whether the camera goes forwards (1), backwards (−1) or neither,
            and the size of a pixel on each level (L,) [px].
    """
    (T, lens, bf), (position_m, descriptors), (radius_px, way, factors) = view, points, search
    seen = _first_sights(last.point_ids, len(position_m))
    n, n_levels = 0, len(factors)
    px, wide_px = np.empty((len(seen), 2), np.float32), np.empty(len(seen), np.float32)
    right_px, ids = np.empty(len(seen), np.float32), np.empty(len(seen), np.int32)
    low, high = np.empty(len(seen), np.int32), np.empty(len(seen), np.int32)
    for i in seen:
        p, octave = last.point_ids[i], last.octave[i]
        x, y, z = to_camera(T, position_m[p, 0], position_m[p, 1], position_m[p, 2])
        if not z > _NEAREST_M:
            continue
        seen[n], ids[n] = i, p
        px[n, 0], px[n, 1] = lens.fx * x / z + lens.cx, lens.fy * y / z + lens.cy
        right_px[n], wide_px[n] = px[n, 0] - bf / z, radius_px * factors[octave]
        low[n] = octave if way > 0 else 0 if way < 0 else octave - 1
        high[n] = n_levels - 1 if way > 0 else octave if way < 0 else octave + 1
        n += 1
    wanted = Wanted(px[:n], wide_px[:n], low[:n], high[:n], right_px[:n], descriptors, ids[:n])
    query, target = find_in_windows(wanted, there, FAR_BITS, 1.0)
    chosen = seen[query]
    steady = steady_turns(last.angle_rad[chosen], angle_rad[target])
    return target[steady], ids[query][steady], last.px[chosen[steady]]


@njit(nogil=True, cache=True)
def _first_sights(point_ids: I32, n_points: int) -> I64:
    """Return the keypoints (K,) that see a point, −1 for none, which no keypoint before them sees.

    Points that mapping fused since the last frame are searched once.
    """
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
