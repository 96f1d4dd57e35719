"""Whatever an archive, a server, a file or a data set calls a thing: nothing is written outside the folder meant."""

import io
import sqlite3
import tarfile
import zipfile
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from random_map import EventfulLife, session
from rgbd_folder import write_rgbd_folder
from small_world import CAMERA

from stillroom.config import SlamConfig
from stillroom.datasets import archive
from stillroom.datasets.archive import BrokenArchiveError, unpack
from stillroom.datasets.open import open_dataset
from stillroom.dense.no_dense_map import NoDenseMapConfig
from stillroom.download import download
from stillroom.errors import DownloadError, MapError, StillroomError
from stillroom.pipeline import RunOptions, evaluate_folder, run
from stillroom.pipeline.results import new_folder
from stillroom.storage import StoredMap, load_map, save_map
from stillroom.viz.masks import MaskWriter

LEADING_OUT = (
    "../outside", "a/../../outside", "./.././outside", "/outside", "//outside", "..\\outside", "a\\..\\..\\outside",
    "\\outside", "C:\\outside", "C:outside", "c:/outside", "\\\\server\\share\\outside",
)  # fmt: skip
DEVICES = ("NUL", "con.txt", "room/AUX", "rgb/com1.png", "lpt9 .txt", "rgb.txt:hidden")
KINDS = ("tar", "zip")


@pytest.fixture
def inside(tmp_path: Path) -> Iterator[Path]:
    """A folder that things are written into; in the end there must be nothing new beside it."""
    folder = tmp_path / "fence" / "inside"
    folder.mkdir(parents=True)
    (tmp_path / "outside").mkdir()
    (tmp_path / "outside" / "kept").write_text("as it was")
    yield folder
    found = {path.relative_to(tmp_path) for path in tmp_path.rglob("*") if folder not in (path, *path.parents)}
    assert found == {Path(each) for each in ("fence", "outside", "outside/kept")}
    assert (tmp_path / "outside" / "kept").read_text() == "as it was"


def packed(folder: Path, kind: str, *members: tarfile.TarInfo) -> Path:
    """Return an archive; of a zip's members, a link is one as Info-ZIP stores it."""
    path = folder / f"a.{kind}"
    if kind == "tar":
        with tarfile.open(path, "w") as tar:
            for member in members:
                member.size = 1 if member.isreg() else 0
                tar.addfile(member, io.BytesIO(b"x"))
        return path
    with zipfile.ZipFile(path, "w") as zipped:
        for member in members:
            info = zipfile.ZipInfo("x")
            info.filename = member.name  # as it is: the constructor would mend it
            info.external_attr = (0o120777 if member.issym() else 0o100644) << 16
            zipped.writestr(info, member.linkname or "x")
    return path


def link(name: str, to: str, kind: bytes = tarfile.SYMTYPE) -> tarfile.TarInfo:
    member = tarfile.TarInfo(name)
    member.type, member.linkname = kind, to
    return member


@pytest.mark.parametrize("name", LEADING_OUT)
@pytest.mark.parametrize("kind", KINDS)
def test_an_archive_whose_paths_lead_out_is_refused(kind: str, name: str, inside: Path) -> None:
    path = packed(inside, kind, tarfile.TarInfo("fine"), tarfile.TarInfo(name))
    with pytest.raises(BrokenArchiveError, match="leads out of it"):
        unpack(path, inside / "into" / "folder")
    assert list((inside / "into").iterdir()) == []


