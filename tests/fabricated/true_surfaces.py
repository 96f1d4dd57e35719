"""Surfaces that a renderer truly shows, as points of its world, to hold dense maps against."""

from collections.abc import Iterable, Sequence

import numpy as np
from scipy.spatial import cKDTree

from stillroom.data.dense_cloud import DenseCloud
from stillroom.geometry import se3
from stillroom_scenes.room import FrameTruth, SyntheticRoom

REACH_M = 4.9
STILL, FIGURES, THINGS = range(1), range(1, 101), range(101, 120)
"""Instances: the still room, the figures, and things that are handled."""


def surface(
    room: SyntheticRoom, truths: Iterable[FrameTruth], instances: Sequence[int], reach_m: float = REACH_M
) -> np.ndarray:
    """Points (N, 3) [m, world] of instances that any of some images truly show, thinned to 2 cm."""
    points = [thin(_points(room, truth, instances, reach_m)) for truth in truths]
    return thin(np.concatenate(points))


def _points(room: SyntheticRoom, truth: FrameTruth, instances: Sequence[int], reach_m: float) -> np.ndarray:
    shown = np.isin(truth.instance, instances) & (truth.depth_m > 0) & (truth.depth_m < reach_m)
    v, u = np.nonzero(shown)
    points = room.camera.back_project(np.stack((u, v), axis=1).astype(np.float64), truth.depth_m[shown])
    return se3.transform(truth.T_world_cam, points)


def times_looked_through(room: SyntheticRoom, truths: Iterable[FrameTruth], points_m: np.ndarray) -> np.ndarray:
    """Count the images that truly see something more than 15 cm behind points (N, 3), (N,)."""
    count = np.zeros(len(points_m), dtype=int)
    for truth in truths:
        cam = se3.transform(se3.inverse(truth.T_world_cam), points_m)
        px = np.rint(room.camera.project(cam)).astype(int)
        inside = np.all((px >= 8) & (px < (632, 472)), axis=1)
        u, v = px[inside].T
        count[inside] += truth.depth_m[v, u] > cam[inside, 2] + 0.15
    return count


def thin(points_m: np.ndarray) -> np.ndarray:
    i, j, k = np.floor(points_m / 0.02).astype(np.int64).T + 1000
    return points_m[np.unique((i * 2000 + j) * 2000 + k, return_index=True)[1]]


def distances_m(points_m: np.ndarray, others_m: np.ndarray) -> np.ndarray:
    return np.asarray(cKDTree(others_m).query(points_m)[0])


def share_in(cloud: DenseCloud, surface_m: np.ndarray, within_m: float = 0.03) -> float:
    """Return which share of a surface the cloud holds."""
    return float(np.mean(distances_m(surface_m, cloud.positions_m) <= within_m))
