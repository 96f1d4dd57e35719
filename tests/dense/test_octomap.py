"""The occupancy map of keyframes: rays against plain loops, its arithmetic, corrected poses, and its file."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from building import parts
from plain_room import CAMERA, depth_of_box, flat, image, pose, rays
from posed_keyframes import PosedKeyframes

from stillroom.bounds import in_pixels_of
from stillroom.data.dense_cloud import DenseCloud, load_cloud
from stillroom.datasets.open import open_dataset
from stillroom.dense.export.octomap import write_octomap
from stillroom.dense.octomap import OctoMap, OctoMapConfig
from stillroom.dense.voxels.hash_kernels import pack_all, unpack
from stillroom.errors import ConfigError, MapError
from stillroom.geometry import se3
from stillroom.presets.registry import configure
from stillroom.session.slam import Slam

PLAIN = OctoMapConfig(stride=4, excluded_margin_px=0)
LOWER, UPPER = (-1.6, -1.2, -1.0), (1.5, 1.3, 2.4)
HIT, MISS = np.log(0.7 / 0.3), np.log(0.4 / 0.6)
LOWEST, HIGHEST = np.log(0.12 / 0.88), np.log(0.97 / 0.03)
UNIT_M = np.float32(2e-4)


def in_a_box(n: int = 4) -> np.ndarray:
    """Poses of a camera that looks about in a room."""
    rng = np.random.default_rng(4)
    return np.array([pose(*rng.uniform(-0.4, 0.4, 3), turn=tuple(rng.uniform(-0.4, 0.4, 3))) for _ in range(n)])


def view(T_world_cam: np.ndarray, index: int):
    return image(depth_of_box(T_world_cam, LOWER, UPPER), index, seed=index)


def mapped(poses: np.ndarray, config: OctoMapConfig = PLAIN, true_poses: np.ndarray | None = None) -> OctoMap:
    """A map of the box from keyframes; what they see is by their true poses, where these differ."""
    made = config.build(parts(CAMERA, PosedKeyframes(poses)))
    for k, T_world_cam in enumerate(poses if true_poses is None else true_poses):
        made.integrate(k, view(T_world_cam, k))
    return made


def before_a_wall(*depths_m: float | np.ndarray, config: OctoMapConfig = PLAIN) -> OctoMap:
    """A map from keyframes at one place, whose images have these depths."""
    made = config.build(parts(CAMERA, PosedKeyframes(np.stack([np.eye(4)] * len(depths_m)))))
    for k, depth_m in enumerate(depths_m):
        made.integrate(k, image(flat(depth_m) if np.isscalar(depth_m) else depth_m, k))
    return made


def odds(made: OctoMap) -> dict[tuple[int, ...], float]:
    """Log-odds by index of the voxel."""
    return dict(zip(map(tuple, unpack(made.grid.key).tolist()), made.grid.log_odds.tolist(), strict=True))


def occupied(cloud: DenseCloud) -> set[tuple[int, ...]]:
    return set(map(tuple, np.floor(cloud.positions_m.astype(np.float64) / cloud.voxel_m).astype(int).tolist()))


def straight_on(made: OctoMap, depth_m: float) -> float:
    """Log-odds of the voxel that the middle of the image shows at a depth."""
    edge = made.config.resolution_m
    return odds(made)[tuple(np.floor(np.array([1e-3, 1e-3, depth_m]) / edge).astype(int))]


def same(a: DenseCloud, b: DenseCloud) -> bool:
    names = ("positions_m", "normals", "rgb", "weight", "free")
    return all(getattr(a, name).tobytes() == getattr(b, name).tobytes() for name in names)


# Rays


def plain_scan(depth_m: np.ndarray, T_world_cam: np.ndarray, config: OctoMapConfig) -> tuple[set, set]:
    """Voxels that are hit and missed, by the places where each ray crosses a side of a voxel."""
    edge, hit, missed = config.resolution_m, set(), set()
    step = config.stride
    directions = rays(CAMERA)[::step, ::step].reshape(-1, 3)
    start = T_world_cam[:3, 3] / edge
    for ray, z in zip(directions, depth_m[::step, ::step].ravel(), strict=True):
        z_m = float(np.uint16(z / UNIT_M + 0.5) * UNIT_M)
        if not config.near_m <= z_m <= config.far_m:
            continue
        end = (T_world_cam[:3, :3] @ (ray.astype(np.float32) * z_m) + T_world_cam[:3, 3]) / edge
        length_m = z_m * np.linalg.norm(ray)
        if length_m > config.max_range_m:
            end = start + config.max_range_m / length_m * (end - start)
        else:
            hit.add(tuple(np.floor(end).astype(int).tolist()))
        crossings = [0.0, 1.0]
        for axis in range(3):
            low, high = sorted((start[axis], end[axis]))
            sides = np.arange(np.floor(low) + 1, np.ceil(high))
            crossings += ((sides - start[axis]) / (end[axis] - start[axis])).tolist()
        shares = np.sort(crossings)
        middles = start + 0.5 * (shares[:-1] + shares[1:])[:-1, None] * (end - start)
        missed |= set(map(tuple, np.floor(middles[np.diff(shares)[:-1] > 1e-9]).astype(int).tolist()))
    return hit, missed - hit


@pytest.mark.parametrize("max_range_m", [5.0, 2.3])
def test_a_scan_hits_and_misses_the_voxels_that_its_rays_cross(max_range_m: float) -> None:
    config = replace(PLAIN, max_range_m=max_range_m)
    T_world_cam = in_a_box(1)[0]
    hit, missed = plain_scan(view(T_world_cam, 0).depth_m, T_world_cam, config)
    found = odds(mapped(T_world_cam[None], config))
    ends = {index for index, value in found.items() if value > 0}
    between = set(found) - ends
    assert len(missed) > 5000
    assert len(hit) > 500
    # A ray that passes within rounding of an edge may lie on either side of it.
    assert len(ends ^ hit) <= 2
    assert len(between ^ missed) <= 0.001 * len(missed)
    values = np.array(list(found.values()))
    np.testing.assert_allclose(values[values > 0], HIT, atol=1e-6)
    np.testing.assert_allclose(values[values < 0], MISS, atol=1e-6)


def test_a_ray_along_an_axis_and_one_that_ends_where_it_starts() -> None:
    one_ray, tenth = flat(0.0), replace(PLAIN, resolution_m=0.1)
    one_ray[60, 80] = 1.05  # on the axis in y, a pixel beside it in x
    assert odds(before_a_wall(one_ray, config=tenth)) == {
        **{(0, 0, k): pytest.approx(MISS) for k in range(10)},
        (0, 0, 10): pytest.approx(HIT),
    }
    near = before_a_wall(np.where(one_ray > 0, 0.02, 0.0).astype(np.float32), config=tenth)
    assert odds(near) == {(0, 0, 0): pytest.approx(HIT)}


def test_more_voxels_than_there_is_room_for_at_first() -> None:
    fine = replace(PLAIN, resolution_m=0.02, stride=2)
    T_world_cam = in_a_box(1)[0]
    made = mapped(T_world_cam[None], fine)
    assert made.grid.n_rows > 2**16
    assert len(np.unique(made.grid.key)) == made.grid.n_rows
    assert np.array_equal(made.grid.rows_of(made.grid.key), np.arange(made.grid.n_rows))
    hit, missed = plain_scan(view(T_world_cam, 0).depth_m, T_world_cam, fine)
    assert len(set(odds(made)) ^ (hit | missed)) <= 0.001 * made.grid.n_rows


# Log-odds


def test_a_wall_is_occupied_at_once_and_bounded_at_the_upper_clamp() -> None:
    for n, expected in ((1, HIT), (3, 3 * HIT), (4, 4 * HIT), (5, HIGHEST), (20, HIGHEST)):
        made = before_a_wall(*[2.02] * n)
        assert straight_on(made, 2.02) == pytest.approx(expected, abs=1e-5)
        assert straight_on(made, 1.0) == pytest.approx(max(n * MISS, LOWEST), abs=1e-5)
        cloud = made.cloud()
        assert np.allclose(cloud.positions_m[:, 2], 2.02, atol=1e-3)
        assert np.mean(cloud.normals[:, 2] < -0.999) > 0.85  # pixels at the border of the image lie on no surface


def test_a_free_voxel_becomes_occupied_after_three_hits_and_an_occupied_one_free_after_nine_misses() -> None:
    """Figures of octomap_server's values: from the lower clamp, and from the upper."""
    away, person = 2.02, 1.02
    for n_hits, is_occupied in ((2, False), (3, True)):
        made = before_a_wall(*[away] * 10, *[person] * n_hits)
        assert (straight_on(made, person) >= 0) == is_occupied
        assert straight_on(made, person) == pytest.approx(LOWEST + n_hits * HIT, abs=1e-5)
        assert (np.abs(made.cloud().positions_m[:, 2] - person).min() < 0.01) == is_occupied
    for n_misses, is_occupied in ((8, True), (9, False)):
        made = before_a_wall(*[person] * 10, *[away] * n_misses)
        assert (straight_on(made, person) >= 0) == is_occupied
        assert straight_on(made, person) == pytest.approx(HIGHEST + n_misses * MISS, abs=1e-5)
        assert (np.abs(made.cloud().positions_m[:, 2] - person).min() < 0.01) == is_occupied


