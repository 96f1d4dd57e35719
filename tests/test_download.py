"""Downloading, against a server of our own that breaks off, lies, forgets ranges and has nothing."""

import hashlib
import io
import re
import tarfile
import threading
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from stillroom.datasets.open import open_dataset
from stillroom.download import OFFICIAL, PSPNET_R50_FILE, Addresses, download, fetch
from stillroom.errors import DownloadError
from stillroom.testing.tiny_sequence import write_tiny_sequence

CONTENT = bytes(range(256)) * 4000  # a megabyte, in several chunks
SHA256 = hashlib.sha256(CONTENT).hexdigest()


@dataclass
class Server:
    """What the server has, how it behaves, and what it was asked for."""

    files: dict[str, bytes] = field(default_factory=dict)
    break_after: int | None = None
    knows_ranges: bool = True
    says_length: bool = True
    status: int | None = None
    wrong_range: bool = False
    asked: list[tuple[str, str | None]] = field(default_factory=list)
    address: str = ""


@pytest.fixture
def server() -> Iterator[Server]:
    state = Server()

    class Handler(BaseHTTPRequestHandler):
        def log_message(self, *_: object) -> None:
            pass

        def do_GET(self) -> None:
            answer(self, state)

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as http:
        thread = threading.Thread(target=http.serve_forever, args=(0.01,), daemon=True)
        thread.start()
        state.address = f"http://127.0.0.1:{http.server_address[1]}"
        yield state
        http.shutdown()
        thread.join()


def answer(handler: BaseHTTPRequestHandler, state: Server) -> None:
    wanted = handler.headers.get("Range")
    state.asked.append((handler.path, wanted))
    content = state.files.get(handler.path)
    if content is None or state.status:
        handler.send_error(state.status or 404)
        return
    start = 0
    if wanted and state.knows_ranges:
        start = int(re.fullmatch(r"bytes=(\d+)-", wanted)[1])
        if start >= len(content):
            handler.send_response(416)
            handler.send_header("Content-Range", f"bytes */{len(content)}")
            handler.end_headers()
            return
        handler.send_response(206)
        said = 0 if state.wrong_range else start
        handler.send_header("Content-Range", f"bytes {said}-{len(content) - 1}/{len(content)}")
    else:
        handler.send_response(200)
    if state.says_length:
        handler.send_header("Content-Length", str(len(content) - start))
    handler.end_headers()
    stop = len(content) if state.break_after is None else start + state.break_after
    handler.wfile.write(content[start:stop])


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("no_proxy", "127.0.0.1")


@pytest.fixture
def goal(tmp_path: Path) -> Path:
    return tmp_path / "folder" / "file.bin"


def part_of(goal: Path) -> Path:
    return goal.with_name(goal.name + ".part")


def refused(caught: pytest.ExceptionInfo[DownloadError]) -> str:
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_fetches_a_whole_file_and_tells_how_far_it_is(server: Server, goal: Path) -> None:
    server.files["/file.bin"] = CONTENT
    steps: list[tuple[str, int, int | None]] = []
    assert fetch(f"{server.address}/file.bin", goal, lambda *step: steps.append(step), SHA256) == goal
    assert goal.read_bytes() == CONTENT
    assert not part_of(goal).exists()
    assert steps[0] == ("file.bin", 0, len(CONTENT))
    assert steps[-1] == ("file.bin", len(CONTENT), len(CONTENT))
    done = [step[1] for step in steps]
    assert done == sorted(done)
    assert len(done) > 3


def test_what_is_there_and_right_is_not_fetched_again(server: Server, goal: Path) -> None:
    server.files["/file.bin"] = CONTENT
    fetch(f"{server.address}/file.bin", goal, sha256=SHA256)
    fetch(f"{server.address}/file.bin", goal, sha256=SHA256)
    assert len(server.asked) == 1


def test_what_is_there_and_wrong_is_fetched_again(server: Server, goal: Path) -> None:
    server.files["/file.bin"] = CONTENT
    goal.parent.mkdir()
    goal.write_bytes(b"something else")
    fetch(f"{server.address}/file.bin", goal, sha256=SHA256)
    assert goal.read_bytes() == CONTENT


def test_an_interrupted_download_is_kept_and_goes_on(server: Server, goal: Path) -> None:
    server.files["/file.bin"] = CONTENT
    server.break_after = 300_000
    with pytest.raises(DownloadError) as caught:
        fetch(f"{server.address}/file.bin", goal, sha256=SHA256)
    assert "broke off after 300000 of 1024000 bytes, which are kept; run it again" in refused(caught)
    assert not goal.exists()
    assert part_of(goal).read_bytes() == CONTENT[:300_000]
    server.break_after = None
    steps: list[int] = []
    fetch(f"{server.address}/file.bin", goal, lambda name, done, total: steps.append(done), SHA256)
    assert server.asked[-1] == ("/file.bin", "bytes=300000-")
    assert steps[0] == 300_000
    assert goal.read_bytes() == CONTENT
    assert not part_of(goal).exists()


