"""Back-projection, the voxel filter and the label image: there and back again."""

import cv2
import numpy as np
import pytest

from stillroom.geometry.camera import Camera
from stillroom.geometry.cloud.backproject import back_project, ray_grid
from stillroom.geometry.cloud.label_image import spread_labels
from stillroom.geometry.cloud.voxels import voxel_filter

CAMERA = Camera(160, 120, 130.0, 131.0, 79.0, 60.5, distortion=(0.05, -0.1, 0.001, -0.001, 0.02))


@pytest.mark.parametrize("stride", [1, 3, 4])
def test_points_project_to_the_pixels_that_they_come_from(stride: int) -> None:
    depth_m = np.random.default_rng(0).uniform(0.5, 5.0, (120, 160)).astype(np.float32)
    grid = ray_grid(CAMERA, 120, 160, stride)
    points = back_project(depth_m, grid, 0.1, 10.0)
    flat = points.reshape(-1, 3).astype(np.float64)
    px, _ = cv2.projectPoints(flat, np.zeros(3), np.zeros(3), CAMERA.K, np.array(CAMERA.distortion))
    u, v = np.meshgrid(grid.columns, grid.rows)
    np.testing.assert_allclose(px.reshape(-1, 2), np.stack((u.ravel(), v.ravel()), axis=1), atol=2e-3)
    np.testing.assert_array_equal(points[..., 2], depth_m[np.ix_(grid.rows, grid.columns)])


@pytest.mark.parametrize("bad", [0.0, -1.0, np.nan, np.inf, -np.inf, 0.19, 6.01])
def test_bad_depth_is_unknown(bad: float) -> None:
    depth_m = np.full((8, 8), 2.0, dtype=np.float32)
    depth_m[4, 4] = bad
    points = back_project(depth_m, ray_grid(CAMERA, 8, 8, 1), 0.2, 6.0)
    assert points[4, 4].tolist() == [0.0, 0.0, 0.0]
    assert (points[..., 2] > 0).sum() == 63


@pytest.mark.parametrize(("height", "width", "shape"), [(1, 1, (1, 1)), (2, 3, (1, 1)), (5, 9, (1, 2)), (6, 9, (1, 2))])
def test_tiny_images_have_a_grid(height: int, width: int, shape: tuple[int, int]) -> None:
    grid = ray_grid(CAMERA, height, width, 4)
    assert grid.shape == shape
    assert grid.rows.max() < height
    assert grid.columns.max() < width


@pytest.mark.parametrize(("height", "width", "stride"), [(0, 4, 1), (4, 0, 1), (4, 4, 0)])
def test_impossible_grids_are_refused(height: int, width: int, stride: int) -> None:
    with pytest.raises(ValueError, match="is not possible"):
        ray_grid(CAMERA, height, width, stride)


