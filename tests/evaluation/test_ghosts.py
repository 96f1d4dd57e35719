"""Ghosts and completeness on hand-made geometry whose answers are known, and against slow references."""

import json
from dataclasses import replace

import numpy as np
import pytest

from stillroom.evaluation.ghost_truth import TrueScene, distances_to_patches_m, ghosts_by_truth
from stillroom.evaluation.ghost_views import DepthView, settled, sightings
from stillroom.evaluation.ghosts import (
    FreeSpaceConfig,
    Gatherer,
    completeness,
    empty_room,
    ghosts_in_free_space,
    seen_again,
)
from stillroom.geometry import se3
from stillroom.geometry.camera import Camera

CAMERA = Camera(64, 48, 60.0, 61.0, 31.5, 23.5)
BENT = replace(CAMERA, distortion=(0.26, -0.95, -0.005, 0.003, 1.16))


def wall(depth_m: float, camera: Camera = CAMERA) -> DepthView:
    return DepthView(np.full((camera.height, camera.width), depth_m, dtype=np.float32), np.eye(4))


def at_pixels(columns: np.ndarray, rows: np.ndarray, z_m: float, camera: Camera = CAMERA) -> np.ndarray:
    px = np.stack((columns, rows), axis=1).astype(np.float64)
    return camera.back_project(camera.undistort(px), np.full(len(px), z_m))


def at_inner_pixels(z_m: float, camera: Camera = CAMERA) -> np.ndarray:
    rows, columns = np.mgrid[1 : camera.height - 1, 1 : camera.width - 1]
    return at_pixels(columns.ravel(), rows.ravel(), z_m, camera)


@pytest.mark.parametrize("camera", [CAMERA, BENT], ids=["pinhole", "distorted"])
def test_a_plane_before_the_wall_is_the_whole_share(camera: Camera) -> None:
    clean, ghost = at_inner_pixels(2.0, camera), at_inner_pixels(1.0, camera)[:400]
    figure = ghosts_in_free_space(np.concatenate((clean, ghost)), [wall(2.0, camera)] * 3, camera)
    assert figure.n_points == 46 * 62 + 400
    assert figure.n_ghosts == figure.n_suspects == 400
    assert figure.share == pytest.approx(400 / (46 * 62 + 400))
    assert not figure.is_ghost[: len(clean)].any()
    assert json.loads(json.dumps(figure.to_dict()))["n_ghosts"] == 400


@pytest.mark.parametrize(
    ("wall_m", "point_m", "is_suspect", "is_ghost"),
    [
        (1.0, 0.951, False, False),
        (1.0, 0.949, True, False),
        (1.0, 0.901, True, False),
        (1.0, 0.899, True, True),
        (1.0, 1.3, False, False),
        (3.0, 2.911, False, False),
        (3.0, 2.909, True, False),
        (3.0, 2.819, True, True),
        (0.0, 1.0, False, False),
    ],
)
def test_rays_pass_by_more_than_5_cm_and_3_percent_and_ghosts_are_twice_as_far_from_any_surface(
    wall_m: float, point_m: float, is_suspect: bool, is_ghost: bool
) -> None:
    point = at_pixels(np.array([30]), np.array([20]), point_m)
    figure = ghosts_in_free_space(point, [wall(wall_m)] * 3, CAMERA)
    assert (figure.n_suspects, figure.n_ghosts) == (int(is_suspect), int(is_ghost))
    surfaces_do_not_matter = FreeSpaceConfig(may_agree=3)
    assert ghosts_in_free_space(point, [wall(wall_m)] * 3, CAMERA, surfaces_do_not_matter).n_ghosts == int(is_suspect)


def test_three_rays_are_needed_and_three_that_agree_clear_the_point() -> None:
    point = at_pixels(np.array([30]), np.array([20]), 1.0)
    assert ghosts_in_free_space(point, [wall(2.0)] * 2, CAMERA).n_ghosts == 0
    assert ghosts_in_free_space(point, [wall(2.0)] * 3 + [wall(1.0)] * 2, CAMERA).n_ghosts == 1
    cleared = ghosts_in_free_space(point, [wall(2.0)] * 3 + [wall(1.0)] * 3, CAMERA)
    assert (cleared.n_ghosts, cleared.n_suspects) == (0, 1)
    letter = FreeSpaceConfig(may_agree=100)
    assert ghosts_in_free_space(point, [wall(2.0)] * 3 + [wall(1.0)] * 3, CAMERA, letter).n_ghosts == 1


