"""Archives read as they are: unpacked once, safely, or refused in one line."""

import io
import tarfile
import zipfile
from pathlib import Path

import numpy as np
import pytest

from stillroom.data.locations import cache_folder
from stillroom.datasets import archive
from stillroom.datasets.open import open_dataset
from stillroom.errors import DatasetError


def tgz_of(folder: Path, path: Path, top: str = "tiny") -> Path:
    with tarfile.open(path, "w:gz") as tar:
        tar.add(folder, arcname=top)
    return path


def zip_of(folder: Path, path: Path, top: str = "tiny") -> Path:
    with zipfile.ZipFile(path, "w") as zipped:
        for file in sorted(folder.rglob("*")):
            zipped.write(file, Path(top) / file.relative_to(folder))
    return path


def add_file(tar: tarfile.TarFile, name: str, content: bytes = b"x") -> None:
    info = tarfile.TarInfo(name)
    info.size = len(content)
    tar.addfile(info, io.BytesIO(content))


@pytest.mark.parametrize("pack", [tgz_of, zip_of])
def test_an_archive_opens_like_its_folder(pack, tiny: Path, tmp_path: Path) -> None:
    suffix = ".tgz" if pack is tgz_of else ".zip"
    sequence = open_dataset(str(pack(tiny, tmp_path / f"other{suffix}")))
    folder = open_dataset(str(tiny))
    assert sequence.name == folder.name == "tiny"
    assert sequence.camera == folder.camera
    assert np.array_equal(sequence.timestamps_s, folder.timestamps_s)
    assert all(np.array_equal(sequence.load(i).rgb, folder.load(i).rgb) for i in range(6))


def test_an_archive_without_a_top_folder_is_called_by_its_file(tiny: Path, tmp_path: Path) -> None:
    assert open_dataset(str(tgz_of(tiny, tmp_path / "my.kitchen.tar.gz", top="."))).name == "my.kitchen"


def test_a_known_name_in_the_archive_brings_its_calibration(tiny: Path, tmp_path: Path) -> None:
    (tiny / "camera.toml").unlink()
    path = tgz_of(tiny, tmp_path / "renamed.tgz", top="rgbd_dataset_freiburg1_tiny")
    # Its images are 64×48: what is asserted is that the name was recognised.
    with pytest.raises(Exception, match=r"tum-freiburg1.*has 640×480"):
        open_dataset(str(path))


def test_is_unpacked_once_and_anew_when_it_changes(tiny: Path, tmp_path: Path) -> None:
    path = tgz_of(tiny, tmp_path / "a.tgz")
    first = archive.unpacked(path)
    assert cache_folder() in first.parents
    (first / "proof").touch()
    assert (archive.unpacked(path) / "proof").exists()
    (tiny / "more.txt").write_text("more")
    tgz_of(tiny, path)
    second = archive.unpacked(path)
    assert second != first
    assert (second / "tiny" / "more.txt").exists()


@pytest.mark.parametrize("name", ["../outside", "/tmp/stillroom-outside", "a/../../outside"])
@pytest.mark.parametrize("kind", ["tgz", "zip"])
def test_a_path_that_leads_out_is_refused(kind: str, name: str, tmp_path: Path) -> None:
    path = tmp_path / f"bad.{kind}"
    if kind == "tgz":
        with tarfile.open(path, "w:gz") as tar:
            add_file(tar, "fine")
            add_file(tar, name)
    else:
        with zipfile.ZipFile(path, "w") as zipped:
            zipped.writestr("fine", "x")
            zipped.writestr(name, "x")
    with pytest.raises(DatasetError, match="leads out of it"):
        archive.unpack(path, tmp_path / "into" / "folder")
    assert list((tmp_path / "into").iterdir()) == []
    assert not (tmp_path / "into" / "outside").exists()
    assert not Path("/tmp/stillroom-outside").exists()


def test_links_are_not_made(tmp_path: Path) -> None:
    (tmp_path / "secret").write_text("secret")
    with tarfile.open(tmp_path / "a.tgz", "w:gz") as tar:
        link = tarfile.TarInfo("rgb.txt")
        link.type, link.linkname = tarfile.SYMTYPE, str(tmp_path / "secret")
        tar.addfile(link)
        add_file(tar, "fine")
    archive.unpack(tmp_path / "a.tgz", tmp_path / "folder")
    assert [path.name for path in (tmp_path / "folder").iterdir()] == ["fine"]


@pytest.mark.parametrize("kind", ["tgz", "zip"])
def test_a_cut_off_archive_is_refused_and_leaves_nothing(kind: str, tiny: Path, tmp_path: Path) -> None:
    path = (tgz_of if kind == "tgz" else zip_of)(tiny, tmp_path / f"a.{kind}")
    path.write_bytes(path.read_bytes()[:-2000])
    with pytest.raises(DatasetError, match=r"not a whole archive .*fetch it again") as caught:
        open_dataset(str(path))
    assert "\n" not in str(caught.value)
    assert list((cache_folder() / "unpacked").iterdir()) == []


def test_a_damaged_archive_is_refused(tiny: Path, tmp_path: Path) -> None:
    path = tgz_of(tiny, tmp_path / "a.tgz")
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 255
    path.write_bytes(content)
    with pytest.raises(DatasetError, match="not a whole archive"):
        archive.unpacked(path)


def test_what_is_called_an_archive_and_is_none_is_said_shortly(tmp_path: Path) -> None:
    """tarfile has a word on each kind of compression."""
    (tmp_path / "a.tgz").write_text("<html>404</html>")
    with pytest.raises(DatasetError, match=r"a\.tgz: not a whole archive \([^:]{5,60}\); delete it and fetch it again"):
        open_dataset(str(tmp_path / "a.tgz"))


def test_an_archive_of_something_else_is_said(tmp_path: Path) -> None:
    with tarfile.open(tmp_path / "a.tgz", "w:gz") as tar:
        add_file(tar, "docs/readme.md")
    with pytest.raises(DatasetError, match=r"a\.tgz: no rgb\.txt in it"):
        open_dataset(str(tmp_path / "a.tgz"))


def test_a_file_that_is_no_archive_is_said(tmp_path: Path) -> None:
    (tmp_path / "film.mp4").write_bytes(b"x")
    with pytest.raises(DatasetError, match="neither a folder nor an archive"):
        open_dataset(str(tmp_path / "film.mp4"))
