"""`stillroom export`: what it writes and names, and what it says where it cannot."""

import json
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from oriented_clouds import Surfaces, random_cloud

from stillroom.data.dense_cloud import NAME, DenseCloud

FILES = ["cloud.ply", "cloud.pcd", "mesh.ply", "map.pgm", "map.yaml", "map_frame.json", "map.bt"]
VOXEL_M = 0.04


@pytest.fixture(scope="session")
def corner_cloud() -> DenseCloud:
    """Floor and a wall, seen by a level camera a metre above the floor."""
    corner = Surfaces(density_per_m2=6000.0).rectangle((-1, 1, 0), (2, 0, 0), (0, 0, 3))
    return corner.rectangle((-1, 1, 3), (2, 0, 0), (0, -2, 0)).cloud(VOXEL_M)


@pytest.fixture
def run(corner_cloud: DenseCloud, stillroom: Callable) -> Path:
    """The folder of a run, in results/, with a link to it."""
    folder = Path("results/2026-01-31_12-00_oc-slam_room")
    folder.mkdir(parents=True)
    (folder.parent / "latest").symlink_to(folder.name)
    corner_cloud.write(folder / NAME)
    return folder


def written(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir() if path.name != NAME)


def test_all_of_the_latest_run_without_a_word(run: Path, corner_cloud: DenseCloud, stillroom: Callable) -> None:
    pytest.importorskip("skimage")
    said = stillroom("export")
    assert (said.code, said.err) == (0, "")
    assert written(run) == sorted(FILES)
    lines = said.out.splitlines()
    assert [line.partition(":")[0] for line in lines] == [f"{run}/{name}" for name in FILES]
    assert (
        lines[0] == f"{run}/cloud.ply: {len(corner_cloud)} points, {(run / 'cloud.ply').stat().st_size / 1000:.1f} KB"
    )
    assert "triangles" in lines[2]
    assert f"cells of {1.5 * VOXEL_M:g} m" in lines[3]
    assert "m² of floor, 0° off the first camera" in lines[4]
    assert "voxels of 0.04 m" in lines[6]


def test_some_formats_into_another_folder(run: Path, stillroom: Callable) -> None:
    said = stillroom("export", run, "--format", "PCD, octomap", "-f", "ply", "--out", "elsewhere/deep")
    assert said.code == 0
    assert written(Path("elsewhere/deep")) == ["cloud.pcd", "cloud.ply", "map.bt"]
    assert written(run) == []
    assert len(said.out.splitlines()) == 3


def test_free_voxels_of_an_occupancy_map_are_told(run: Path, corner_cloud: DenseCloud, stillroom: Callable) -> None:
    free = np.array([[0, 0, 10], [0, 0, 11], [-1, 2, 12]], dtype=np.int32)
    replace(corner_cloud, free=free).write(run / NAME)
    said = stillroom("export", run, "--format", "octomap")
    assert "voxels of 0.04 m, 3 free ones, " in said.out


def test_settings_reach_the_formats(run: Path, stillroom: Callable) -> None:
    settings = ["--set", "occupancy.resolution_m=0.2", "--set", "occupancy.floor.min_area_m2=1"]
    said = stillroom("export", run, "--format", "occupancy", *settings)
    assert said.code == 0
    assert "resolution: 0.200000" in (run / "map.yaml").read_text()
    assert np.array(json.loads((run / "map_frame.json").read_text())["T_map_world"]).shape == (4, 4)


def test_written_again_they_are_the_same_bytes(run: Path, stillroom: Callable) -> None:
    pytest.importorskip("skimage")
    stillroom("export")
    before = {name: (run / name).read_bytes() for name in FILES}
    assert stillroom("export").code == 0
    assert {name: (run / name).read_bytes() for name in FILES} == before
    assert written(run) == sorted(FILES)


REQUESTS: dict[str, tuple[list[str], list[str]]] = {
    "an unknown format": (["--format", "octmap"], ["unknown format 'octmap'; did you mean 'octomap'"]),
    "one of several is unknown": (["--format", "ply,mesch"], ["'mesch'", "'mesh'"]),
    "no format": (["--format", ""], ["unknown format ''"]),
    "an unknown key": (["--set", "occupancy.resolution=1"], ["'occupancy.resolution'", "'occupancy.resolution_m'"]),
    "values that contradict": (["--set", "occupancy.obstacle_from_m=3"], ["'occupancy.obstacle_from_m'"]),
    "a file where the folder should be": (["--out", "in_the_way"], ["in_the_way: cannot be made"]),
    "a folder below a file": (["--out", "in_the_way/deep"], ["in_the_way/deep: cannot be made"]),
}


@pytest.mark.parametrize("case", list(REQUESTS))
def test_a_request_that_cannot_be_met_is_one_line(case: str, run: Path, stillroom: Callable) -> None:
    Path("in_the_way").write_text("")
    arguments, words = REQUESTS[case]
    said = stillroom("export", *arguments)
    assert (said.code, said.out, said.err.count("\n")) == (1, "", 1)
    for word in words:
        assert word in said.errors[0]
    assert written(run) == []


DAMAGE: dict[str, tuple[Callable[[Path], object], list[str]]] = {
    "no dense map": (lambda run: (run / NAME).unlink(), ["results/latest: this run has no dense map; run with"]),
    "a damaged map": (lambda run: (run / NAME).write_bytes(b"PK"), [f"{NAME}: damaged"]),
    "an empty map": (lambda run: random_cloud(0).write(run / NAME), [f"{NAME}: the dense map is empty"]),
    "no such run": (lambda run: (run.parent / "latest").unlink(), ["results/latest: no such results folder"]),
}


@pytest.mark.parametrize("case", list(DAMAGE))
def test_a_run_that_cannot_be_exported_is_one_line(case: str, run: Path, stillroom: Callable) -> None:
    damage, words = DAMAGE[case]
    damage(run)
    said = stillroom("export")
    assert (said.code, said.out, said.err.count("\n")) == (1, "", 1)
    for word in words:
        assert word in said.errors[0]
    assert written(run) == []


def test_without_the_mesh_library_the_others_are_written_and_the_line_says_what_to_install(
    run: Path, stillroom: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "skimage.measure", None)
    said = stillroom("export")
    assert said.code == 1
    assert said.errors == ["error: mesh: scikit-image is not installed: pip install 'stillroom[mesh]'"]
    assert written(run) == sorted(set(FILES) - {"mesh.ply"})
    assert len(said.out.splitlines()) == len(FILES) - 1


def test_without_a_floor_the_others_are_written(run: Path, corner_cloud: DenseCloud, stillroom: Callable) -> None:
    upside_down = replace(corner_cloud, positions_m=-corner_cloud.positions_m, normals=-corner_cloud.normals)
    upside_down.write(run / NAME)
    said = stillroom("export", "--format", "ply,occupancy,octomap")
    assert said.code == 1
    assert len(said.errors) == 1
    assert said.errors[0].startswith("error: occupancy: no floor found")
    assert written(run) == ["cloud.ply", "map.bt"]


def test_a_file_that_cannot_be_replaced_is_named_and_nothing_half_written_stays(run: Path, stillroom: Callable) -> None:
    (run / "cloud.ply").mkdir()
    said = stillroom("export", "--format", "ply,pcd")
    assert said.code == 1
    assert "cloud.ply: cannot be written" in said.errors[0]
    assert written(run) == ["cloud.pcd", "cloud.ply"]