@pytest.mark.parametrize("edge_m", [0.02, 0.3])
def test_voxels_hold_the_means_of_their_points(edge_m: float) -> None:
    points = np.random.default_rng(3).uniform(-1.0, 1.0, (2000, 3))
    voxels = voxel_filter(points, edge_m)
    _, expected = np.unique(np.floor(points / edge_m), axis=0, return_inverse=True)
    pairs = np.unique(np.stack((expected.ravel(), voxels.voxel_of)), axis=1)
    assert pairs.shape[1] == len(voxels) == expected.max() + 1
    assert voxels.n_points.sum() == len(points)
    for k in (0, len(voxels) // 2, len(voxels) - 1):
        np.testing.assert_allclose(voxels.mean_m[k], points[voxels.voxel_of == k].mean(axis=0), atol=1e-12)


def test_voxels_of_two_groups_are_apart() -> None:
    rng = np.random.default_rng(3)
    points, group = rng.uniform(-1.0, 1.0, (800, 3)), rng.integers(-1, 3, 800).astype(np.int32)
    voxels = voxel_filter(points, 0.3, group)
    keys = np.column_stack((np.floor(points / 0.3), group))
    assert len(voxels) == len(np.unique(keys, axis=0))
    np.testing.assert_array_equal(voxels.group[voxels.voxel_of], group)


def test_no_points_are_no_voxels_and_an_edge_of_zero_is_refused() -> None:
    assert len(voxel_filter(np.zeros((0, 3)), 0.1)) == 0
    with pytest.raises(ValueError, match="voxel"):
        voxel_filter(np.zeros((1, 3)), 0.0)


def spread(depth_m: np.ndarray, stride: int, split_m: float = 2.5) -> tuple[np.ndarray, np.ndarray]:
    """Label 1 before `split_m`, 2 behind it; return the label image and what it should be."""
    grid = ray_grid(CAMERA, *depth_m.shape, stride)
    points = back_project(depth_m, grid, 0.2, 6.0)
    labels = np.where(points[..., 2] <= 0, -1, np.where(points[..., 2] < split_m, 1, 2)).astype(np.int16)
    exact = np.where(depth_m > 0, np.where(depth_m < split_m, 1, 2), -1)
    return spread_labels(labels, points, depth_m, grid, 0.04, 0.02, -1), exact


def test_edges_of_the_label_image_are_those_of_the_depth_image() -> None:
    depth_m = np.full((120, 160), 4.0, dtype=np.float32)
    cv2.circle(depth_m, (80, 60), 33, 1.0, -1)
    depth_m[10:20, 30:50] = 0.0
    labels, exact = spread(depth_m, 4)
    # Only pixels whose four samples all lie across an edge can stay without a label; none has a wrong one.
    assert ((labels == exact) | (labels == -1)).all()
    assert (labels == exact).mean() > 0.995
    assert (labels[depth_m == 0] == -1).all()


def test_with_a_stride_of_one_every_pixel_has_its_own_label() -> None:
    depth_m = np.random.default_rng(5).uniform(0.5, 5.0, (60, 80)).astype(np.float32)
    labels, exact = spread(depth_m, 1)
    np.testing.assert_array_equal(labels, exact)


def test_a_thing_thinner_than_the_stride_is_not_given_to_what_is_behind_it() -> None:
    depth_m = np.full((40, 40), 4.0, dtype=np.float32)
    depth_m[:, 20] = 2.0  # samples are at 2, 6, 10, …, 18, 22
    labels, _ = spread(depth_m, 4)
    assert (labels[:, 20] == -1).all()
    assert (np.delete(labels, 20, axis=1) == 2).all()


def test_labels_of_bad_depth_are_unknown() -> None:
    depth_m = np.full((12, 12), 2.0, dtype=np.float32)
    depth_m[3, 3:9] = (np.nan, np.inf, -np.inf, -2.0, 0.0, 7.0)
    labels, _ = spread(depth_m, 4)
    assert (labels[3, 3:9] == -1).all()
    assert (labels == -1).sum() == 6


@pytest.mark.parametrize("stride", [1, 3, 4])
def test_labels_are_those_of_a_plain_loop(stride: int) -> None:
    rng = np.random.default_rng(stride)
    tiles = np.kron(rng.choice([0.0, 1.0, 1.03, 1.5, 4.0], (14, 19)), np.ones((7, 6)))
    depth_m = (tiles[:95, :111] + (tiles[:95, :111] > 0) * rng.uniform(0.0, 0.03, (95, 111))).astype(np.float32)
    grid = ray_grid(CAMERA, *depth_m.shape, stride)
    points = back_project(depth_m, grid, 0.2, 6.0)
    labels = rng.integers(-2, 4, (len(grid.rows) // 5 + 1, len(grid.columns) // 5 + 1)).astype(np.int16)
    labels = np.kron(labels, np.ones((5, 5), dtype=np.int16))[: len(grid.rows), : len(grid.columns)]
    labels = np.ascontiguousarray(labels)
    expected = np.full(depth_m.shape, -1, dtype=np.int16)
    for r, c in np.ndindex(depth_m.shape):
        i0 = max(int(np.searchsorted(grid.rows, r, side="right")) - 1, 0)
        j0 = max(int(np.searchsorted(grid.columns, c, side="right")) - 1, 0)
        i1, j1 = min(i0 + 1, len(grid.rows) - 1), min(j0 + 1, len(grid.columns) - 1)
        around = [(i0, j0), (i0, j1), (i1, j0), (i1, j1)]
        z = np.array([points[at][2] for at in around])
        away = np.abs(z - depth_m[r, c])
        if away.min() <= max(np.float32(0.04), np.float32(0.02) * z.max()) and away.min() < depth_m[r, c]:
            expected[r, c] = labels[around[int(np.argmin(away))]]
    assert 0.3 < (expected >= 0).mean() < 0.9
    np.testing.assert_array_equal(spread_labels(labels, points, depth_m, grid, 0.04, 0.02, -1), expected)