def test_within_a_scan_a_voxel_changes_once_and_a_hit_has_priority() -> None:
    """A floor seen at a grazing angle: its voxels are ends of some rays, and on the way of others."""
    config, T_world_cam = replace(PLAIN, stride=1, resolution_m=0.1), pose(turn=(0.01, 0.01, 0.0))
    depth_m = depth_of_box(T_world_cam, (-9, -9, -9), (9, 0.31, 4.02))
    made = config.build(parts(CAMERA, PosedKeyframes(T_world_cam[None])))
    made.integrate(0, image(depth_m))
    hit, _ = plain_scan(depth_m, T_world_cam, config)
    found = odds(made)
    assert sum(found.get(index) == pytest.approx(HIT) for index in hit) >= len(hit) - 2 > 500
    assert set(np.unique(np.round(list(found.values()), 4))) == {round(HIT, 4), round(MISS, 4)}


def test_the_colour_is_the_mean_of_the_hits() -> None:
    made = PLAIN.build(parts(CAMERA, PosedKeyframes(np.stack([np.eye(4)] * 2))))
    for k, color in enumerate((40, 80)):
        seen = image(flat(1.52), k)
        made.integrate(k, replace(seen, rgb=np.full_like(seen.rgb, color)))
    assert set(np.unique(made.cloud().rgb)) == {60}


