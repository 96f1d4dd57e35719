"""cloud.ply and cloud.pcd, opened by readers that are not ours."""

from pathlib import Path

import numpy as np
import pytest
from oriented_clouds import random_cloud
from plyfile import PlyData
from pypcd4 import PointCloud

from stillroom.errors import ConfigError, StillroomError

N_POINTS = 3000


def test_plyfile_reads_every_value(tmp_path: Path) -> None:
    cloud = random_cloud(N_POINTS)
    cloud.write(tmp_path / "cloud.ply")
    points = PlyData.read(tmp_path / "cloud.ply")["vertex"]
    assert len(points.data) == N_POINTS
    for names, ours in ((("x", "y", "z"), cloud.positions_m), (("nx", "ny", "nz"), cloud.normals)):
        np.testing.assert_array_equal(np.stack([points[name] for name in names], axis=1), ours)
    np.testing.assert_array_equal(np.stack([points[c] for c in ("red", "green", "blue")], axis=1), cloud.rgb)
    np.testing.assert_array_equal(points["weight"], cloud.weight)


def test_trimesh_reads_places_and_colours(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    cloud = random_cloud(N_POINTS)
    cloud.write(tmp_path / "cloud.ply")
    read = trimesh.load(tmp_path / "cloud.ply")
    np.testing.assert_array_equal(read.vertices, cloud.positions_m)
    np.testing.assert_array_equal(read.colors[:, :3], cloud.rgb)


def test_the_header_says_units_and_frame(tmp_path: Path) -> None:
    random_cloud(2).write(tmp_path / "cloud.ply")
    header = (tmp_path / "cloud.ply").read_bytes().split(b"end_header")[0].decode("ascii")
    assert "metres" in header
    assert "x right, y down, z forward" in header


def test_pypcd_reads_every_value(tmp_path: Path) -> None:
    cloud = random_cloud(N_POINTS)
    cloud.write(tmp_path / "cloud.pcd")
    read = PointCloud.from_path(tmp_path / "cloud.pcd")
    # pcl::PointXYZRGBNormal
    assert read.fields == ("x", "y", "z", "rgb", "normal_x", "normal_y", "normal_z", "curvature")
    np.testing.assert_array_equal(read.numpy(("x", "y", "z")), cloud.positions_m)
    np.testing.assert_array_equal(read.numpy(("normal_x", "normal_y", "normal_z")), cloud.normals)
    np.testing.assert_array_equal(PointCloud.decode_rgb(read.pc_data["rgb"]), cloud.rgb)


def test_the_pcd_header_is_what_the_format_asks_for(tmp_path: Path) -> None:
    random_cloud(7).write(tmp_path / "cloud.pcd")
    header, _, body = (tmp_path / "cloud.pcd").read_bytes().partition(b"DATA binary\n")
    words = {line.split()[0]: line.split()[1:] for line in header.decode("ascii").splitlines() if line[0] != "#"}
    # The order is prescribed: pointclouds.org, The PCD file format.
    order = ["VERSION", "FIELDS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "VIEWPOINT", "POINTS"]
    assert list(words) == order
    assert words["SIZE"] == ["4"] * 8
    assert words["TYPE"] == ["F"] * 8
    assert words["COUNT"] == ["1"] * 8
    assert (words["WIDTH"], words["HEIGHT"], words["POINTS"]) == (["7"], ["1"], ["7"])
    assert len(body) == 7 * 8 * 4


@pytest.mark.parametrize("suffix", ["ply", "pcd", "npz"])
def test_where_nothing_can_be_written_one_line_says_so(suffix: str, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(StillroomError, match=rf"file/cloud\.{suffix}: cannot be written"):
        random_cloud(3).write(tmp_path / "file" / f"cloud.{suffix}")


def test_a_suffix_that_no_point_format_has_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"cloud\.obj: points are written as \.ply, \.pcd or \.npz"):
        random_cloud(3).write(str(tmp_path / "cloud.obj"))
    assert not list(tmp_path.iterdir())
