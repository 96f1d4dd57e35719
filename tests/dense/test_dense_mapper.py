"""The dense mapper on simple shapes: corrected poses, removal, memory, bad input."""

import logging
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from building import parts
from plain_room import CAMERA, depth_of_box, flat, image, pose
from posed_keyframes import PosedKeyframes
from scipy.spatial import cKDTree

from stillroom.data.dense_cloud import DenseCloud
from stillroom.dense.carving import KD_TREE, CarvingConfig
from stillroom.dense.dense_mapper import MB, DenseMapper, DenseMapperConfig
from stillroom.dense.keyframe_cloud import SurfaceConfig
from stillroom.dense.voxels.fusing_kernels import SCORE
from stillroom.errors import ConfigError
from stillroom.geometry import se3

PLAIN = DenseMapperConfig(carving=CarvingConfig(removal=False))
FULL = DenseMapperConfig()
LOWER, UPPER = (-1.6, -1.2, -1.0), (1.5, 1.3, 2.4)


def in_a_box(n: int = 6) -> np.ndarray:
    """Poses of a camera that looks about in a room."""
    rng = np.random.default_rng(4)
    return np.array([pose(*rng.uniform(-0.4, 0.4, 3), turn=tuple(rng.uniform(-0.4, 0.4, 3))) for _ in range(n)])


def view(T_world_cam: np.ndarray, index: int):
    return image(depth_of_box(T_world_cam, LOWER, UPPER), index, seed=index)


def mapped(poses: np.ndarray, config: DenseMapperConfig, true_poses: np.ndarray | None = None) -> DenseMapper:
    """A map of the box from keyframes; what they see is by their true poses, where these differ."""
    mapper = config.build(parts(CAMERA, PosedKeyframes(poses)))
    for k, T_world_cam in enumerate(poses if true_poses is None else true_poses):
        mapper.integrate(k, view(T_world_cam, k), None)
    return mapper


def sums(mapper: DenseMapper) -> dict[int, tuple[int, ...]]:
    voxels = mapper.voxels
    used = voxels.weight > 0
    return {int(k): tuple(row[:SCORE]) for k, row in zip(voxels.key[used], voxels.rows[used], strict=True)}


def same(a: DenseCloud, b: DenseCloud) -> bool:
    names = ("positions_m", "normals", "rgb", "weight")
    return all(getattr(a, name).tobytes() == getattr(b, name).tobytes() for name in names)


def off_the_walls(points_m: np.ndarray) -> np.ndarray:
    return np.minimum(np.abs(points_m - LOWER), np.abs(points_m - UPPER)).min(axis=1)


def test_points_lie_on_the_walls_with_normals_inwards() -> None:
    cloud = mapped(in_a_box(), FULL).cloud()
    assert len(cloud) > 2000
    assert np.median(off_the_walls(cloud.positions_m)) < 0.002
    assert np.percentile(off_the_walls(cloud.positions_m), 99) < 0.015
    assert np.allclose(np.linalg.norm(cloud.normals, axis=1), 1, atol=1e-4)
    assert np.mean(np.sum(cloud.normals * (0.0 - cloud.positions_m), axis=1) > 0) > 0.999
    assert np.mean(np.abs(cloud.normals).max(axis=1) > 0.97) > 0.9
    assert cloud.voxel_m == 0.02


def test_a_corrected_map_is_the_map_of_the_right_poses_to_the_last_bit() -> None:
    true = in_a_box()
    wrong = true.copy()
    rng = np.random.default_rng(1)
    for k in (1, 2, 4):
        wrong[k] = true[k] @ se3.exp(rng.normal(0, 0.03, 6))
    mapper = mapped(wrong, replace(PLAIN, corrections=0), true)
    expected = mapped(true, PLAIN)
    assert sums(mapper) != sums(expected)
    mapper.world.keyframes.T_world_cam[:] = true
    mapper.refresh()
    assert sums(mapper) == sums(expected)
    assert same(mapper.cloud(), expected.cloud())
    before = mapper.voxels.rows.copy()
    mapper.refresh()
    assert np.array_equal(mapper.voxels.rows, before)