# What is left out


def test_rays_of_excluded_pixels_and_of_the_margin_around_them_do_nothing() -> None:
    excluded = np.zeros((CAMERA.height, CAMERA.width), dtype=bool)
    excluded[40:80, 60:100] = True
    margin_px = 10
    config = replace(PLAIN, stride=1, excluded_margin_px=margin_px)
    assert in_pixels_of(OctoMapConfig(), 2.0).excluded_margin_px == 40
    made = config.build(parts(CAMERA, PosedKeyframes(np.eye(4)[None])))
    made.integrate(0, image(flat(2.02)), excluded)
    wide = np.zeros_like(excluded)
    wide[40 - margin_px : 80 + margin_px, 60 - margin_px : 100 + margin_px] = True
    expected = before_a_wall(np.where(wide, 0.0, flat(2.02)), config=config)
    assert odds(made) == odds(expected)
    assert (0, 0, 20) not in odds(made)
    assert same(made.cloud(), expected.cloud())


def test_depths_out_of_range_are_left_out_and_long_rays_only_free() -> None:
    assert before_a_wall(9.0).grid.n_rows == 0
    assert before_a_wall(np.full((CAMERA.height, CAMERA.width), np.nan, np.float32)).grid.n_rows == 0
    made = before_a_wall(7.0)
    assert len(made.cloud()) == 0
    reach_m = np.linalg.norm((made.cloud().free + 0.5) * 0.05, axis=1).max()
    assert 4.9 < reach_m < 5.05


