"""map.bt, read by OctoMap itself and by a plain reader that follows the paper."""

from pathlib import Path

import numpy as np
import pytest
from oriented_clouds import Surfaces, random_cloud

from stillroom.data.dense_cloud import DenseCloud
from stillroom.dense.export.octomap import write_octomap
from stillroom.errors import MapError

VOXEL_M = 0.05


def voxels_of(cloud: DenseCloud) -> set[tuple[int, ...]]:
    keys = np.floor(cloud.positions_m.astype(np.float64) / cloud.voxel_m).astype(int)
    return set(map(tuple, keys.tolist()))


def plain_reader(path: Path) -> tuple[dict[str, str], set[tuple[int, ...]]]:
    """Header and occupied leaves, child by child."""
    head, _, body = path.read_bytes().partition(b"\ndata\n")
    lines = head.decode("ascii").splitlines()
    assert lines[0] == "# Octomap OcTree binary file"
    header = dict(line.split(maxsplit=1) for line in lines if not line.startswith("#"))
    occupied = set()
    place = nodes = 0

    def read(corner: tuple[int, ...], edge: int) -> None:
        nonlocal place, nodes
        nodes += 1
        bits = int.from_bytes(body[place : place + 2], "little")
        place += 2
        inner = []
        for child in range(8):
            half = edge // 2
            low = tuple(corner[axis] + half * (child >> axis & 1) for axis in range(3))
            match bits >> 2 * child & 3:
                case 2:
                    assert half == 1
                    nodes += 1
                    occupied.add(low)
                case 3:
                    inner.append(low)
                case 1:
                    raise AssertionError("a free leaf")
        for low in inner:
            read(low, edge // 2)

    read((-(2**15),) * 3, 2**16)
    assert place == len(body)
    assert int(header["size"]) == nodes
    return header, occupied


@pytest.fixture(scope="module")
def cloud() -> DenseCloud:
    shapes = Surfaces().sphere((0.3, -0.2, 1.1), 0.6).rectangle((-2.0, 0.7, -1.0), (3.0, 0, 0), (0, 0, 2.0))
    return shapes.cloud(VOXEL_M)


def test_a_plain_reader_finds_the_same_voxels(cloud: DenseCloud, tmp_path: Path) -> None:
    n_voxels = write_octomap(cloud, tmp_path / "map.bt")
    header, occupied = plain_reader(tmp_path / "map.bt")
    assert occupied == voxels_of(cloud)
    assert n_voxels == len(occupied) > 1000
    assert header["id"] == "OcTree"
    assert float(header["res"]) == VOXEL_M


def test_octomap_itself_finds_the_same_voxels(cloud: DenseCloud, tmp_path: Path) -> None:
    pyoctomap = pytest.importorskip("pyoctomap", reason="pyoctomap is not installed")
    write_octomap(cloud, tmp_path / "map.bt")
    tree = pyoctomap.OcTree(1.0)
    assert tree.readBinary(str(tmp_path / "map.bt"))
    assert tree.getResolution() == VOXEL_M
    found = set()
    for leaf in tree.begin_leafs():
        assert tree.isNodeOccupied(leaf)
        assert leaf.getSize() == pytest.approx(VOXEL_M)
        found.add(tuple(int(np.floor(value / VOXEL_M)) for value in leaf.getCoordinate()))
    assert found == voxels_of(cloud)


def test_a_single_point_and_both_ends_of_the_space(tmp_path: Path) -> None:
    ends_m = np.array([[-(2**15), 0, 5], [2**15 - 1, -1, -6]], dtype=np.float32) + 0.5
    cloud = DenseCloud(ends_m, np.zeros((2, 3), np.float32), np.zeros((2, 3), np.uint8), np.ones(2, np.float32), 1.0)
    assert write_octomap(cloud, tmp_path / "map.bt") == 2
    assert plain_reader(tmp_path / "map.bt")[1] == voxels_of(cloud)


def test_a_map_that_is_too_large_and_one_without_points(tmp_path: Path) -> None:
    with pytest.raises(MapError, match="65536 voxels along an axis"):
        write_octomap(random_cloud(10, voxel_m=0.00005), tmp_path / "map.bt")
    with pytest.raises(MapError, match="no points"):
        write_octomap(random_cloud(0), tmp_path / "map.bt")
    assert not list(tmp_path.iterdir())
