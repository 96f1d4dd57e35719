"""Which pixels are fused, and their normals."""

import numpy as np
import pytest
from plain_room import CAMERA, DISTORTED, depth_of_box, flat, image, pose, rays

from stillroom.dense.keyframe_cloud import UNIT_M, CloudMaker, SurfaceConfig, in_units, smoothed

MAKER = CloudMaker(SurfaceConfig(), CAMERA)
INNER = np.s_[8:-8, 8:-8]


@pytest.mark.parametrize("camera", [CAMERA, DISTORTED])
def test_the_normal_of_a_plane_is_the_planes(camera) -> None:
    normal = np.array([0.3, -0.4, -np.sqrt(0.75)])
    depth_m = (-1.5 / (rays(camera) @ normal)).astype(np.float32)
    cloud, normals = CloudMaker(SurfaceConfig(), camera).make(image(depth_m), None)
    assert cloud.usable[INNER].all()
    found = normals[INNER].reshape(-1, 3) / 127.0
    assert np.degrees(np.arccos(np.clip(found @ normal, -1, 1))).max() < 1.5


def test_noise_of_a_wall_is_averaged_and_its_place_kept() -> None:
    rng = np.random.default_rng(0)
    depth_m = flat(3.0) + rng.normal(0, 0.015, flat(3.0).shape).astype(np.float32)
    cloud, normals = MAKER.make(image(depth_m), None)
    inner_m = cloud.depth_m[INNER]
    assert abs(inner_m.mean() - 3.0) < 0.003
    assert inner_m.std() < 0.007
    assert cloud.usable[INNER].mean() > 0.99
    assert np.degrees(np.arccos(np.median(-normals[INNER][..., 2]) / 127.0)) < 15


def test_edges_keep_their_sides_apart_and_points_in_the_air_go() -> None:
    depth_m = flat(3.0)
    depth_m[:, :80] = 1.5
    depth_m[:, 78:82] = np.linspace(1.5, 3.0, 6)[1:5]  # what a sensor sees between the two
    depth_m[40:42, 120:122] = 1.0  # a speck
    cloud, _ = MAKER.make(image(depth_m), None)
    kept_m = cloud.depth_m[cloud.usable > 0]
    assert np.all((np.abs(kept_m - 1.5) < 0.01) | (np.abs(kept_m - 3.0) < 0.01))
    assert cloud.usable[4:-4, 10:30].all()
    assert not cloud.usable[20, 60]


def test_surfaces_seen_too_flat_too_near_or_too_far_go() -> None:
    floor = depth_of_box(pose(), (-50, -50, -50), (50, 0.05, 50))
    assert not MAKER.make(image(np.where(floor > 4.9, 0, floor)), None)[0].usable[45:, 20:-20][:8].any()
    for depth in (0.1, 5.5):
        assert not MAKER.make(image(flat(depth)), None)[0].usable.any()
    assert MAKER.make(image(flat(4.5)), None)[0].usable[INNER].all()


def test_around_moving_pixels_those_at_their_depth_go_and_the_wall_behind_stays() -> None:
    depth_m = flat(3.0)
    depth_m[30:90, 40:100] = 1.5
    excluded = np.zeros(depth_m.shape, dtype=np.bool_)
    excluded[30:90, 40:94] = True  # a mask that leaves six columns of the mover out
    cloud, _ = MAKER.make(image(depth_m), excluded)
    assert not cloud.usable[15:45, 20:50].any()
    assert cloud.usable[16:44, 52:58].all()
    assert cloud.usable[4:12, 4:-4].all()


def test_moving_pixels_without_depth_take_nothing_else_along() -> None:
    depth_m = flat(2.0)
    depth_m[30:90, 40:100] = 0
    excluded = depth_m == 0
    assert MAKER.make(image(depth_m), excluded)[0].usable[4:12, 4:-4].all()


def test_depths_that_cannot_be_are_unknown() -> None:
    depth_m = np.array([[np.nan, np.inf, -1.0, 0.0, 14.0, 1.0, 13.0, 1e-5]], dtype=np.float32)
    units = in_units(depth_m, 1)
    assert units.tolist() == [[0, 0, 0, 0, 0, 5000, 65000, 0]]
    assert np.array_equal(smoothed(units) > 0, units > 0)


def test_units_are_those_of_every_second_pixel_of_odd_images_too() -> None:
    depth_m = np.random.default_rng(0).uniform(0.5, 4, (7, 9)).astype(np.float32)
    units = in_units(depth_m, 2)
    assert units.shape == (4, 5)
    assert np.abs(units * UNIT_M - depth_m[::2, ::2]).max() <= 0.5001 * UNIT_M