def test_frames_between_keyframes_do_nothing_and_neither_do_keyframes_without_a_pose() -> None:
    made = before_a_wall(2.02)
    before = odds(made)
    made.carve(image(flat(3.0), 1), np.eye(4))
    assert odds(made) == before
    lost = PLAIN.build(parts(CAMERA, PosedKeyframes(np.full((1, 4, 4), np.nan))))
    lost.integrate(0, image(flat(2.0)))
    assert lost.grid.n_rows == 0
    assert len(lost.cloud()) == 0


# Corrected poses


@pytest.mark.parametrize("max_memory_mb", [256.0, 0.001])
def test_a_corrected_map_is_the_map_of_the_right_poses_to_the_last_bit(max_memory_mb: float) -> None:
    config = replace(PLAIN, max_memory_mb=max_memory_mb)  # with the clouds in memory, and in a file
    true = in_a_box()
    wrong = true.copy()
    wrong[1] = true[1] @ se3.exp(np.array([0.1, 0.0, -0.05, 0.0, 0.05, 0.0]))
    made, expected = mapped(wrong, config, true), mapped(true, config)
    assert odds(made) != odds(expected)
    made.world.keyframes.T_world_cam[:] = true
    made.refresh()
    assert odds(made) == odds(expected)
    assert same(made.cloud(), expected.cloud())


def test_small_corrections_change_nothing_and_culled_keyframes_follow_their_parent() -> None:
    true = in_a_box(3)
    made = mapped(true.copy())
    before = odds(made)
    made.world.keyframes.T_world_cam[1, 0, 3] += 0.5 * PLAIN.correction_m
    made.refresh()
    assert odds(made) == before
    made.world.keyframes.T_world_cam[1] = true[1]
    made.world.cull(2)
    shift = pose(0.2, -0.1, 0.0)
    made.world.keyframes.T_world_cam[1] = shift @ true[1]
    made.refresh()
    moved = true.copy()
    moved[1:] = shift @ true[1:]
    # What hangs on a parent is computed otherwise than given: rays may lie on the other side of an edge.
    expected = odds(mapped(moved, PLAIN, true))
    assert len(set(odds(made)) ^ set(expected)) <= 0.001 * len(expected)


def test_a_keyframe_that_comes_again_replaces_itself() -> None:
    true = in_a_box(3)
    made = mapped(true)
    made.integrate(1, view(true[2], 1))
    made.refresh()
    expected = PLAIN.build(parts(CAMERA, PosedKeyframes(true)))
    for k, seen in ((0, view(true[0], 0)), (2, view(true[2], 2)), (1, view(true[2], 1))):
        expected.integrate(k, seen)
    assert odds(made) == odds(expected)


def test_only_the_main_submap_comes_out() -> None:
    world = PosedKeyframes(np.stack([np.eye(4), pose(500.0), pose(500.0, 0.1)]))
    world.n_submaps = 2
    world.keyframes.submap[:3] = 0, 1, 1
    made = PLAIN.build(parts(CAMERA, world))
    for k in range(3):
        made.integrate(k, image(flat(2.02), k))
    cloud = made.cloud()
    assert len(cloud) > 500
    assert cloud.positions_m[:, 0].min() > 400
    assert (cloud.free[:, 0] * 0.05).min() > 400


# What comes out


def test_the_same_images_give_the_same_bytes() -> None:
    assert same(mapped(in_a_box()).cloud(), mapped(in_a_box()).cloud())


def test_a_cloud_has_unit_normals_towards_the_camera_at_edges_too() -> None:
    cloud = mapped(in_a_box()).cloud()
    assert len(cloud) > 3000
    assert np.allclose(np.linalg.norm(cloud.normals, axis=1), 1, atol=1e-4)
    assert np.mean(np.sum(cloud.normals * (0.0 - cloud.positions_m), axis=1) > 0) > 0.99
    walls = np.minimum(np.abs(cloud.positions_m - LOWER), np.abs(cloud.positions_m - UPPER)).min(axis=1)
    assert np.percentile(walls, 99) < 0.005
    assert not occupied(cloud) & set(map(tuple, cloud.free.tolist()))
    assert len(occupied(cloud)) == len(cloud)


