"""The hash table and the sums of the voxels against plain dictionaries."""

from collections import defaultdict

import numpy as np
import pytest

from stillroom.dense.keyframe_cloud import UNIT_M, KeyframeCloud
from stillroom.dense.voxels.fusing_kernels import FULL_WEIGHT, HEAVIEST, NORMAL, PLACE, WEIGHT
from stillroom.dense.voxels.hash_kernels import EMPTY, HALF, keys_of, pack, pack_all, unpack
from stillroom.dense.voxels.voxel_map import VoxelMap
from stillroom.geometry import se3

SHAPE = 30, 40
VOXEL_M = 0.02


def random_cloud(seed: int) -> KeyframeCloud:
    rng = np.random.default_rng(seed)
    depth = rng.integers(2000, 20000, SHAPE, dtype=np.uint16)
    usable = (rng.random(SHAPE) < 0.8).astype(np.uint8)
    return KeyframeCloud(depth, rng.integers(0, 256, (*SHAPE, 3), dtype=np.uint8), usable)


def random_pose(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return se3.exp(rng.normal(0, [1, 1, 1, 0.5, 0.5, 0.5]))


def rays() -> np.ndarray:
    x, y = np.meshgrid(np.linspace(-0.6, 0.6, SHAPE[1]), np.linspace(-0.45, 0.45, SHAPE[0]))
    return np.stack((x, y), axis=-1).astype(np.float32)


def normals(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(-70, 70, (*SHAPE, 3)).astype(np.int8)


def put(voxels: VoxelMap, seed: int, cloud: KeyframeCloud | None = None) -> KeyframeCloud:
    cloud = cloud or random_cloud(seed)
    voxels.add(voxels.place(cloud, rays(), normals(seed), random_pose(seed)))
    return cloud


def take(voxels: VoxelMap, seed: int, cloud: KeyframeCloud, added_at: int = 0) -> None:
    voxels.subtract(voxels.place(cloud, rays(), normals(seed), random_pose(seed)), added_at)


def plain_sums(seeds: list[int]) -> dict[tuple[int, int, int], np.ndarray]:
    """Weight, mean position [m], mean colour by voxel, in plain numpy and a dictionary."""
    voxels: dict[tuple[int, int, int], np.ndarray] = defaultdict(lambda: np.zeros(7))
    for seed in seeds:
        cloud = random_cloud(seed)
        keep = cloud.usable > 0
        z = cloud.depth[keep] * float(UNIT_M)
        points = np.concatenate((rays()[keep].astype(np.float64) * z[:, None], z[:, None]), axis=1)
        world = se3.transform(random_pose(seed), points)
        weights = np.clip(np.floor(FULL_WEIGHT / z**2 + 0.5), 1, FULL_WEIGHT)
        for point, rgb, w in zip(world, cloud.rgb[keep], weights, strict=True):
            voxels[tuple(np.floor(point / VOXEL_M).astype(int))] += w * np.array([1.0, *point, *rgb])
    return {key: np.array([s[0], *(s[1:] / s[0])]) for key, s in voxels.items()}


def snapshot(voxels: VoxelMap) -> dict[int, tuple[int, ...]]:
    return {int(k): tuple(r[: NORMAL + 3]) for k, r in zip(voxels.key, voxels.rows, strict=True) if r[WEIGHT] > 0}


def test_keys_are_those_of_the_indices_and_back() -> None:
    rng = np.random.default_rng(0)
    indices = np.concatenate((rng.integers(-HALF, HALF, (500, 3)), [[-HALF] * 3, [HALF - 1] * 3, [0, 0, 0]]))
    keys = pack_all(indices)
    assert np.array_equal(unpack(keys), indices)
    assert all(pack(*map(int, index)) == key for index, key in zip(indices, keys, strict=True))
    assert len(np.unique(keys)) == len(np.unique(indices, axis=0))
    assert pack(HALF, 0, 0) == EMPTY
    assert pack_all(np.array([[0, -HALF - 1, 0]]))[0] == EMPTY


def test_sums_are_those_of_a_dictionary() -> None:
    voxels = VoxelMap(VOXEL_M)
    for seed in range(6):
        put(voxels, seed)
    expected = plain_sums(list(range(6)))
    assert voxels.n_rows == len(expected)
    rows = voxels.rows[voxels.rows_of(pack_all(np.array(list(expected))))].astype(np.float64)
    means = np.array(list(expected.values()))
    assert np.array_equal(rows[:, WEIGHT], means[:, 0])
    corner_m = np.array(list(expected)) * VOXEL_M
    inside_m = (rows[:, PLACE : PLACE + 3] / rows[:, :1] + 0.5) / 256 * VOXEL_M
    assert np.abs(corner_m + inside_m - means[:, 1:4]).max() < VOXEL_M / 256
    assert np.allclose(rows[:, 4:7] / rows[:, :1], means[:, 4:7])


def test_rows_are_found_after_growth_and_absent_ones_are_not() -> None:
    voxels = VoxelMap(VOXEL_M)
    rng = np.random.default_rng(1)
    keys = np.unique(pack_all(rng.integers(-3000, 3000, (400_000, 3))))
    rows = np.zeros((len(keys), 13), dtype=np.int32)
    rows[:, WEIGHT] = np.arange(len(keys)) + 1
    half = len(keys) // 2
    voxels.append_rows(keys[:half], rows[:half])
    assert np.array_equal(voxels.weight[voxels.rows_of(keys[:half])], rows[:half, WEIGHT])
    assert np.all(voxels.rows_of(keys[half:]) == -1)


def test_what_was_added_is_subtracted_to_the_last_bit_in_any_order() -> None:
    kept, mixed = VoxelMap(VOXEL_M), VoxelMap(VOXEL_M)
    for seed in (0, 2, 4):
        put(kept, seed)
    clouds = {seed: put(mixed, seed) for seed in range(6)}
    for seed in (5, 1, 3):
        take(mixed, seed, clouds[seed])
    assert snapshot(mixed) == snapshot(kept)
    for seed in (0, 2, 4):
        take(mixed, seed, clouds[seed])
    assert not mixed.rows[:, : NORMAL + 3].any()


def test_what_was_voided_since_is_not_subtracted_and_never_comes_back() -> None:
    voxels = VoxelMap(VOXEL_M)
    cloud = put(voxels, 0)
    voxels.void(np.arange(0, voxels.n_rows, 3), now=7, score=-5)
    keys_voided = voxels.key[::3].copy()
    n_before = int(cloud.usable.sum())
    take(voxels, 0, cloud, added_at=6)
    assert not voxels.weight.any()
    assert 0 < int(cloud.usable.sum()) < n_before
    put(voxels, 0, cloud)
    assert not voxels.weight[voxels.rows_of(keys_voided)].any()
    assert voxels.weight.any()


def test_what_was_voided_before_it_was_added_stays() -> None:
    voxels = VoxelMap(VOXEL_M)
    take(voxels, 0, put(voxels, 0))
    voxels.void(np.arange(voxels.n_rows), now=3, score=0)
    cloud = put(voxels, 0)
    n_before = int(cloud.usable.sum())
    take(voxels, 0, cloud, added_at=3)
    assert not voxels.weight.any()
    assert int(cloud.usable.sum()) == n_before


def test_a_full_voxel_takes_no_more_and_stays_exact() -> None:
    voxels = VoxelMap(VOXEL_M)
    cloud = put(voxels, 0)
    voxels.rows[:, WEIGHT] += HEAVIEST
    before = voxels.rows.copy()
    more = put(voxels, 0)
    assert not more.usable.any()
    assert np.array_equal(voxels.rows, before)
    take(voxels, 0, cloud)
    assert np.all(voxels.weight == HEAVIEST)


@pytest.mark.parametrize("place", [1e7, np.nan, np.inf])
def test_a_pose_out_of_this_world_adds_nothing(place: float) -> None:
    voxels, cloud = VoxelMap(VOXEL_M), random_cloud(0)
    T_world_cam = np.eye(4)
    T_world_cam[0, 3] = place
    voxels.add(voxels.place(cloud, rays(), normals(0), T_world_cam))
    assert not voxels.weight.any()


def test_points_fall_into_the_voxel_whose_corner_lies_below_them() -> None:
    assert np.array_equal(unpack(keys_of(np.array([[0.019, -0.001, 0.041]]), 0.02)), [[0, -1, 2]])