def test_one_neighbour_that_is_not_behind_stops_the_ray_and_unknown_ones_do_not() -> None:
    point = at_pixels(np.array([30]), np.array([20]), 1.0)

    def passes(row: int, column: int, depth_m: float) -> bool:
        view = wall(2.0)
        view.depth_m[row, column] = depth_m
        return bool(sightings(point, [view], CAMERA, 0.05, 0.03).passed[0])

    assert not passes(19, 31, 0.5)
    assert not passes(21, 29, 1.02)
    assert passes(19, 31, 0.0)
    assert not passes(20, 30, 0.0)
    assert passes(18, 30, 0.5)
    assert passes(20, 32, 0.5)


def test_what_is_not_in_the_image_is_not_judged() -> None:
    border = np.concatenate(
        (
            at_pixels(np.array([0, 63, 5, 5]), np.array([5, 5, 0, 47]), 1.0),
            at_pixels(np.array([-3, 70]), np.array([5, 60]), 1.0),
            [[0.0, 0.0, -1.0], [0.0, 0.0, 0.0]],
        )
    )
    seen = sightings(border, [wall(2.0)], CAMERA, 0.05, 0.03)
    assert not seen.passed.any()
    # Far outside, the distortion's polynomial comes back into the image; what it says there means nothing.
    folding = replace(CAMERA, distortion=(0.04, -0.1, 0.0, 0.0, 0.0))
    beside_px = np.array([[31.5 + 60.0 * 1.7, 23.5]])
    assert 2 < folding.distort(beside_px)[0, 0] < 61
    beside = folding.back_project(beside_px, np.ones(1))
    assert not sightings(beside, [wall(2.0)], folding, 0.05, 0.03).passed.any()


def test_the_ray_of_a_distorted_camera_is_bent() -> None:
    view = wall(0.5, BENT)
    view.depth_m[3:6, 57:60] = 4.0
    raw = np.array([[58.0, 4.0]])
    ray = BENT.back_project(BENT.undistort(raw), np.ones(1))
    straight = CAMERA.back_project(raw, np.ones(1))
    assert np.linalg.norm(BENT.undistort(raw) - raw) > 0.9
    assert sightings(ray, [view], BENT, 0.05, 0.03).passed[0] == 1
    assert sightings(straight, [view], BENT, 0.05, 0.03).passed[0] == 0
    assert sightings(straight, [view], CAMERA, 0.05, 0.03).passed[0] == 1


@pytest.mark.parametrize("reach_px", [0, 1, 2])
def test_sightings_are_those_of_a_slow_reference(reach_px: int) -> None:
    rng = np.random.default_rng(4)
    views = []
    for _ in range(6):
        depth_m = rng.uniform(0.8, 3.0, (48, 64)).astype(np.float32)
        depth_m = np.repeat(np.repeat(depth_m[:8, :8], 6, axis=0), 8, axis=1)
        depth_m[rng.random(depth_m.shape) < 0.1] = 0
        views.append(DepthView(depth_m, se3.exp(rng.normal(size=6) * 0.1)))
    points = rng.uniform((-1.0, -0.8, -0.5), (1.0, 0.8, 3.0), (600, 3))
    agree, passed = np.zeros(600, dtype=int), np.zeros(600, dtype=int)
    for view in views:
        cam = se3.transform(np.linalg.inv(view.T_world_cam), points)
        for i in np.flatnonzero(cam[:, 2] > 0.1):
            ideal = BENT.project(cam[i : i + 1])
            x0, y0, x1, y1 = BENT.undistorted_bounds_px
            if not (x0 <= ideal[0, 0] <= x1 and y0 <= ideal[0, 1] <= y1):
                continue
            column, row = np.floor(BENT.distort(ideal)[0] + 0.5).astype(int)
            if not (reach_px <= column < 64 - reach_px and reach_px <= row < 48 - reach_px):
                continue
            around = view.depth_m[row - reach_px : row + reach_px + 1, column - reach_px : column + reach_px + 1]
            known = around[around > 0].astype(float)
            bound = np.maximum(0.05, 0.03 * known)
            agree[i] += bool(np.any(np.abs(known - cam[i, 2]) <= bound))
            passed[i] += bool(view.depth_m[row, column] > 0 and np.all(known - cam[i, 2] > bound))
    seen = sightings(points, views, BENT, 0.05, 0.03, reach_px)
    np.testing.assert_array_equal(seen.passed, passed)
    np.testing.assert_array_equal(seen.agree, agree)
    assert passed.max() >= 3
    assert agree.sum() > 50


