"""`dense_cloud.npz`: what is read is what was written, and nothing else is taken for one."""

from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from oriented_clouds import random_cloud

from stillroom.data.dense_cloud import DenseCloud, load_cloud
from stillroom.errors import MapError, StillroomError


def rewritten(path: Path, **changes: object) -> None:
    with np.load(path) as entries:
        kept = dict(entries) | changes
    np.savez(path, **{name: value for name, value in kept.items() if value is not None})


@pytest.fixture
def file(tmp_path: Path) -> Path:
    random_cloud(500).write(tmp_path / "dense_cloud.npz")
    return tmp_path / "dense_cloud.npz"


def test_what_is_read_is_what_was_written(file: Path) -> None:
    cloud, again = random_cloud(500), load_cloud(file)
    for field in fields(DenseCloud):
        ours, read = getattr(cloud, field.name), getattr(again, field.name)
        np.testing.assert_array_equal(read, ours)
        assert np.asarray(read).dtype == np.asarray(ours).dtype


def test_numpy_alone_reads_it(file: Path) -> None:
    with np.load(file) as entries:
        np.testing.assert_array_equal(entries["positions_m"], random_cloud(500).positions_m)


def test_the_same_cloud_gives_the_same_bytes(file: Path, tmp_path: Path) -> None:
    random_cloud(500).write(tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == file.read_bytes()


def test_an_empty_cloud_is_a_cloud(tmp_path: Path) -> None:
    random_cloud(0).write(tmp_path / "empty.npz")
    assert len(load_cloud(tmp_path / "empty.npz")) == 0


DAMAGE: dict[str, tuple[Callable[[Path], object], str]] = {
    "missing": (lambda path: path.unlink(), "no such file"),
    "cut off": (lambda path: path.write_bytes(path.read_bytes()[:-200]), "damaged"),
    "cut off early": (lambda path: path.write_bytes(path.read_bytes()[:50]), "damaged"),
    "empty": (lambda path: path.write_bytes(b""), "damaged"),
    "a byte changed": (
        lambda path: path.write_bytes(path.read_bytes()[:3000] + b"\xff\x00\xff" + path.read_bytes()[3003:]),
        "damaged",
    ),
    "text": (lambda path: path.write_text("ply\nformat ascii 1.0\n"), "damaged"),
    "a single array": (lambda path: np.save(path.open("wb"), np.zeros(3)), "damaged"),
    "someone else's": (lambda path: np.savez(path, positions_m=np.zeros((3, 3))), "not a dense cloud of Stillroom"),
    "of a later version": (lambda path: rewritten(path, version=np.array(2)), "later Stillroom"),
    "without colours": (lambda path: rewritten(path, rgb=None), "damaged"),
    "too few colours": (lambda path: rewritten(path, rgb=np.zeros((4, 3), np.uint8)), "rgb is uint8 (4, 3)"),
    "of another type": (lambda path: rewritten(path, weight=np.zeros(500)), "weight is float64 (500,)"),
    "no array": (lambda path: rewritten(path, positions_m=np.float32(1)), "positions_m is float32 ()"),
    "not finite": (
        lambda path: rewritten(path, normals=np.full((500, 3), np.nan, np.float32)),
        "normals holds numbers that are not finite",
    ),
    "no voxel": (lambda path: rewritten(path, voxel_m=np.array(0.0)), "voxels of 0.0 m"),
    "objects": (lambda path: rewritten(path, weight=np.array([{}] * 500, dtype=object)), "damaged"),
}


@pytest.mark.parametrize("case", list(DAMAGE))
def test_what_is_none_is_one_line_that_names_the_file(case: str, file: Path) -> None:
    damage, words = DAMAGE[case]
    damage(file)
    with pytest.raises(MapError) as raised:
        load_cloud(file)
    assert str(raised.value).startswith(f"{file}: ")
    assert words in str(raised.value)
    assert "\n" not in str(raised.value)


def test_a_failed_write_leaves_what_was_there(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = file.read_bytes()

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("numpy.lib.format.write_array", full)
    with pytest.raises(StillroomError, match=r"dense_cloud.npz: cannot be written \(No space left on device\)"):
        replace(random_cloud(500), voxel_m=0.5).write(file)
    assert file.read_bytes() == before
    assert list(file.parent.iterdir()) == [file]