def test_octomap_itself_reads_the_same_occupied_and_free_voxels(tmp_path: Path) -> None:
    pyoctomap = pytest.importorskip("pyoctomap", reason="pyoctomap is not installed")
    cloud = mapped(in_a_box()).cloud()
    cloud.write(tmp_path / "dense_cloud.npz")
    read = load_cloud(tmp_path / "dense_cloud.npz")
    assert same(read, cloud)
    assert write_octomap(read, tmp_path / "map.bt") == len(cloud)
    tree = pyoctomap.OcTree(1.0)
    assert tree.readBinary(str(tmp_path / "map.bt"))
    assert tree.getResolution() == 0.05
    found: dict[bool, set] = {True: set(), False: set()}
    for leaf in tree.begin_leafs():
        assert leaf.getSize() == pytest.approx(0.05)
        index = tuple(int(np.floor(value / 0.05)) for value in leaf.getCoordinate())
        found[bool(tree.isNodeOccupied(leaf))].add(index)
    assert found[True] == occupied(cloud)
    assert found[False] == set(map(tuple, cloud.free.tolist()))
    assert len(found[False]) > len(found[True]) > 3000


def test_octomap_inserting_the_same_points_has_the_same_log_odds() -> None:
    """The library's own insertion, of the cloud of each keyframe."""
    pyoctomap = pytest.importorskip("pyoctomap", reason="pyoctomap is not installed")
    poses = in_a_box(6)
    tree = pyoctomap.OcTree(0.05)
    for setting, value in (("ProbHit", 0.7), ("ProbMiss", 0.4), ("ClampingThresMin", 0.12), ("ClampingThresMax", 0.97)):
        getattr(tree, f"set{setting}")(value)
    for k, T in enumerate(poses):
        depth_m = view(T, k).depth_m[::4, ::4]
        z_m = np.floor(depth_m / UNIT_M + 0.5) * UNIT_M
        points_m = (rays(CAMERA)[::4, ::4] * z_m[..., None]).reshape(-1, 3) @ T[:3, :3].T + T[:3, 3]
        tree.insertPointCloud(points_m, T[:3, 3].copy(), max_range=5.0)
    ours, n_alike, n_leaves = odds(mapped(poses)), 0, 0
    for leaf in tree.begin_leafs():
        if leaf.getSize() > 0.051:
            continue  # pruned: eight alike
        index = tuple(int(np.floor(value / 0.05)) for value in leaf.getCoordinate())
        n_leaves += 1
        n_alike += index in ours and abs(ours[index] - tree.search(list(leaf.getCoordinate())).getLogOdds()) < 1e-3
    assert n_leaves > 10000
    assert n_alike > 0.995 * n_leaves


@pytest.mark.parametrize("schedule", ["in-order", "live"])
def test_a_run_makes_one(schedule: str) -> None:
    dataset = open_dataset("synthetic:empty,frames=8")
    config = configure("orb-slam2", overrides=["dense.kind=octomap"])
    with Slam(config, camera=dataset.camera, schedule=schedule) as slam:
        for each in dataset:
            slam.process(each)
    cloud = slam.dense_cloud()
    assert min(len(cloud), len(cloud.free)) > 5000


def test_free_voxels_of_a_damaged_file_are_refused(tmp_path: Path) -> None:
    cloud = before_a_wall(2.02).cloud()
    replace(cloud, free=cloud.free[:, :2].copy()).write(tmp_path / "dense_cloud.npz")
    with pytest.raises(MapError, match="free is int32"):
        load_cloud(tmp_path / "dense_cloud.npz")


@pytest.mark.parametrize(
    ("config", "message"),
    [
        (OctoMapConfig(hit=0.5), "'dense.hit' is 0.5"),
        (OctoMapConfig(occupied=0.98), "'dense.clamp_high' is 0.97; it must be above 'dense.occupied'"),
        (OctoMapConfig(near_m=9.0), "'dense.far_m' is 8.0; it must be above 'dense.near_m'"),
    ],
)
def test_settings_that_no_map_can_be_made_with(config: OctoMapConfig, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        config.build(parts(CAMERA, PosedKeyframes(np.eye(4)[None])))


def test_indices_survive_packing() -> None:
    indices = np.array([[0, 0, 0], [-1, 5, -(2**20)], [2**20 - 1, -3, 7]])
    assert np.array_equal(unpack(pack_all(indices)), indices)
