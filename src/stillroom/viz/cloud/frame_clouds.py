"""Clouds to draw that no map holds: the depth of one image in any colours, and the points of a sparse map."""

import numpy as np

from stillroom.data.clusters import PLANE, Clusters
from stillroom.data.dense_cloud import DenseCloud
from stillroom.data.image import Image
from stillroom.data.semantics import Semantics
from stillroom.geometry.arrays import U8, Bool, Floats
from stillroom.geometry.camera import Camera
from stillroom.geometry.cloud.backproject import back_project, ray_grid
from stillroom.viz.cloud.render import CloudRendererConfig
from stillroom.viz.cloud.view import default_view
from stillroom.viz.clusters import PLANES, cluster_colors
from stillroom.viz.marks import MOVING, Color

NEAR_M, FAR_M = 0.3, 6.0
STRIDE = 2
DISC_M = 0.014
"""Edge of the voxels that a frame's points stand for: gaps at four metres close."""
FADED = 0.35
"""How much of its own colour a plane keeps; the rest is grey-blue."""
PITCH_RAD, YAW_RAD = 0.42, 0.5
"""From where clusters are seen: from above, and from the side, so that one stands clear of what is behind it."""


def cloud_of_image(image: Image, camera: Camera, rgb: U8, kept: Bool) -> DenseCloud:
    """Return the depth of an image as a cloud in the frame of its camera, every second row and column.

    Args:
        image: Whose depth it is (H, W).
        camera: The calibration.
        rgb: Colours (H, W, 3) of the points.
        kept: Pixels to take (H, W); those without depth are left out.
    """
    grid = ray_grid(camera, image.height, image.width, STRIDE)
    points_m = back_project(image.known_depth_m, grid, NEAR_M, FAR_M)
    shown = (points_m[..., 2] > 0) & kept[grid.pixels]
    return points_as_cloud(points_m[shown], rgb[grid.pixels][shown], DISC_M)


def points_as_cloud(points_m: Floats, rgb: U8, disc_m: float) -> DenseCloud:
    """Return points (N, 3) [m] with colours (N, 3), or one (3,), as discs of about that diameter that face the eye."""
    n = len(points_m)
    colors = np.ascontiguousarray(np.broadcast_to(rgb, (n, 3)), dtype=np.uint8)
    return DenseCloud(
        positions_m=np.asarray(points_m, dtype=np.float32).reshape(n, 3),
        normals=np.zeros((n, 3), dtype=np.float32),
        rgb=colors,
        weight=np.ones(n, dtype=np.float32),
        voxel_m=disc_m,
    )


def draw_cluster_cloud(
    image: Image, camera: Camera, clusters: Clusters, semantics: Semantics, moving: Bool, width_px: int = 960
) -> U8:
    """Draw the clusters of an image in space (OC-SLAM, Figure 7), seen from above and from the side.

    Clusters have the colours that `draw_clusters` gives them; those of which most moves are red, planes a faded
    grey-blue. What belongs to none is left out.

    Args:
        image: Colours and depth as taken.
        camera: The calibration.
        clusters: The clusters of its depth.
        semantics: What is potentially dynamic: a cluster in no box is drawn half as bright.
        moving: Dynamic pixels (H, W).
        width_px: Width of the picture, which has the shape of the image.
    """
    table = np.zeros((len(clusters) + 2, 3), dtype=np.float32)
    table[PLANE + 2] = PLANES
    for label, color in enumerate(_colors(clusters, moving)):
        table[label + 2] = color if clusters.box[label] >= 0 or not semantics.boxes else 0.55 * np.array(color)
    rgb = table[clusters.labels.astype(np.int64) + 2]
    on_plane = clusters.labels == PLANE
    rgb[on_plane] += FADED * (image.rgb[on_plane] - rgb[on_plane])
    kept = (clusters.labels >= 0) | on_plane
    cloud = cloud_of_image(image, camera, np.rint(rgb).astype(np.uint8), kept)
    height_px = round(width_px * image.height / image.width)
    view = default_view(cloud, np.eye(4)[None], width_px, height_px, PITCH_RAD, YAW_RAD)
    return CloudRendererConfig(two_sided=True, exposure=1.0).build().render(cloud, view)


def _colors(clusters: Clusters, moving: Bool) -> list[Color]:
    colors = list(cluster_colors(clusters))
    for label in range(len(clusters)):
        inside = clusters.labels == label
        if 2 * np.count_nonzero(moving[inside]) > np.count_nonzero(inside):
            colors[label] = MOVING
    return colors
