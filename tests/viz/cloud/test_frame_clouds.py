"""The cloud of an image lies where its depth says, and the clusters in space have their colours."""

import numpy as np

from stillroom.data.clusters import PLANE, UNKNOWN, Clusters
from stillroom.data.image import RgbdImage
from stillroom.data.semantics import nothing
from stillroom.geometry.camera import Camera
from stillroom.viz.cloud.frame_clouds import STRIDE, cloud_of_image, draw_cluster_cloud, points_as_cloud
from stillroom.viz.clusters import cluster_colors
from stillroom.viz.marks import MOVING

CAMERA = Camera(160, 120, 130.0, 130.0, 79.5, 59.5)


def two_boards() -> tuple[RgbdImage, Clusters]:
    """A wall at 3 m and two boards at 2 m in front of it; a stripe without depth."""
    depth_m = np.full((120, 160), 3.0, dtype=np.float32)
    labels = np.full((120, 160), PLANE, dtype=np.int16)
    for label, columns in enumerate((slice(20, 60), slice(100, 140))):
        depth_m[30:90, columns], labels[30:90, columns] = 2.0, label
    depth_m[:, 150:], labels[:, 150:] = 0.0, UNKNOWN
    zeros = np.zeros((2, 3), dtype=np.float32)
    clusters = Clusters(
        labels,
        np.array([100, 100], np.int32),
        zeros,
        zeros,
        zeros,
        np.array([-1, -1], np.int32),
        np.zeros((0, 4), np.float32),
    )
    return RgbdImage(0.0, np.full((120, 160, 3), 128, np.uint8), depth_m, 0), clusters


def test_points_project_back_on_their_pixels() -> None:
    image, clusters = two_boards()
    kept = clusters.labels == 0
    cloud = cloud_of_image(image, CAMERA, image.rgb, kept)
    x, y, z = cloud.positions_m.astype(np.float64).T
    column, row = CAMERA.fx * x / z + CAMERA.cx, CAMERA.fy * y / z + CAMERA.cy
    np.testing.assert_allclose(z, 2.0)
    seen = set(zip(np.rint(row).astype(int).tolist(), np.rint(column).astype(int).tolist(), strict=True))
    wanted = {(r, c) for r, c in np.argwhere(kept).tolist() if r % STRIDE == 1 and c % STRIDE == 1}
    assert seen == wanted
    np.testing.assert_allclose(column, np.rint(column), atol=1e-3)
    assert (cloud.rgb == 128).all()


def near(picture: np.ndarray, color: tuple[int, int, int]) -> int:
    """Number of pixels of a hue, be it darker or brighter by the light."""
    wanted = np.array(color) / np.linalg.norm(color)
    length = np.maximum(np.linalg.norm(picture.astype(float), axis=2), 1.0)
    return int((picture.astype(float) @ wanted / length > 0.998).sum())


def test_clusters_keep_their_colours_in_space_and_what_moves_is_red() -> None:
    image, clusters = two_boards()
    still = draw_cluster_cloud(image, CAMERA, clusters, nothing(120, 160), np.zeros((120, 160), bool), 480)
    assert still.shape == (360, 480, 3)
    for color in cluster_colors(clusters):
        assert near(still, color) > 300
    assert near(still, MOVING) == 0
    moved = draw_cluster_cloud(image, CAMERA, clusters, nothing(120, 160), clusters.labels == 1, 480)
    assert near(moved, MOVING) > 300
    assert near(moved, cluster_colors(clusters)[1]) == 0


def test_points_of_a_map_have_one_colour_and_no_normals() -> None:
    cloud = points_as_cloud(np.zeros((0, 3)), np.array([1, 2, 3], np.uint8), 0.02)
    assert len(cloud) == 0
    assert cloud.rgb.shape == (0, 3)
    cloud = points_as_cloud(np.ones((5, 3)), np.array([1, 2, 3], np.uint8), 0.02)
    assert cloud.rgb.tolist() == [[1, 2, 3]] * 5
    assert not cloud.normals.any()