def test_corrections_come_with_new_keyframes_too() -> None:
    true = in_a_box(5)
    wrong = true.copy()
    wrong[1, :3, 3] += 0.1
    mapper = PLAIN.build(parts(CAMERA, PosedKeyframes(wrong)))
    for k in range(4):
        mapper.integrate(k, view(true[k], k))
    mapper.world.keyframes.T_world_cam[1] = true[1]
    mapper.integrate(4, view(true[4], 4))
    assert sums(mapper) == sums(mapped(true, PLAIN))


def test_a_culled_keyframe_goes_where_the_one_it_hangs_on_goes() -> None:
    true = in_a_box(3)
    shift = pose(0.05, -0.03, 0.02, (0.0, 0.02, 0.0))
    world = PosedKeyframes(true.copy())
    mapper = PLAIN.build(parts(CAMERA, world))
    for k in range(3):
        mapper.integrate(k, view(true[k], k))
    world.cull(2)
    world.keyframes.T_world_cam[1] = shift @ true[1]
    mapper.refresh()
    expected = PLAIN.build(parts(CAMERA, world))
    for k in range(3):
        expected.integrate(k, view(true[k], k))
    assert sums(mapper) == sums(expected)


def test_a_frame_fused_between_keyframes_goes_with_its_keyframe() -> None:
    true = in_a_box(2)
    world = PosedKeyframes(true[:1].copy())
    mapper = replace(PLAIN, fuse_every=1).build(parts(CAMERA, world))
    mapper.integrate(0, view(true[0], 0))
    mapper.carve(view(true[1], 1), true[1])
    world.keyframes.T_world_cam[0] = pose(0.5) @ true[0]
    mapper.refresh()
    expected = np.sort(mapped(pose(0.5) @ true, PLAIN, true).cloud().positions_m, axis=0)
    assert np.abs(np.sort(mapper.cloud().positions_m, axis=0) - expected).max() < 1e-4


def test_a_keyframe_that_comes_again_replaces_itself() -> None:
    true = in_a_box(3)
    mapper = mapped(true, PLAIN)
    mapper.integrate(1, view(true[1], 1))
    assert sums(mapper) == sums(mapped(true, PLAIN))


# Removal

BLOCK = np.s_[30:100, 60:110]


def with_block() -> np.ndarray:
    """A wall at 3 m, and something before it at 1.5 m."""
    depth_m = flat(3.0)
    depth_m[BLOCK] = 1.5
    return depth_m


def n_near(mapper: DenseMapper, z_m: float) -> int:
    z = mapper.cloud().positions_m[:, 2]
    return int((np.abs(z - z_m) < 0.1).sum())


def still(n: int = 60) -> PosedKeyframes:
    return PosedKeyframes(np.repeat(pose()[None], n, axis=0))


def test_what_is_marked_as_moving_is_never_fused_and_without_removal_it_is() -> None:
    moving = with_block() < 2
    for config, n_least, n_most in ((FULL, 0, 0), (PLAIN, 500, 9999)):
        mapper = config.build(parts(CAMERA, still()))
        for k in range(3):
            mapper.integrate(k, image(with_block(), k), moving)
        assert n_least <= n_near(mapper, 1.5) <= n_most
        assert n_near(mapper, 3.0) > 2000


def test_what_moves_now_is_removed_from_what_was_fused_before_and_what_lies_beside_it_stays() -> None:
    # A thing on a table: its foot touches what stays.
    depth_m = flat(1.5)
    moving = np.zeros(depth_m.shape, dtype=np.bool_)
    moving[BLOCK] = True
    mapper = replace(FULL, carving=CarvingConfig(every=1000)).build(parts(CAMERA, still()))
    mapper.integrate(0, image(depth_m))
    n_all = n_near(mapper, 1.5)
    mapper.integrate(1, image(depth_m), moving)
    px = CAMERA.project(mapper.cloud().positions_m.astype(np.float64))
    on_it = (px[:, 0] > 70) & (px[:, 0] < 100) & (px[:, 1] > 40) & (px[:, 1] < 90)
    beside = (px[:, 0] < 54) | (px[:, 0] > 116)
    assert on_it.sum() == 0
    assert beside.sum() > 0.95 * n_all * (160 - 50 - 6 - 6) / 160


TREE = DenseMapperConfig(carving=CarvingConfig(rule=KD_TREE), fuse_every=0)
"""OC-SLAM 2.6: all is fused, then what moved is removed by Kd-tree."""