def test_half_a_wall_is_half_complete() -> None:
    y, z = np.mgrid[0:2:0.02, 0:1:0.02]
    surface = np.stack((np.zeros(y.size), y.ravel(), z.ravel()), axis=1)
    whole = completeness(surface + np.array([0.049, 0, 0]), surface)
    assert whole.share == 1.0
    assert completeness(surface + np.array([0.051, 0, 0]), surface).share == 0.0
    half = completeness(surface[surface[:, 1] < 0.945], surface)  # 5 cm beyond, it still counts as found
    assert half.n_found == int((surface[:, 1] < 0.991).sum())
    assert half.share == pytest.approx(0.5)
    assert completeness(np.zeros((0, 3)), surface).share == 0.0
    assert completeness(surface, np.zeros((0, 3))).n_points == 0
    assert completeness(np.zeros((1, 3)), np.array([[0.05, 0, 0]])).share == 1.0
    assert json.loads(json.dumps(half.to_dict()))["share"] == pytest.approx(0.5)


def test_gathered_cells_are_those_of_a_dictionary(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("stillroom.evaluation.ghosts.MERGE_ABOVE", 2000)
    rng = np.random.default_rng(2)
    gatherer, naive = Gatherer(BENT, 0.1, stride=2), {}
    for image in range(7):
        depth_m = rng.uniform(0.5, 2.0, (48, 64)).astype(np.float32)
        depth_m[rng.random(depth_m.shape) < 0.2] = 0
        keep, T_world_cam = rng.random(depth_m.shape) < 0.7, se3.exp(rng.normal(size=6) * 0.2)
        gatherer.add(depth_m, T_world_cam, keep, reach_m=1.8)
        for row in range(0, 48, 2):
            for column in range(0, 64, 2):
                if not (keep[row, column] and 0 < depth_m[row, column] <= 1.8):
                    continue
                point = at_pixels(np.array([column]), np.array([row]), depth_m[row, column], BENT)
                point = se3.transform(T_world_cam, point)[0]
                points, images = naive.setdefault(tuple(np.floor(point / 0.1).astype(int)), ([], set()))
                points.append(point)
                images.add(image)
    for seen_by in (1, 3):
        expected = np.array([np.mean(p, axis=0) for _, (p, seen) in sorted(naive.items()) if len(seen) >= seen_by])
        assert len(expected) > 10
        np.testing.assert_allclose(gatherer.points(seen_by), expected, atol=1e-9)


def test_nothing_gathered_is_no_points() -> None:
    assert Gatherer(CAMERA).points().shape == (0, 3)


def test_the_room_is_what_several_images_saw_and_later_ones_see_again() -> None:
    config = FreeSpaceConfig(seen_by=3, again_by=2, reach_m=2.5)
    stray = wall(2.0)
    stray.depth_m[:, :8] = 1.0
    far = wall(2.0)
    far.depth_m[:, 40:] = 3.0
    room = empty_room([far, far, stray], CAMERA, config)
    assert np.abs(room[:, 2] - 2.0).max() < 1e-6
    assert at_pixels(np.array([8]), np.array([9]), 2.0)[0, 0] - 0.06 < room[:, 0].min()
    assert room[:, 0].max() < at_pixels(np.array([40]), np.array([9]), 2.0)[0, 0]
    hidden = wall(2.0)
    hidden.depth_m[:24] = 1.2
    lower = seen_again(room, [hidden, hidden, wall(2.2)], CAMERA, config)
    edge_m = at_pixels(np.array([9]), np.array([23.5]), 2.0)[0, 1]
    np.testing.assert_array_equal(lower, room[room[:, 1] > edge_m])
    assert 0 < len(lower) < len(room)
    assert len(seen_again(room, [hidden, wall(2.2)], CAMERA, config)) == 0


def test_a_surface_smeared_by_noise_settles_in_one_layer() -> None:
    rng = np.random.default_rng(5)
    views = []
    for k in range(24):
        T_world_cam = se3.exp(np.array([0.02 * k, 0.01 * k, 0, 0, 0.005 * k, 0]))
        rows, columns = np.mgrid[0:48, 0:64]
        rays = BENT.back_project(BENT.undistort(np.stack((columns.ravel(), rows.ravel()), axis=1)), np.ones(48 * 64))
        # The wall z = 2.04 of the world, along each ray, with noise of 3 cm.
        exact_m = (2.04 - T_world_cam[2, 3]) / (rays @ T_world_cam[2, :3])
        depth_m = (exact_m + rng.normal(0, 0.03, len(rays))).reshape(48, 64).astype(np.float32)
        views.append(DepthView(depth_m, T_world_cam))
    smeared = np.stack((*rng.uniform(-0.3, 0.5, (2, 500)), rng.uniform(1.97, 2.11, 500)), axis=1)
    layer = settled(settled(smeared, views, BENT, 0.1, 0.06), views, BENT, 0.1, 0.06)
    assert np.abs(layer[:, 2] - 2.04).mean() < 0.01
    assert np.abs(smeared[:, 2] - 2.04).mean() > 0.03
    far = np.array([[0.0, 0.0, 1.5], [0.0, 0.0, -1.0], [9.0, 0.0, 2.0]])
    np.testing.assert_array_equal(settled(far, views, BENT, 0.1, 0.06), far)
    room = empty_room(views, BENT, FreeSpaceConfig(voxel_m=0.08))
    inner = room[(np.abs(room[:, 0] - 0.2) < 0.4) & (np.abs(room[:, 1] - 0.1) < 0.3)]
    assert len(inner) == pytest.approx(0.8 * 0.6 / 0.08**2, rel=0.2)
    assert np.abs(inner[:, 2] - 2.04).max() < 0.04


def test_distances_to_patches_are_those_to_their_samples() -> None:
    rng = np.random.default_rng(3)
    patches = rng.uniform(-1, 1, (12, 9))
    is_triangle = np.arange(12) % 2 == 1
    points = rng.uniform(-2, 2, (150, 3))
    steps = np.linspace(0, 1, 51)
    s, t = (grid.ravel()[:, None] for grid in np.meshgrid(steps, steps))
    nearest = np.full(len(points), np.inf)
    for patch, triangle in zip(patches, is_triangle, strict=True):
        inside = (s + t <= 1 + 1e-9)[:, 0] if triangle else np.ones(len(s), dtype=bool)
        samples = (patch[:3] + s * patch[3:6] + t * patch[6:])[inside]
        to_samples = np.linalg.norm(points[:, None] - samples, axis=2).min(axis=1)
        nearest = np.minimum(nearest, to_samples)
        one = distances_to_patches_m(points, patch[None], np.array([triangle]))
        assert (one <= to_samples + 1e-12).all()
        np.testing.assert_allclose(one, to_samples, atol=0.03)
    found = distances_to_patches_m(points, patches, is_triangle)
    assert (found <= nearest + 1e-12).all()
    np.testing.assert_allclose(found, nearest, atol=0.03)
    assert np.isinf(distances_to_patches_m(points, np.zeros((0, 9)), np.zeros(0, dtype=bool))).all()


def test_a_ghost_by_truth_is_off_the_surface_where_a_mover_was() -> None:
    floor = np.array([[0.0, 0, 0, 4, 0, 0, 0, 4, 0]])
    mover = np.array([[1.0, 1.0, 1.0]])
    scene = TrueScene(floor, np.array([False]), np.array([[1.0, 1, 0], [2, 2, 0]]), mover)
    points = np.array(
        [
            [1.0, 1.0, 1.09],  # where the mover was
            [1.0, 1.0, 1.11],  # too far from it
            [1.0, 1.0, 0.04],  # on the floor
            [2.0, 2.0, -0.02],
            [3.0, 3.0, 0.06],  # off it, but nobody was there
        ]
    )
    ghosts, surface = ghosts_by_truth(points, scene)
    np.testing.assert_array_equal(ghosts.is_ghost, [True, False, False, False, False])
    assert (ghosts.share, ghosts.n_suspects) == (0.2, 3)
    assert surface.n_astray == 2
    assert surface.error_m is not None
    assert surface.error_m.median == pytest.approx(0.05)
    assert surface.error_m.max == pytest.approx(1.11)
    nothing, none = ghosts_by_truth(np.zeros((0, 3)), scene)
    assert (nothing.share, none.error_m) == (0.0, None)
    assert json.loads(json.dumps(surface.to_dict()))["n_astray"] == 2
