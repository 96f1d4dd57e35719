"""Bundle adjustment of a part of the map: a keyframe, its covisible ones and all that they see, or the whole map."""

import numpy as np

from stillroom.data.map import Map
from stillroom.geometry import se3
from stillroom.geometry.camera import Camera
from stillroom.optimize import measurements
from stillroom.optimize.bundle import BundleAdjuster, BundleProblem


def adjust_locally(keyframe: int, max_keyframes: int, camera: Camera, adjust: BundleAdjuster, world: Map) -> None:
    """Adjust a keyframe, its strongest neighbours and their points; others that see these points hold them in place.

    Observations that do not fit afterwards are removed.
    """
    adjust_these([keyframe, *world.covisibility.neighbours(keyframe, max_keyframes - 1)], camera, adjust, world)


def adjust_all(camera: Camera, adjust: BundleAdjuster, world: Map) -> None:
    """Adjust all keyframes but the first of each sub-map, and all points; observations that do not fit are removed."""
    adjust_these([int(keyframe) for keyframe in world.alive_keyframes()], camera, adjust, world)


def adjust_these(free: list[int], camera: Camera, adjust: BundleAdjuster, world: Map) -> None:
    """Adjust some keyframes and their points; others that see these hold them in place, as does a sub-map's first."""
    if not free:
        return
    table, points, keyframes = world.keypoints, world.points, world.keyframes
    point_ids = world.points_seen_by(np.array(free))
    place, rows = world.observations(point_ids)
    involved, obs_keyframe = np.unique(table.keyframe[rows], return_inverse=True)
    is_fixed = ~np.isin(involved, free) | (keyframes.parent[involved] < 0)
    if is_fixed.all() or len(rows) == 0:
        return
    if not is_fixed.any():
        is_fixed[0] = True  # Something must hold the map where it is; the oldest keyframe does.
    problem = BundleProblem(
        T_cam_world=se3.inverse(keyframes.T_world_cam[involved]),
        is_fixed=is_fixed,
        points_world_m=points.position_m[point_ids],
        obs_keyframe=obs_keyframe.astype(np.int32),
        obs_point=place,
        observed_px=measurements.observed_px(table.px[rows], table.right_px[rows]),
        weights=measurements.weights(table.octave[rows], table.right_px[rows], world.scales.inverse_variances),
        p_static=table.p_static[rows],
    )
    result = adjust(problem, camera)
    moved = np.flatnonzero(~is_fixed)
    keyframes.T_world_cam[involved[moved]] = se3.inverse(result.T_cam_world[moved])
    points.position_m[point_ids] = result.points_world_m
    world.remove_observations(rows[~result.is_inlier])
    world.refresh_geometry(point_ids[points.is_alive[point_ids]])