def test_by_the_papers_rule_a_keyframe_removes_all_near_its_moving_points_and_nothing_else() -> None:
    moving, mapper, plain = with_block() < 2, TREE.build(parts(CAMERA, still())), PLAIN.build(parts(CAMERA, still()))
    for k, excluded in enumerate((None, moving)):
        mapper.integrate(k, image(with_block(), k), excluded)
        plain.integrate(k, image(with_block(), k), excluded)
    before, after = plain.cloud(), mapper.cloud()
    row, column = np.nonzero(moving)
    points_m = CAMERA.back_project(np.stack((column, row), axis=1), with_block()[moving])
    distance_m, _ = cKDTree(points_m).query(before.positions_m)
    near, radius_m = distance_m < 0.02, TREE.carving.radius_m
    kept = {tuple(point) for point in after.positions_m.tolist()}
    assert near.sum() > 500
    assert not any(tuple(point) in kept for point in before.positions_m[near].tolist())
    far = before.positions_m[distance_m > radius_m + 0.02]
    assert all(tuple(point) in kept for point in far.tolist())
    assert len(far) > 2000


def test_by_the_papers_rule_no_ray_carves_and_frames_between_keyframes_do_nothing() -> None:
    mapper = TREE.build(parts(CAMERA, still()))
    mapper.integrate(0, image(with_block(), 0))
    before = mapper.cloud()
    for k in range(1, 60):
        mapper.carve(image(flat(3.0), k), pose(), np.zeros(flat(3.0).shape, dtype=np.bool_))
    assert n_near(mapper, 1.5) > 200
    assert same(mapper.cloud(), before)


def test_by_the_papers_rule_too_what_was_removed_stays_removed_when_poses_change() -> None:
    world = still()
    mapper = TREE.build(parts(CAMERA, world))
    mapper.integrate(0, image(with_block(), 0))
    mapper.integrate(1, image(with_block(), 1), with_block() < 2)
    world.keyframes.T_world_cam[0] = pose(0.05)
    mapper.refresh()
    assert n_near(mapper, 1.5) == 0
    assert n_near(mapper, 3.0) > 2000


def test_what_was_removed_does_not_come_back_when_its_keyframe_is_fused_anew() -> None:
    world = still()
    mapper = FULL.build(parts(CAMERA, world))
    mapper.integrate(0, image(with_block()))
    assert n_near(mapper, 1.5) > 500
    mapper.integrate(1, image(with_block(), 1), with_block() < 2)
    assert n_near(mapper, 1.5) == 0
    for shift_m in (0.05, 0.3):
        world.keyframes.T_world_cam[0, :3, 3] = shift_m
        mapper.refresh()
        assert not np.any(mapper.cloud().positions_m[:, 2] < 2.5)


def frames(mapper: DenseMapper, depth_m: np.ndarray, first: int, n: int, keyframes: bool) -> None:
    for k in range(first, first + n):
        if keyframes:
            mapper.integrate(k, image(depth_m, k))
        else:
            mapper.carve(image(depth_m, k), pose())


@pytest.mark.parametrize("keyframes", [True, False])
def test_what_stood_for_long_goes_when_rays_pass_through_its_place(keyframes: bool) -> None:
    mapper = replace(FULL, carving=CarvingConfig(every=1)).build(parts(CAMERA, still()))
    frames(mapper, with_block(), 0, 20, keyframes=True)
    assert n_near(mapper, 1.5) > 500
    frames(mapper, flat(3.0), 20, 25, keyframes)
    assert n_near(mapper, 1.5) == 0
    assert n_near(mapper, 3.0) > 3000


@pytest.mark.parametrize("keyframes", [True, False])
def test_what_comes_to_stand_where_it_was_free_is_doubted_first_and_shown_in_the_end(keyframes: bool) -> None:
    mapper = replace(FULL, carving=CarvingConfig(every=1)).build(parts(CAMERA, still()))
    frames(mapper, flat(3.0), 0, 12, keyframes=True)
    mapper.integrate(12, image(with_block()))
    assert n_near(mapper, 1.5) == 0
    frames(mapper, with_block(), 13, 10, keyframes)
    assert n_near(mapper, 1.5) > 500


