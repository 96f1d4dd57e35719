"""What depth rays say of points, and what follows from it."""

import numpy as np
import pytest
from plain_room import CAMERA, DISTORTED, flat, image, pose

from stillroom.dense.carving import MovingPoints, small_depth, views_of
from stillroom.dense.keyframe_cloud import UNIT_M, CloudMaker, SurfaceConfig
from stillroom.dense.voxels.evidence_kernels import (
    HIT,
    NOTHING,
    PASSED,
    Scoring,
    Seeing,
    SmallDepthView,
    VoxelColumns,
    answers,
    count_in_view,
    judge_in_view,
)
from stillroom.dense.voxels.fusing_kernels import SCORE, VOIDED_AT
from stillroom.dense.voxels.voxel_map import VoxelMap
from stillroom.geometry import se3

STRIDE = 4
SEEING = Seeing(float(UNIT_M), STRIDE, 0.05, 0.035)
T_WORLD_CAM = pose(0.3, -0.2, 0.1, (0.1, -0.2, 0.05))


def points_at(depth_m: float, raw_px: np.ndarray, camera=CAMERA) -> np.ndarray:
    """Points (N, 3) [m, world] that the camera sees at pixels (N, 2) at a depth."""
    cam = camera.back_project(camera.undistort(raw_px.astype(np.float32)), np.full(len(raw_px), depth_m))
    return se3.transform(T_WORLD_CAM, cam).astype(np.float32)


def said(points_m: np.ndarray, depth_m: np.ndarray, moving: np.ndarray | None = None, camera=CAMERA) -> list[int]:
    views = views_of(small_depth(depth_m, moving, STRIDE))
    return list(answers(points_m, SmallDepthView(se3.inverse(T_WORLD_CAM), camera.lens, views), SEEING))


def grid() -> np.ndarray:
    return np.stack(np.meshgrid([20, 80, 140], [16, 60, 100]), axis=-1).reshape(-1, 2)


@pytest.mark.parametrize("camera", [CAMERA, DISTORTED])
@pytest.mark.parametrize(
    ("depth_m", "answer"), [(1.0, PASSED), (1.85, PASSED), (1.95, HIT), (2.0, HIT), (2.05, HIT), (2.2, NOTHING)]
)
def test_before_a_wall_rays_pass_at_it_they_hit_behind_it_they_say_nothing(camera, depth_m, answer) -> None:
    assert said(points_at(depth_m, grid(), camera), flat(2.0), camera=camera) == [answer] * 9


def test_the_image_is_asked_where_the_lens_bends_the_ray_to() -> None:
    depth_m = flat(3.0)
    corner = np.array([[8, 8]])
    depth_m[:16, :16] = 1.0
    assert said(points_at(1.0, corner, DISTORTED), depth_m, camera=DISTORTED) == [HIT]
    just_outside = np.array([[24, 24]])
    assert said(points_at(1.0, just_outside, DISTORTED), depth_m, camera=DISTORTED) == [PASSED]


def test_unknown_pixels_and_places_out_of_view_say_nothing() -> None:
    assert said(points_at(1.0, grid()), flat(0.0)) == [NOTHING] * 9
    outside = points_at(1.0, np.array([[-30, 60], [200, 60], [80, -40], [80, 170]]))
    behind = se3.transform(T_WORLD_CAM, np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 0.0]])).astype(np.float32)
    assert said(np.concatenate((outside, behind)), flat(2.0)) == [NOTHING] * 6


def test_one_neighbour_at_the_depth_saves_a_thin_thing() -> None:
    depth_m = flat(3.0)
    depth_m[:, 84:88] = 1.5  # a pole, one sample wide
    beside = np.array([[80, 60]])
    assert said(points_at(1.5, beside), depth_m) == [HIT]
    assert said(points_at(1.5, np.array([[72, 60]])), depth_m) == [PASSED]


def test_a_ray_that_ends_on_something_moving_passes_what_is_before_it_but_shows_no_surface() -> None:
    moving = np.ones((CAMERA.height, CAMERA.width), dtype=np.bool_)
    assert said(points_at(1.0, grid()), flat(2.0), moving) == [PASSED] * 9
    assert said(points_at(2.0, grid()), flat(2.0), moving) == [NOTHING] * 9


def wall_of_voxels(depth_m: float) -> VoxelMap:
    maker, voxels = CloudMaker(SurfaceConfig(), CAMERA), VoxelMap(0.02)
    cloud, normals = maker.make(image(flat(depth_m)), None)
    voxels.add(voxels.place(cloud, maker.rays, normals, T_WORLD_CAM))
    return voxels


