"""The clusters of a depth cloud, from the renderer's ground truth."""

import numpy as np

from stillroom.data.clusters import PLANE, UNKNOWN, Clusters
from stillroom.data.image import Image
from stillroom.data.semantics import connected_parts
from stillroom.geometry.arrays import F64, I16, Bool
from stillroom.geometry.camera import Camera

SMALLEST_PX = 150


def true_clusters(image: Image, camera: Camera) -> Clusters | None:
    """Return the moving things of a rendered image as clusters, all else with depth as plane; None without truth."""
    if image.truth is None:
        return None
    # By contact and not by instance, as in a depth cloud: two people who touch are one cluster.
    movable = image.truth.movable & (image.depth_m > 0)
    parts = [part for part in connected_parts(movable) if part.area_px >= SMALLEST_PX]
    parts.sort(key=lambda part: -part.area_px)
    labels: I16 = np.where(image.depth_m > 0, PLANE, UNKNOWN).astype(np.int16)
    labels[movable] = UNKNOWN
    points_m = []
    for label, part in enumerate(parts):
        labels[part.window][part.pixels] = label
        points_m.append(_points(image, labels == label, camera))
    boxes = image.truth.boxes_xyxy_px
    middles_px = [np.argwhere(labels == label)[:, ::-1].mean(axis=0) for label in range(len(parts))]
    inside = [(boxes[:, :2] <= middle).all(axis=1) & (boxes[:, 2:] >= middle).all(axis=1) for middle in middles_px]

    def stacked(rows: list[F64]) -> F64:
        return np.array(rows, dtype=np.float64).reshape(-1, 3)

    return Clusters(
        labels=labels,
        n_points=np.array([len(points) for points in points_m], dtype=np.int32),
        centroid_m=stacked([points.mean(axis=0) for points in points_m]).astype(np.float32),
        lower_m=stacked([points.min(axis=0) for points in points_m]).astype(np.float32),
        upper_m=stacked([points.max(axis=0) for points in points_m]).astype(np.float32),
        box=np.array([np.argmax(covers) if covers.any() else -1 for covers in inside], dtype=np.int32),
        planes=np.zeros((0, 4), dtype=np.float32),
    )


def _points(image: Image, chosen: Bool, camera: Camera) -> F64:
    """Return the points (N, 3) [m, camera frame] of the chosen pixels (H, W)."""
    row, column = np.nonzero(chosen)
    px = camera.undistort(np.stack((column, row), axis=1).astype(np.float32))
    return camera.back_project(px, image.depth_m[row, column])