def test_what_was_free_is_still_known_after_the_map_has_jumped() -> None:
    """As when two sub-maps are joined, which lie half a kilometre apart."""
    world = still()
    mapper = replace(FULL, carving=CarvingConfig(every=1)).build(parts(CAMERA, world))
    frames(mapper, flat(3.0), 0, 12, keyframes=True)
    jump = pose(500.0, 1.0, 0.5, turn=(0.0, 0.7, 0.0))
    world.keyframes.T_world_cam[:] = jump @ world.keyframes.T_world_cam
    mapper.refresh()
    mapper.integrate(12, image(with_block()))
    z_m = se3.transform(se3.inverse(jump), mapper.cloud().positions_m.astype(np.float64))[:, 2]
    assert np.sum(np.abs(z_m - 3.0) < 0.1) > 2000
    assert not np.any(np.abs(z_m - 1.5) < 0.1)


def test_without_removal_nothing_is_carved() -> None:
    mapper = PLAIN.build(parts(CAMERA, still()))
    frames(mapper, with_block(), 0, 2, keyframes=True)
    n = n_near(mapper, 1.5)
    frames(mapper, flat(3.0), 2, 30, keyframes=True)
    assert n_near(mapper, 1.5) == n > 500


# Memory

SMALL = DenseMapperConfig(max_memory_mb=24.0, surface=SurfaceConfig(far_m=3.0))


N_TURNS = 30


def corridor(k: int) -> np.ndarray:
    """A camera that goes 100 m down an endless corridor, looking ahead and aside, and backs out again."""
    step = k if k < 1000 else 2000 - k
    return pose(0, 0, 0.1 * step, (0.0, 0.5 * np.sin(2 * np.pi * k / N_TURNS), 0.0))


@lru_cache(maxsize=N_TURNS)
def seen_in_corridor(turn: int):
    """What it sees: along the corridor, all places look alike."""
    T_world_cam = corridor(turn)
    T_world_cam[:3, 3] = 0
    return image(depth_of_box(T_world_cam, (-1.2, -1.0, -99), (1.1, 1.2, 99)), seed=turn)


def walk(config: DenseMapperConfig, n: int, every: int = 1) -> tuple[DenseMapper, float]:
    """Map the corridor; return the most memory that was held [MB]."""
    poses = np.array([corridor(k * every) for k in range(n)])
    mapper = config.build(parts(CAMERA, PosedKeyframes(poses)))
    most = 0
    for k in range(n):
        mapper.integrate(k, seen_in_corridor(k * every % N_TURNS))
        most = max(most, mapper.n_bytes)
    return mapper, most / MB


def test_a_thousand_keyframes_stay_within_the_bound() -> None:
    small = replace(SMALL, max_memory_mb=8.0, surface=SurfaceConfig(far_m=3.0, stride=4))
    mapper, most_mb = walk(small, 1000, every=2)
    assert most_mb <= small.max_memory_mb
    assert len(mapper._swapped) > 100
    assert mapper._clouds.n_swapped > 300
    points = mapper.cloud().positions_m
    walls = [points[:, 0] + 1.2, points[:, 0] - 1.1, points[:, 1] + 1.0, points[:, 1] - 1.2]
    assert np.percentile(np.abs(walls).min(axis=0), 99) < 0.02
    assert len(np.unique(points[:, 2].astype(int))) > 98


@pytest.mark.parametrize("removal", [True, False])
def test_what_was_swapped_out_and_back_is_what_never_left(removal: bool) -> None:
    tight = replace(SMALL, max_memory_mb=6.0, carving=CarvingConfig(removal=removal))
    mapper, most_mb = walk(tight, 250, 8)
    whole, whole_mb = walk(replace(tight, max_memory_mb=1000.0), 250, 8)
    assert most_mb <= 6.0 < 10.0 < whole_mb
    assert len(mapper._swapped) > 0
    assert mapper._clouds.n_swapped > 0
    assert same(mapper.cloud(), whole.cloud())
    for each in (mapper, whole):
        each.world.keyframes.T_world_cam[:60, 0, 3] += 0.05
        each.refresh()
    assert mapper.n_bytes <= 6.0 * MB
    if not removal:  # with it, how many earlier images are asked hangs on the memory there is
        assert same(mapper.cloud(), whole.cloud())