def test_a_server_that_forgets_ranges_sends_all_and_it_is_right(server: Server, goal: Path) -> None:
    server.files["/file.bin"] = CONTENT
    goal.parent.mkdir()
    part_of(goal).write_bytes(b"the start of an older file" * 100)
    server.knows_ranges = False
    fetch(f"{server.address}/file.bin", goal, sha256=SHA256)
    assert server.asked == [("/file.bin", "bytes=2600-")]
    assert goal.read_bytes() == CONTENT


def test_a_server_that_sends_another_part_is_refused(server: Server, goal: Path) -> None:
    server.files["/file.bin"] = CONTENT
    goal.parent.mkdir()
    part_of(goal).write_bytes(CONTENT[:1000])
    server.wrong_range = True
    with pytest.raises(DownloadError, match="sent another part than was asked for"):
        fetch(f"{server.address}/file.bin", goal)
    assert part_of(goal).read_bytes() == CONTENT[:1000]


def test_a_part_that_is_whole_already_is_taken(server: Server, goal: Path) -> None:
    server.files["/file.bin"] = CONTENT
    goal.parent.mkdir()
    part_of(goal).write_bytes(CONTENT)
    fetch(f"{server.address}/file.bin", goal, sha256=SHA256)
    assert goal.read_bytes() == CONTENT
    assert len(server.asked) == 1


def test_a_part_longer_than_the_file_starts_anew(server: Server, goal: Path) -> None:
    server.files["/file.bin"] = CONTENT
    goal.parent.mkdir()
    part_of(goal).write_bytes(CONTENT + b"more")
    fetch(f"{server.address}/file.bin", goal, sha256=SHA256)
    assert goal.read_bytes() == CONTENT


def test_a_file_of_unknown_length_arrives(server: Server, goal: Path) -> None:
    server.files["/file.bin"] = CONTENT
    server.says_length = False
    totals: set[int | None] = set()
    fetch(f"{server.address}/file.bin", goal, lambda name, done, total: totals.add(total), SHA256)
    assert goal.read_bytes() == CONTENT
    assert totals == {None}


def test_the_wrong_checksum_removes_the_part(server: Server, goal: Path) -> None:
    server.files["/file.bin"] = CONTENT[:-1] + b"x"
    with pytest.raises(DownloadError) as caught:
        fetch(f"{server.address}/file.bin", goal, sha256=SHA256)
    assert f"not {SHA256[:12]}…; it was removed" in refused(caught)
    assert list(goal.parent.iterdir()) == []


def test_a_missing_file_is_said(server: Server, goal: Path) -> None:
    with pytest.raises(DownloadError) as caught:
        fetch(f"{server.address}/file.bin", goal)
    assert refused(caught) == f"{server.address}/file.bin: the server has no such file; is the name right?"
    assert list(goal.parent.iterdir()) == []


def test_a_server_in_trouble_is_said_and_the_part_kept(server: Server, goal: Path) -> None:
    server.files["/file.bin"] = CONTENT
    server.status = 503
    goal.parent.mkdir()
    part_of(goal).write_bytes(CONTENT[:500])
    with pytest.raises(DownloadError, match="the server answered 503"):
        fetch(f"{server.address}/file.bin", goal)
    assert part_of(goal).read_bytes() == CONTENT[:500]


def test_without_a_network_says_so(goal: Path) -> None:
    with pytest.raises(DownloadError) as caught:
        fetch("http://127.0.0.1:1/file.bin", goal)
    assert "cannot be fetched" in refused(caught)
    assert "run it again when the network is back" in refused(caught)


def test_a_folder_that_cannot_be_written_is_said(server: Server, tmp_path: Path) -> None:
    server.files["/file.bin"] = CONTENT
    (tmp_path / "file").touch()
    with pytest.raises(DownloadError, match="cannot be written"):
        fetch(f"{server.address}/file.bin", tmp_path / "file" / "file.bin")


def tgz_bytes(folder: Path, top: str) -> bytes:
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w:gz") as tar:
        tar.add(folder, arcname=top)
    return packed.getvalue()


def zip_bytes(folder: Path, top: str) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as zipped:
        for file in sorted(folder.rglob("*")):
            zipped.write(file, Path(top) / file.relative_to(folder))
    return packed.getvalue()


@pytest.fixture
def tiny(tmp_path: Path) -> Path:
    write_tiny_sequence(tmp_path / "tiny")
    return tmp_path / "tiny"


@pytest.mark.parametrize("name", ["freiburg3_tiny_1", "rgbd_dataset_freiburg3_tiny_1", "fr3_tiny_1"])
def test_a_tum_sequence_stays_an_archive_and_opens(name: str, server: Server, tiny: Path, tmp_path: Path) -> None:
    full = "rgbd_dataset_freiburg3_tiny_1"
    server.files[f"/dataset/freiburg3/{full}.tgz"] = tgz_bytes(tiny, full)
    came = download(f"tum/{name}", tmp_path / "data", addresses=Addresses(tum=f"{server.address}/dataset"))
    assert came == tmp_path / "data" / f"{full}.tgz"
    sequence = open_dataset(str(came))
    assert sequence.name == full
    assert len(sequence) == 6