@pytest.mark.parametrize("name", DEVICES)
@pytest.mark.parametrize("kind", KINDS)
def test_devices_of_windows_are_refused_there(
    kind: str, name: str, inside: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = packed(inside, kind, tarfile.TarInfo(name))
    monkeypatch.setattr(archive, "ON_WINDOWS", True)
    with pytest.raises(BrokenArchiveError, match="takes for a device"):
        unpack(path, inside / "into" / "folder")
    assert list((inside / "into").iterdir()) == []
    assert not any(archive._is_device(name) for name in ("console.png", "com10", "auxiliary", "null.txt", "rgb"))


@pytest.mark.parametrize("to", ["../../outside", "/", "fine"])
@pytest.mark.parametrize("type_", [tarfile.SYMTYPE, tarfile.LNKTYPE], ids=["symbolic", "hard"])
def test_no_link_is_made_and_nothing_goes_through_one(type_: bytes, to: str, inside: Path) -> None:
    through = tarfile.TarInfo("link/kept")
    unpack(packed(inside, "tar", link("link", to, type_), through), inside / "into" / "folder")
    assert not any(path.is_symlink() for path in inside.rglob("*"))
    assert (inside / "into" / "folder" / "link" / "kept").read_text() == "x"


def test_a_link_in_a_zip_is_a_file_that_says_where_it_led(inside: Path) -> None:
    unpack(packed(inside, "zip", link("link", "../../outside/kept")), inside / "into" / "folder")
    assert not (inside / "into" / "folder" / "link").is_symlink()
    assert (inside / "into" / "folder" / "link").read_text() == "../../outside/kept"


@pytest.mark.parametrize("type_", [tarfile.CHRTYPE, tarfile.BLKTYPE, tarfile.FIFOTYPE])
def test_no_device_is_made(type_: bytes, inside: Path) -> None:
    unpack(packed(inside, "tar", link("device", "", type_), tarfile.TarInfo("fine")), inside / "into" / "folder")
    assert [path.name for path in (inside / "into" / "folder").iterdir()] == ["fine"]


@pytest.mark.parametrize(
    ("key", "value"), [("path", "a\0b"), ("GNU.sparse.map", "0,1,a"), ("GNU.sparse.name", "../../outside")]
)
def test_what_extended_headers_say_is_no_way_out(key: str, value: str, inside: Path) -> None:
    member = tarfile.TarInfo("fine")
    member.pax_headers = {key: value}
    with pytest.raises(BrokenArchiveError) as caught:
        unpack(packed(inside, "tar", member), inside / "into" / "folder")
    assert "\n" not in str(caught.value)
    assert list((inside / "into").iterdir()) == []


@pytest.mark.parametrize("name", [name for name in LEADING_OUT if name != "//outside"])
@pytest.mark.parametrize("data_set", ["tum/freiburg1_", "tum/", "bonn/", ""])
def test_a_download_is_called_by_no_path(data_set: str, name: str, inside: Path) -> None:
    with pytest.raises(DownloadError, match="nothing of this name"):
        download(f"{data_set}{name}", inside)


@pytest.mark.parametrize("name", [*LEADING_OUT, "..", ".", ""])
def test_a_results_folder_lies_in_its_root(name: str, inside: Path) -> None:
    assert new_folder(inside / "results", name, name).parent == inside / "results"
    assert (inside / "results" / "latest").resolve().parent == inside / "results"


@pytest.mark.parametrize("said", ["../../outside", "/outside", "..", "a/b", "\0", "\udcff"])
def test_latest_is_beside_its_note(said: str, inside: Path) -> None:
    (inside / "latest.txt").write_bytes(said.encode("utf-8", "surrogateescape"))
    with pytest.raises(StillroomError, match=r"no folder beside it|no such results folder"):
        evaluate_folder(inside / "latest")


@pytest.mark.parametrize("name", ["../../outside", "/outside", "a/b", "../mask"])
def test_a_mask_is_called_by_no_path(name: str, inside: Path) -> None:
    """A data set of another package may call its images anything."""
    image, motion = SimpleNamespace(name=name), SimpleNamespace(moving=np.zeros((4, 4), np.bool_))
    tracked, result = SimpleNamespace(frame=SimpleNamespace(image=image)), SimpleNamespace(index=0, motion=motion)
    with pytest.raises(StillroomError, match="no name of a file in it"):
        MaskWriter(inside / "masks").on_frame(tracked, None, result)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["../../outside", "/outside", "\\outside"])
def test_a_map_calls_no_picture_by_a_path(name: str, inside: Path) -> None:
    """An exported image is called by its number in the sequence, and SQLite keeps text in a column of numbers."""
    life = EventfulLife(1)
    life.happen(5)
    path = inside / "room.stillmap"
    save_map(path, StoredMap(life.world, CAMERA, (session(),)))
    with closing(sqlite3.connect(path)) as database, database:
        database.execute("UPDATE keyframes SET image_index = ?", (name,))
    with pytest.raises(MapError):
        load_map(path)


def test_a_list_may_name_images_elsewhere_which_are_only_read(inside: Path) -> None:
    """Sequences may share images; what is made of them lies where the run was told to write."""
    room = inside / "room"
    write_rgbd_folder(open_dataset("synthetic:empty,frames=3,fps=10"), room)
    for name in ("rgb", "depth"):
        (room / name).rename(inside / name)
        listed = (room / f"{name}.txt").read_text(encoding="utf-8").replace(f"{name}/", f"../{name}/")
        (room / f"{name}.txt").write_text(listed, encoding="utf-8")
    before = {path: path.stat().st_mtime_ns for path in inside.rglob("*") if path.is_file()}
    config = replace(SlamConfig(), dense=NoDenseMapConfig())
    run(open_dataset(str(room)), config, RunOptions(folder=inside / "out", pictures=1, masks=inside / "masks"))
    assert len(list((inside / "masks").iterdir())) == 3
    found = {path: path.stat().st_mtime_ns for path in inside.rglob("*") if path.is_file()}
    added = {path.relative_to(inside).parts[0] for path in found.keys() - before.keys()}
    assert added == {"out", "masks"}
    assert {path: found[path] for path in before} == before
