"""Splatted discs against a plain z-buffer, and what is nearest wins."""

import numpy as np
import pytest

from stillroom.data.dense_cloud import DenseCloud
from stillroom.geometry import se3
from stillroom.geometry.camera import Camera
from stillroom.viz.cloud.splat import splat
from stillroom.viz.cloud.view import Viewpoint

CAMERA = Camera(96, 64, 80.0, 80.0, 47.5, 31.5)
AT_ORIGIN = Viewpoint(np.eye(4), CAMERA)


def cloud_of(positions_m: np.ndarray, normals: np.ndarray, rgb: np.ndarray, voxel_m: float = 0.02) -> DenseCloud:
    n = len(positions_m)
    return DenseCloud(
        np.asarray(positions_m, np.float32).reshape(n, 3),
        np.asarray(normals, np.float32).reshape(n, 3),
        np.asarray(rgb, np.uint8).reshape(n, 3),
        np.ones(n, np.float32),
        voxel_m,
    )


def random_cloud(n: int, seed: int = 0) -> DenseCloud:
    rng = np.random.default_rng(seed)
    positions_m = rng.uniform((-1.5, -1.0, 0.8), (1.5, 1.0, 3.0), (n, 3))
    normals = rng.normal(size=(n, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return cloud_of(positions_m, normals, rng.integers(0, 256, (n, 3)))


def plain_z_buffer(cloud: DenseCloud, view: Viewpoint, radius_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Depth and nearest index by testing every pixel's ray against every disc that faces the eye."""
    c = view.camera
    T_view_world = np.linalg.inv(view.T_world_cam)
    v, u = np.mgrid[0 : c.height, 0 : c.width]
    rays = np.stack(((u - c.cx) / c.fx, (v - c.cy) / c.fy, np.ones_like(u, float)), axis=2)
    depth, nearest = np.full((c.height, c.width), np.inf), np.full((c.height, c.width), -1)
    for i in range(len(cloud)):
        p = T_view_world[:3, :3] @ cloud.positions_m[i].astype(float) + T_view_world[:3, 3]
        n = T_view_world[:3, :3] @ cloud.normals[i].astype(float)
        if n @ p >= 0 or p[2] <= 0.05:
            continue
        z = (n @ p) / (rays @ n)
        hit = (np.linalg.norm(z[..., None] * rays - p, axis=2) <= radius_m) & (z < depth)
        depth[hit], nearest[hit] = z[hit], i
        x, y = round(c.fx * p[0] / p[2] + c.cx), round(c.fy * p[1] / p[2] + c.cy)
        if 0 <= x < c.width and 0 <= y < c.height and p[2] < depth[y, x]:
            depth[y, x], nearest[y, x] = p[2], i
    return depth, nearest


@pytest.mark.parametrize("radius_m", [0.001, 0.03, 0.15])
def test_the_nearest_disc_is_that_of_a_plain_z_buffer(radius_m: float) -> None:
    T = se3.exp(np.array([0.1, -0.2, -0.3, 0.1, 0.2, -0.15]))
    view = Viewpoint(T, CAMERA)
    cloud = random_cloud(400)
    depth, nearest = plain_z_buffer(cloud, view, radius_m)
    splats = splat(cloud, view, radius_m)
    assert np.count_nonzero(nearest >= 0) > 100
    # Both round at a disc's very edge.
    assert np.count_nonzero(splats.nearest != nearest) <= 3
    same = (splats.nearest == nearest) & (nearest >= 0)
    # The blended depth lies within what is blended: discs at most two radii behind the nearest.
    assert np.all(splats.depth_m[same] >= depth[same] - 1e-5)
    assert np.all(splats.depth_m[same] <= depth[same] + 2 * radius_m + 1e-5)
    assert np.all(splats.depth_m[splats.nearest < 0] == 0.0)


def test_a_lone_disc_has_its_own_colour_normal_and_size() -> None:
    cloud = cloud_of([[0, 0, 2.0]], [[0, 0, -1.0]], [[200, 100, 50]])
    splats = splat(cloud, AT_ORIGIN, 0.25)
    rows, columns = np.nonzero(splats.nearest == 0)
    assert len(rows) == pytest.approx(np.pi * (80 * 0.25 / 2) ** 2, rel=0.05)
    assert (columns.mean(), rows.mean()) == pytest.approx((47.5, 31.5))
    np.testing.assert_allclose(splats.rgb[rows, columns], [[200, 100, 50]] * len(rows), atol=0.01)
    np.testing.assert_allclose(splats.depth_m[rows, columns], 2.0, rtol=1e-6)


def test_a_slanted_disc_is_narrow_and_its_depth_runs() -> None:
    slant_rad = np.radians(60)
    cloud = cloud_of([[0, 0, 2.0]], [[np.sin(slant_rad), 0, -np.cos(slant_rad)]], [[255, 255, 255]])
    splats = splat(cloud, AT_ORIGIN, 0.25)
    rows, columns = np.nonzero(splats.nearest == 0)
    assert np.ptp(rows) + 1 == pytest.approx(20, abs=1)
    assert np.ptp(columns) + 1 == pytest.approx(10, abs=1)
    middle = splats.depth_m[32, columns.min() : columns.max() + 1]
    assert np.all(np.diff(middle) > 0.02)  # tan 60° · 2 m / 80 px = 4 cm a pixel


def test_what_is_nearer_hides_and_does_not_mix_with_what_is_far() -> None:
    far, near = [0, 0, 2.0], [0, 0, 1.5]
    for order in ((far, near), (near, far)):
        rgb = [[255, 0, 0] if p == near else [0, 0, 255] for p in order]
        cloud = cloud_of(np.array(order), np.array([[0, 0, -1.0]] * 2), np.array(rgb))
        splats = splat(cloud, AT_ORIGIN, 0.1)
        np.testing.assert_allclose(splats.rgb[31, 47], [255, 0, 0])
        assert order[splats.nearest[31, 47]] == near


def test_discs_of_one_surface_are_blended() -> None:
    cloud = cloud_of([[-0.05, 0, 2.0], [0.05, 0, 2.0]], [[0, 0, -1.0]] * 2, [[255, 0, 0], [0, 0, 255]])
    row = splat(cloud, AT_ORIGIN, 0.2).rgb[31, 44:52]
    assert np.all(np.diff(row[:, 0]) < 0)
    assert np.all(np.diff(row[:, 2]) > 0)


def test_backs_are_left_out_unless_asked_for_and_points_without_normal_face_the_eye() -> None:
    cloud = cloud_of([[0, 0, 2.0], [0.5, 0, 2.0]], [[0, 0, 1.0], [0, 0, 0]], [[9, 9, 9], [7, 7, 7]])
    assert set(np.unique(splat(cloud, AT_ORIGIN, 0.1).nearest)) == {-1, 1}
    assert set(np.unique(splat(cloud, AT_ORIGIN, 0.1, two_sided=True).nearest)) == {-1, 0, 1}


def test_what_the_view_cuts_away_or_lies_behind_it_is_not_drawn() -> None:
    cloud = cloud_of([[0, 0, 2.0], [0, 0, 1.0], [0, 0, -1.0]], [[0, 0, -1.0]] * 3, [[9, 9, 9]] * 3)
    view = Viewpoint(np.eye(4), CAMERA, np.array([0, 0, -1.0, 1.5]))  # Hides z < 1.5 m.
    assert set(np.unique(splat(cloud, view, 0.1, two_sided=True).nearest)) == {-1, 0}


def test_no_points_are_no_error() -> None:
    empty = cloud_of(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3)))
    splats = splat(empty, AT_ORIGIN, 0.1)
    assert np.all(splats.nearest == -1)
    assert not splats.rgb.any()