def test_a_swap_folder_that_takes_nothing_costs_corrections_and_memory_but_no_map(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    config = replace(SMALL, max_memory_mb=2.0, carving=CarvingConfig(removal=False), swap_folder=tmp_path / "absent")
    with caplog.at_level(logging.WARNING):
        mapper, _ = walk(config, 40, every=8)
    assert "can no longer be corrected" in caplog.text
    whole, _ = walk(replace(config, max_memory_mb=1000.0, swap_folder=None), 40, every=8)
    assert same(mapper.cloud(), whole.cloud())
    mapper.world.keyframes.T_world_cam[0, 0, 3] += 1.0
    mapper.refresh()


# Repeatable, and bad input


def test_the_same_input_gives_the_same_bytes() -> None:
    def run() -> DenseCloud:
        mapper = FULL.build(parts(CAMERA, PosedKeyframes(in_a_box(12))))
        for k, T_world_cam in enumerate(in_a_box(12)):
            moving = np.zeros((CAMERA.height, CAMERA.width), dtype=np.bool_)
            moving[20:60, 10 * k : 10 * k + 30] = True
            mapper.integrate(k, view(T_world_cam, k), moving)
            mapper.carve(view(T_world_cam, k + 50), T_world_cam, moving)
        mapper.world.keyframes.T_world_cam[3, 0, 3] += 0.1
        mapper.refresh()
        return mapper.cloud()

    assert same(run(), run())


def test_an_empty_map_has_an_empty_cloud() -> None:
    for config in (FULL, PLAIN):
        mapper = config.build(parts(CAMERA, still()))
        mapper.refresh()
        mapper.carve(image(flat(2.0)), pose())
        cloud = mapper.cloud()
        assert len(cloud) == 0
        assert cloud.positions_m.shape == cloud.normals.shape == cloud.rgb.shape == (0, 3)


@pytest.mark.parametrize("depth", [0.0, np.nan, np.inf, -1.0])
def test_images_without_depth_add_nothing_and_harm_nothing(depth: float) -> None:
    mapper = FULL.build(parts(CAMERA, still()))
    mapper.integrate(0, image(flat(2.0)))
    before = sums(mapper)
    mapper.integrate(1, image(flat(depth)))
    mapper.carve(image(flat(depth)), pose())
    assert sums(mapper) == before
    assert np.all(np.isfinite(mapper.cloud().positions_m))


def test_an_image_that_moves_all_over_adds_nothing() -> None:
    mapper = FULL.build(parts(CAMERA, still()))
    mapper.integrate(0, image(flat(2.0)), np.ones((CAMERA.height, CAMERA.width), dtype=np.bool_))
    assert len(mapper.cloud()) == 0


@pytest.mark.filterwarnings("ignore:invalid value encountered in matmul")
@pytest.mark.parametrize("where", [np.nan, np.inf, 1e9])
def test_impossible_poses_are_passed_over(where: float) -> None:
    world = still(4)
    mapper = FULL.build(parts(CAMERA, world))
    mapper.integrate(0, image(flat(2.0)))
    before = sums(mapper)
    world.keyframes.T_world_cam[1, 0, 3] = where
    mapper.integrate(1, image(flat(2.0)))
    far = pose()
    far[1, 3] = where
    mapper.carve(image(flat(2.0)), far)
    assert {key: row for key, row in sums(mapper).items() if key in before} == before
    mapper.integrate(2, image(flat(2.0)))
    assert len(mapper.cloud()) > 500


@pytest.mark.parametrize(
    ("config", "key"),
    [
        (replace(FULL, voxel_m=0.0), "voxel_m"),
        (replace(FULL, max_memory_mb=float("nan")), "max_memory_mb"),
        (replace(FULL, layer_voxels=-1), "layer_voxels"),
        (replace(FULL, surface=SurfaceConfig(stride=0)), "surface.stride"),
        (replace(FULL, surface=SurfaceConfig(near_m=2.0, far_m=1.0)), "surface.far_m"),
        (replace(FULL, carving=CarvingConfig(every=0)), "carving.every"),
        (replace(FULL, carving=CarvingConfig(lowest=1)), "carving.lowest"),
    ],
)
def test_impossible_values_are_named(config: DenseMapperConfig, key: str) -> None:
    with pytest.raises(ConfigError, match=f"'dense.{key}' is "):
        config.build(parts(CAMERA, still(1)))