def judge(voxels: VoxelMap, depth_m: float, times: int, now: int = 9) -> int:
    T_cam_world, lens = se3.inverse(T_WORLD_CAM), CAMERA.lens
    near = voxels.blocks_near(T_cam_world, lens, (CAMERA.width, CAMERA.height), 5.0)
    views = views_of(small_depth(flat(depth_m), None, STRIDE))
    view, judged = SmallDepthView(T_cam_world, lens, views), VoxelColumns(voxels.key, voxels.rows, 0.02)
    return sum(judge_in_view(near, judged, now, view, SEEING, Scoring(2, -10, 12)) for _ in range(times))


def test_hits_and_passes_move_the_score_within_limits_and_a_pass_at_the_lowest_empties() -> None:
    voxels = wall_of_voxels(2.0)
    n = len(voxels.weight)
    assert judge(voxels, 2.0, times=3) == 0
    assert n > 3000
    assert np.all(voxels.rows[:, SCORE] == 6)
    judge(voxels, 2.0, times=5)
    assert np.all(voxels.rows[:, SCORE] == 12)
    assert judge(voxels, 4.0, times=22) == 0
    assert np.all(voxels.rows[:, SCORE] == -10)
    assert voxels.weight.all()
    assert judge(voxels, 4.0, times=1, now=17) == n
    assert not voxels.weight.any()
    assert not voxels.rows[:, :SCORE].any()
    assert np.all(voxels.rows[:, VOIDED_AT] == 17)


def test_every_block_that_holds_a_voxel_in_view_is_near() -> None:
    rng = np.random.default_rng(3)
    voxels = VoxelMap(0.02)
    points = rng.uniform(-6, 6, (4000, 3))
    keys = np.unique(np.array([hash_key(p) for p in points]))
    rows = np.ones((len(keys), 13), dtype=np.int32)
    voxels.append_rows(keys, rows)
    T_cam_world, lens = se3.inverse(T_WORLD_CAM), CAMERA.lens
    near = voxels.blocks_near(T_cam_world, lens, (CAMERA.width, CAMERA.height), 4.0)
    from stillroom.dense.voxels.hash_kernels import unpack

    cam = se3.transform(T_cam_world, (unpack(voxels.key) + 0.5) * 0.02)
    px = CAMERA.project(np.where(cam[:, 2:] > 0.05, cam, 1.0))
    seen = (cam[:, 2] > 0.05) & (cam[:, 2] < 4.0) & np.all((px >= 0) & (px < (160, 120)), axis=1)
    assert seen.sum() > 50
    assert near[voxels.block[seen]].all()
    assert near.mean() < 0.5
    counts = count_in_view(
        ((unpack(voxels.key) + 0.5) * 0.02).astype(np.float32), T_cam_world[None], lens, 160, 120, 4.0
    )
    assert abs(int(counts[0]) - int(seen.sum())) <= 3


def hash_key(point: np.ndarray) -> int:
    from stillroom.dense.voxels.hash_kernels import keys_of

    return int(keys_of(point[None], 0.02)[0])


def test_near_moving_is_what_brute_force_finds() -> None:
    rng = np.random.default_rng(5)
    moving, candidates = rng.uniform(0, 1, (200, 3)), rng.uniform(-0.5, 1.5, (3000, 3)).astype(np.float32)
    distances = np.linalg.norm(candidates[:, None] - moving[None], axis=2).min(axis=1)
    points = MovingPoints(moving)
    near, perhaps = points.near(candidates, 0.05), points.perhaps_near(candidates, 0.05)
    assert near.sum() > 20
    assert np.array_equal(near, distances < 0.05)
    assert perhaps[near].all()
    assert distances[perhaps].max() < 0.05 * 2 * np.sqrt(3)
    assert perhaps.mean() < 0.5
    nothing = MovingPoints(np.zeros((0, 3)))
    assert not nothing.near(candidates, 0.05).any()
    assert not nothing.perhaps_near(candidates, 0.05).any()
    for ask in (points.near, points.perhaps_near):
        assert len(ask(np.zeros((0, 3), np.float32), 0.05)) == 0


def test_none_is_missed_where_cells_must_be_large() -> None:
    rng = np.random.default_rng(6)
    moving, candidates = rng.uniform(-20, 20, (300, 3)), rng.uniform(-21, 21, (20000, 3)).astype(np.float32)
    candidates[:300] = moving + rng.uniform(-0.02, 0.02, (300, 3))
    points = MovingPoints(moving)
    near = points.near(candidates, 0.05)
    assert near.sum() >= 300
    assert points.perhaps_near(candidates, 0.05)[near].all()
