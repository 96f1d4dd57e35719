"""mesh.ply against surfaces that are known exactly."""

import sys
import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from counted_lines import n_lines
from numpy.typing import NDArray
from oriented_clouds import Surfaces
from plyfile import PlyData
from scipy.spatial import cKDTree

from stillroom.data.dense_cloud import DenseCloud
from stillroom.dense.export.mesh import Mesh, MeshConfig
from stillroom.errors import MapError, MissingExtraError

trimesh = pytest.importorskip("trimesh")

VOXEL_M = 0.02
CENTER_M, RADIUS_M = np.array([0.013, -0.021, 0.017]), 0.6
GREEN, RED = (20, 200, 40), (210, 30, 10)


def made(cloud: DenseCloud, config: MeshConfig | None = None) -> Mesh:
    return (config or MeshConfig()).build()(cloud)


def as_trimesh(mesh: Mesh):
    return trimesh.Trimesh(mesh.positions_m, mesh.triangles, process=False)


def centers_m(mesh: Mesh) -> NDArray[np.float64]:
    return mesh.positions_m.astype(np.float64)[mesh.triangles].mean(axis=1)


def off_box_m(points: NDArray[np.float64], low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance from the surface of an axis-parallel box."""
    beyond = np.abs(points - (low + high) / 2) - (high - low) / 2
    outside = np.linalg.norm(np.maximum(beyond, 0), axis=1)
    return np.abs(outside + np.minimum(beyond.max(axis=1), 0))


def area_in_m2(mesh: Mesh, from_m: float, to_m: float) -> float:
    """Area in the rectangle x from … to, y 0.1 … 0.9, its triangles cut by their centers."""
    x, y, _ = centers_m(mesh).T
    inside = (x > from_m) & (x < to_m) & (y > 0.1) & (y < 0.9)
    return float(as_trimesh(mesh).area_faces[inside].sum())


@pytest.fixture(scope="module")
def sphere_cloud() -> DenseCloud:
    """Around the origin of the grid, so that eight blocks share it."""
    return Surfaces().sphere(tuple(CENTER_M), RADIUS_M, GREEN).cloud(VOXEL_M, noise_m=0.001)


@pytest.fixture(scope="module")
def sphere(sphere_cloud: DenseCloud) -> Mesh:
    return made(sphere_cloud)


def test_it_lies_on_the_true_surface(sphere: Mesh) -> None:
    off_m = np.abs(np.linalg.norm(sphere.positions_m - CENTER_M, axis=1) - RADIUS_M)
    assert np.median(off_m) <= 0.1 * VOXEL_M  # half a voxel is asked for
    assert off_m.max() <= 0.5 * VOXEL_M


def test_a_closed_surface_is_watertight_across_blocks(sphere: Mesh) -> None:
    read = as_trimesh(sphere)
    assert read.is_watertight
    assert read.is_winding_consistent
    assert read.euler_number == 2
    assert read.volume == pytest.approx(4 / 3 * np.pi * RADIUS_M**3, rel=0.01)  # positive: triangles look outwards


def test_vertices_look_the_way_of_the_points_and_have_their_colour(sphere: Mesh) -> None:
    outwards = (sphere.positions_m - CENTER_M) / np.linalg.norm(sphere.positions_m - CENTER_M, axis=1, keepdims=True)
    assert np.einsum("ij,ij->i", outwards, sphere.normals).min() > 0.98
    np.testing.assert_allclose(np.linalg.norm(sphere.normals, axis=1), 1, atol=1e-5)
    assert (sphere.rgb == GREEN).all()


def test_plyfile_and_trimesh_open_it(sphere: Mesh, tmp_path: Path) -> None:
    sphere.write_ply(tmp_path / "mesh.ply")
    ply = PlyData.read(tmp_path / "mesh.ply")
    np.testing.assert_array_equal(np.stack([ply["vertex"][n] for n in ("x", "y", "z")], axis=1), sphere.positions_m)
    np.testing.assert_array_equal(np.stack([ply["vertex"][n] for n in ("nx", "ny", "nz")], axis=1), sphere.normals)
    np.testing.assert_array_equal(np.vstack(ply["face"]["vertex_indices"]), sphere.triangles)
    read = trimesh.load(tmp_path / "mesh.ply", process=False)
    np.testing.assert_array_equal(read.visual.vertex_colors[:, :3], sphere.rgb)
    assert read.is_watertight


def test_edges_and_corners_of_a_box(tmp_path: Path) -> None:
    low, high = np.array([-0.5, -0.31, -0.22]), np.array([0.61, 0.3, 0.4])
    mesh = made(Surfaces(seed=1).box(tuple(low), tuple(high)).cloud(VOXEL_M))
    off_m = off_box_m(mesh.positions_m.astype(np.float64), low, high)
    assert np.median(off_m) <= 0.1 * VOXEL_M
    assert off_m.max() <= 1.0 * VOXEL_M  # corners are rounded
    assert as_trimesh(mesh).is_watertight


def test_colours_meet_where_surfaces_of_two_colours_do() -> None:
    shapes = Surfaces().rectangle((0, 0, 0), (1, 0, 0), (0, 0.5, 0), RED)
    mesh = made(shapes.rectangle((0, 0.5, 0), (1, 0, 0), (0, 0.5, 0), GREEN).cloud(VOXEL_M))
    y = mesh.positions_m[:, 1]
    assert (mesh.rgb[y < 0.5 - 3 * VOXEL_M] == RED).all()
    assert (mesh.rgb[y > 0.5 + 3 * VOXEL_M] == GREEN).all()


def test_no_surface_far_from_points_and_holes_stay_open() -> None:
    """A wall with a window, its sides open."""
    shapes = Surfaces().rectangle((0, 0, 0), (1, 0, 0), (0, 1, 0))
    whole = shapes.cloud(VOXEL_M)
    in_window = (np.abs(whole.positions_m[:, :2] - 0.5) < 0.2).all(axis=1)
    mesh = made(_part(whole, ~in_window))
    distance_m, _ = cKDTree(whole.positions_m[~in_window]).query(mesh.positions_m, p=np.inf)
    assert distance_m.max() < 2 * VOXEL_M  # along every axis
    in_middle = (np.abs(centers_m(mesh)[:, :2] - 0.5) < 0.2 - 2 * VOXEL_M).all(axis=1)
    assert not in_middle.any()
    assert area_in_m2(mesh, 0.1, 0.3) == pytest.approx(0.8 * 0.2, rel=0.01)  # a strip beside the window
    assert np.abs(mesh.positions_m[:, 2]).max() < 0.1 * VOXEL_M


def test_a_small_gap_between_points_is_closed() -> None:
    whole = Surfaces().rectangle((0, 0, 0), (1, 0, 0), (0, 1, 0)).cloud(VOXEL_M)
    random = np.random.default_rng(0)
    thinned = _part(whole, random.uniform(size=len(whole)) < 0.75)
    mesh = made(thinned)
    assert area_in_m2(mesh, 0.1, 0.9) == pytest.approx(0.64, rel=0.01)


def test_lone_points_make_no_surface() -> None:
    wall = Surfaces().rectangle((0, 0, 0), (1, 0, 0), (0, 1, 0)).cloud(VOXEL_M)
    specks_m = np.random.default_rng(0).uniform([-1, -1, 0.5], [2, 2, 2], (200, 3))
    specks = Surfaces().add(specks_m, np.tile([0.0, 0.0, 1.0], (200, 1))).cloud(VOXEL_M)
    both = DenseCloud(
        *(np.concatenate((getattr(wall, n), getattr(specks, n))) for n in ("positions_m", "normals", "rgb", "weight")),
        VOXEL_M,
    )
    mesh = made(both)
    np.testing.assert_array_equal(mesh.positions_m, made(wall).positions_m)


@pytest.mark.parametrize("gap_voxels", [3.0, 4.0, 5.0])
def test_between_two_surfaces_behind_each_other_there_is_none(gap_voxels: float) -> None:
    """The distance to the one ends below zero and that to the other begins above, without a surface there."""
    gap_m = gap_voxels * VOXEL_M
    shapes = Surfaces().rectangle((0, 0, 0), (1, 0, 0), (0, 1, 0)).rectangle((0, 0, gap_m), (1, 0, 0), (0, 1, 0))
    mesh = made(shapes.cloud(VOXEL_M))
    height_m = centers_m(mesh)[:, 2]
    assert np.minimum(np.abs(height_m), np.abs(height_m - gap_m)).max() < 0.6 * VOXEL_M
    a, b, c = (mesh.positions_m[mesh.triangles[:, k]] for k in range(3))
    assert np.cross(b - a, c - a)[:, 2].min() > -1e-3 * VOXEL_M**2


def test_the_two_sides_of_a_board() -> None:
    board = Surfaces().box((0, 0, 0), (1, 1, 0.06))
    read = as_trimesh(made(board.cloud(VOXEL_M)))
    assert read.is_watertight
    assert read.volume == pytest.approx(0.06, rel=0.1)


def test_where_it_lies_does_not_matter(sphere_cloud: DenseCloud, sphere: Mesh) -> None:
    shift_m = np.array([97, -211, 16]) * VOXEL_M  # no multiple of a block
    there = made(replace(sphere_cloud, positions_m=(sphere_cloud.positions_m + shift_m).astype(np.float32)))
    assert as_trimesh(there).is_watertight
    distance_m, _ = cKDTree(there.positions_m - shift_m).query(sphere.positions_m)
    assert distance_m.max() < 0.05 * VOXEL_M


def test_islands_far_apart_cost_no_more_than_near_ones() -> None:
    shapes = Surfaces().sphere((0, 0, 0), 0.2).sphere((900.0, -700.0, 500.0), 0.2)
    assert as_trimesh(made(shapes.cloud(VOXEL_M))).body_count == 2


def test_the_same_cloud_gives_the_same_mesh(sphere_cloud: DenseCloud, sphere: Mesh) -> None:
    again = made(sphere_cloud)
    np.testing.assert_array_equal(again.positions_m, sphere.positions_m)
    np.testing.assert_array_equal(again.triangles, sphere.triangles)


def test_coarser_cells_make_fewer_triangles(sphere_cloud: DenseCloud, sphere: Mesh) -> None:
    coarse = made(sphere_cloud, MeshConfig(cell_voxels=2.0))
    assert as_trimesh(coarse).is_watertight
    assert len(coarse.triangles) < 0.3 * len(sphere.triangles)


def test_points_too_sparse_for_a_mesh_are_told() -> None:
    points_m = np.arange(30.0).reshape(10, 3)
    sparse = Surfaces().add(points_m, np.tile([0.0, 0.0, 1.0], (10, 1))).cloud(VOXEL_M)
    with pytest.raises(MapError, match=r"10 points are too sparse for a mesh of 0\.02 m cells"):
        made(sparse)


def test_without_the_library_the_line_says_what_to_install(
    sphere_cloud: DenseCloud, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "skimage.measure", None)
    with pytest.raises(MissingExtraError, match=r"scikit-image is not installed: pip install 'stillroom\[mesh\]'"):
        made(sphere_cloud)


def _part(cloud: DenseCloud, kept: NDArray[np.bool_]) -> DenseCloud:
    return DenseCloud(cloud.positions_m[kept], cloud.normals[kept], cloud.rgb[kept], cloud.weight[kept], cloud.voxel_m)


@pytest.mark.slow
def test_a_million_points_take_few_lines_and_little_more_memory_than_the_mesh(tmp_path: Path) -> None:
    """A hall of 18 m by 18 m by 4 m."""
    hall = Surfaces(density_per_m2=8000.0)
    hall.rectangle((0, 0, 0), (18, 0, 0), (0, 18, 0)).rectangle((0, 0, 4), (0, 18, 0), (18, 0, 0))
    hall.rectangle((0, 0, 0), (0, 0, 4), (18, 0, 0)).rectangle((0, 0, 0), (0, 18, 0), (0, 0, 4))
    cloud = hall.cloud(VOXEL_M)
    cloud = DenseCloud(*(np.concatenate((v, v)) for v in _arrays(cloud)), VOXEL_M)  # 2 floors of the same house
    cloud.positions_m[len(cloud) // 2 :, 2] += 4.5
    made(_part(cloud, np.arange(len(cloud)) < 1000))  # compiles
    assert len(cloud) > 1_000_000
    meshes: list[Mesh] = []
    tracemalloc.start()
    lines = n_lines(lambda: meshes.append(made(cloud)))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    (mesh,) = meshes
    mesh.write_ply(tmp_path / "mesh.ply")
    assert lines < 0.2 * len(cloud)
    assert peak < 600 * len(cloud)
    assert area_in_m2(mesh, 0.1, 0.9) > 0


def _arrays(cloud: DenseCloud) -> tuple[NDArray[Any], ...]:
    return cloud.positions_m, cloud.normals, cloud.rgb, cloud.weight