@pytest.mark.parametrize("name", ["tiny", "rgbd_bonn_tiny"])
def test_a_bonn_sequence_becomes_a_folder(name: str, server: Server, tiny: Path, tmp_path: Path) -> None:
    server.files["/bonn/rgbd_bonn_tiny.zip"] = zip_bytes(tiny, "rgbd_bonn_tiny")
    addresses = Addresses(bonn=f"{server.address}/bonn")
    came = download(f"bonn/{name}", tmp_path / "data", addresses=addresses)
    assert came == tmp_path / "data" / "rgbd_bonn_tiny"
    assert [path.name for path in came.parent.iterdir()] == ["rgbd_bonn_tiny"]
    assert len(open_dataset(str(came))) == 6
    assert download(f"bonn/{name}", tmp_path / "data", addresses=addresses) == came
    assert len(server.asked) == 1


def test_an_error_page_in_place_of_an_archive_is_refused(server: Server, tmp_path: Path) -> None:
    page = b"<html>We moved.</html>"
    server.files["/freiburg1/rgbd_dataset_freiburg1_x.tgz"] = page
    server.files["/rgbd_bonn_x.zip"] = page
    addresses = Addresses(tum=server.address, bonn=server.address)
    for target in ("tum/freiburg1_x", "bonn/x"):
        with pytest.raises(DownloadError, match="not the file that was meant; it was removed"):
            download(target, tmp_path / "data", addresses=addresses)
        assert list((tmp_path / "data").iterdir()) == []


def test_a_damaged_zip_is_removed(server: Server, tiny: Path, tmp_path: Path) -> None:
    damaged = bytearray(zip_bytes(tiny, "rgbd_bonn_tiny"))
    damaged[2000] ^= 255
    server.files["/rgbd_bonn_tiny.zip"] = bytes(damaged)
    with pytest.raises(DownloadError, match="came broken"):
        download("bonn/tiny", tmp_path / "data", addresses=Addresses(bonn=server.address))
    assert list((tmp_path / "data").iterdir()) == []


def test_a_zip_that_leads_out_is_removed(server: Server, tmp_path: Path) -> None:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as zipped:
        zipped.writestr("../../outside", "x")
    server.files["/rgbd_bonn_evil.zip"] = packed.getvalue()
    with pytest.raises(DownloadError, match="leads out of it"):
        download("bonn/evil", tmp_path / "data", addresses=Addresses(bonn=server.address))
    assert list((tmp_path / "data").iterdir()) == []
    assert not (tmp_path / "outside").exists()


@pytest.mark.parametrize(
    "target", ["", "tum", "tum/", "tum/freiburg4_x", "tum/../x", "bonn/../../x", "bonn/", "kitti/00", "models"]
)
def test_an_unknown_target_names_the_known_ones(target: str, tmp_path: Path) -> None:
    with pytest.raises(DownloadError, match=r"nothing of this name .*tum/<name>.*bonn/<name>.*pspnet-r50"):
        download(target, tmp_path)


def test_the_official_addresses_are_secure() -> None:
    for address in (OFFICIAL.tum, OFFICIAL.bonn, OFFICIAL.pspnet_r50):
        assert address.startswith("https://")


def test_the_checkpoint_of_pspnet_must_be_the_one_that_is_meant(server: Server, tmp_path: Path) -> None:
    name = "pspnet_r50-d8_512x512_20k_voc12aug_20200617_101958-ed5dfbd9.pth"
    assert OFFICIAL.pspnet_r50 == (
        "https://download.openmmlab.com/mmsegmentation/v0.5/pspnet/pspnet_r50-d8_512x512_20k_voc12aug"
    )
    server.files[f"/mm/{name}"] = CONTENT
    with pytest.raises(DownloadError, match="is not the file that was meant"):
        download("pspnet-r50", tmp_path, addresses=Addresses(pspnet_r50=f"{server.address}/mm"))
    assert list(tmp_path.iterdir()) == []
    assert server.asked[-1][0] == f"/mm/{name}"


def test_the_right_checkpoint_of_pspnet_is_kept(
    server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    server.files[f"/mm/{PSPNET_R50_FILE}"] = CONTENT
    monkeypatch.setattr("stillroom.download.PSPNET_R50_MD5", hashlib.md5(CONTENT).hexdigest())
    monkeypatch.setattr("stillroom.download.PSPNET_R50_SHA256_BEGINS", SHA256[:8])
    place = download("pspnet-r50", tmp_path, addresses=Addresses(pspnet_r50=f"{server.address}/mm"))
    assert place.read_bytes() == CONTENT
    monkeypatch.setattr("stillroom.download.PSPNET_R50_SHA256_BEGINS", "00000000")
    place.unlink()
    with pytest.raises(DownloadError, match="is not the file that was meant"):
        download("pspnet-r50", tmp_path, addresses=Addresses(pspnet_r50=f"{server.address}/mm"))
