"""Download data sets and networks by name from their own addresses; checksums are verified where known."""

import hashlib
import http.client
import re
import shutil
import ssl
import tarfile
import urllib.error
import urllib.request
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from stillroom.datasets.archive import BrokenArchiveError, unpack
from stillroom.errors import DatasetError, DownloadError

# One file over HTTP: resumed where it broke off, checked, and in place only when it is whole.


CHUNK_BYTES = 1 << 18
TIMEOUT_S = 30.0
HEADERS = {"User-Agent": "stillroom", "Accept-Encoding": "identity"}

Check = Callable[[Path], bool]


class DownloadProgress(Protocol):
    """Callback for the progress of a download; called often, so it should be quick."""

    def __call__(self, name: str, done_bytes: int, total_bytes: int | None) -> None:
        """Report that `done_bytes` of `total_bytes` (None if unknown) are received."""


def no_progress(name: str, done_bytes: int, total_bytes: int | None) -> None:
    """Ignore the progress."""


def fetch(
    address: str,
    destination: Path,
    progress: DownloadProgress = no_progress,
    sha256: str | None = None,
    is_plausible: Check | None = None,
) -> Path:
    """Download a file; an interrupted download is resumed.

    A partial download is kept in `<destination>.part`; `destination` appears only when it is complete and verified.

    Args:
        address: The file's URL.
        destination: Where it shall lie. A file that lies there already and has the right checksum is kept.
        progress: Callback for how far it has come.
        sha256: The checksum that it must have, in hexadecimal digits; unchecked where not given.
        is_plausible: Returns whether the fetched file is of the right kind, where no checksum is known.

    Raises:
        DownloadError: The server cannot be reached, the connection broke (run it again: it is resumed),
            the file came with the wrong checksum or is no such file (it was removed), or it cannot be written.
    """
    if destination.is_file() and (sha256 is None or sha256_of(destination) == sha256):
        return destination
    part = destination.with_name(destination.name + ".part")
    try:
        destination.parent.mkdir(parents=True, exist_ok=True)
        _receive(address, part, destination.name, progress)
        _verify(address, part, sha256, is_plausible)
        part.replace(destination)
    except DownloadError:
        raise
    except (urllib.error.URLError, http.client.HTTPException, TimeoutError, ConnectionError, ssl.SSLError) as error:
        reason = getattr(error, "reason", None) or error
        raise DownloadError(f"{address}: {_kept(part)} ({reason}); run it again when the network is back") from error
    except OSError as error:
        raise DownloadError(f"{destination}: cannot be written ({error.strerror or error})") from error
    return destination


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file in hexadecimal digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _receive(address: str, part: Path, name: str, progress: DownloadProgress) -> None:
    have = part.stat().st_size if part.exists() else 0
    request = urllib.request.Request(address, headers=HEADERS)
    if have:
        request.add_header("Range", f"bytes={have}-")
    try:
        response = urllib.request.urlopen(request, timeout=TIMEOUT_S)
    except urllib.error.HTTPError as error:
        error.close()
        if error.code == http.HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE and have:
            _after_the_end(address, part, name, progress, error.headers.get("Content-Range"))
            return
        if error.code in (http.HTTPStatus.NOT_FOUND, http.HTTPStatus.GONE):
            raise DownloadError(f"{address}: the server has no such file; is the name right?") from error
        raise DownloadError(f"{address}: the server answered {error.code} {error.reason}") from error
    with response:
        # A server without range support answers 200 and sends everything; the partial file is then discarded.
        start = have if response.status == http.HTTPStatus.PARTIAL_CONTENT else 0
        if start and not response.headers.get("Content-Range", "").startswith(f"bytes {start}-"):
            raise DownloadError(f"{address}: the server sent another part than was asked for; delete {part}")
        length = response.headers.get("Content-Length")
        total = start + int(length) if length and length.isdigit() else None
        done = start
        with part.open("ab" if start else "wb") as file:
            progress(name, done, total)
            while chunk := response.read(CHUNK_BYTES):
                file.write(chunk)
                done += len(chunk)
                progress(name, done, total)
    if total is not None and done < total:
        raise DownloadError(f"{address}: {_kept(part, total)}; run it again to resume")


def _after_the_end(address: str, part: Path, name: str, progress: DownloadProgress, content_range: str | None) -> None:
    """Handle a part that reaches the file's end: it is complete, or of another file and is fetched again."""
    have = part.stat().st_size
    if content_range == f"bytes */{have}":
        progress(name, have, have)
        return
    part.unlink()
    _receive(address, part, name, progress)


def _verify(address: str, part: Path, sha256: str | None, is_plausible: Check | None) -> None:
    if sha256 is not None:
        came = sha256_of(part)
        if came != sha256:
            part.unlink()
            raise DownloadError(
                f"{address}: came with checksum {came[:12]}…, not {sha256[:12]}…; it was removed, run it again"
            )
    elif is_plausible is not None and not is_plausible(part):
        part.unlink()
        raise DownloadError(f"{address}: what came is not the file that was meant; it was removed")


def _kept(part: Path, total: int | None = None) -> str:
    have = part.stat().st_size if part.exists() else 0
    if not have:
        return "cannot be fetched"
    of_total = "" if total is None else f" of {total}"
    return f"broke off after {have}{of_total} bytes, which are kept"


@dataclass(frozen=True)
class Addresses:
    """Where the files lie: a mirror of one's own has others.

    Attributes:
        tum: The folder with `freiburgN/<name>.tgz`.
        bonn: The folder with `<name>.zip`.
        pspnet_r50: The folder with OpenMMLab's checkpoint of PSPNet on ResNet-50.
    """

    tum: str = "https://cvg.cit.tum.de/rgbd/dataset"
    bonn: str = "https://www.ipb.uni-bonn.de/html/projects/rgbd_dynamic2019"
    pspnet_r50: str = "https://download.openmmlab.com/mmsegmentation/v0.5/pspnet/pspnet_r50-d8_512x512_20k_voc12aug"


OFFICIAL = Addresses()

PSPNET_R50 = "pspnet-r50"
PSPNET_R50_FILE = "pspnet_r50-d8_512x512_20k_voc12aug_20200617_101958-ed5dfbd9.pth"
"""PSPNet on ResNet-50 v1c by OpenMMLab (Apache-2.0), trained on VOC2012-aug: the initial weights of PSPNet-SLAM."""
PSPNET_R50_MD5 = "c563f7683bab2a869fe095a9eb801f6c"
PSPNET_R50_SHA256_BEGINS = "ed5dfbd9"

TUM_NAME = re.compile(r"(?:rgbd_dataset_)?(?:freiburg|fr)([123])_(\w+)", re.ASCII)
BONN_NAME = re.compile(r"(?:rgbd_bonn_)?(\w+)", re.ASCII)
KNOWN = "tum/<name> (tum/freiburg1_rpy), bonn/<name> (bonn/crowd), pspnet-r50"


def download(
    target: str, folder: Path, progress: DownloadProgress = no_progress, addresses: Addresses = OFFICIAL
) -> Path:
    """Fetch a data set or a network, and return where it lies.

    Args:
        target: `tum/<name>` or `bonn/<name>`, the names as the data sets give them, with or without their prefix, "fr1"
            for "freiburg1"; or `pspnet-r50`, OpenMMLab's checkpoint of PSPNet on ResNet-50, for
            `stillroom train pspnet --backbone resnet50`.
        folder: Where to put it. A TUM sequence stays the archive it is, which is read as it is; a Bonn sequence
            becomes a folder.
        progress: Callback for how far each file has come.
        addresses: Where to fetch from.

    Raises:
        DownloadError: The target is unknown, or a file cannot be fetched or is not what it should be.
    """
    kind, _, name = target.partition("/")
    if target == PSPNET_R50:
        address = f"{addresses.pspnet_r50}/{PSPNET_R50_FILE}"
        return fetch(address, folder / PSPNET_R50_FILE, progress, is_plausible=_is_pspnet_r50)
    if kind == "tum" and (tum := TUM_NAME.fullmatch(name)):
        sequence = f"rgbd_dataset_freiburg{tum[1]}_{tum[2]}"
        address = f"{addresses.tum}/freiburg{tum[1]}/{sequence}.tgz"
        return fetch(address, folder / f"{sequence}.tgz", progress, is_plausible=tarfile.is_tarfile)
    if kind == "bonn" and (bonn := BONN_NAME.fullmatch(name)):
        return _download_bonn(f"rgbd_bonn_{bonn[1]}", folder, progress, addresses)
    raise DownloadError(f"'{target}': nothing of this name can be downloaded; known: {KNOWN}")


def _is_pspnet_r50(path: Path) -> bool:
    """Return whether a file has the checksum that is known, and the digits of the other that its name has."""
    with path.open("rb") as file:
        md5 = hashlib.file_digest(file, lambda: hashlib.md5(usedforsecurity=False)).hexdigest()
    return md5 == PSPNET_R50_MD5 and sha256_of(path).startswith(PSPNET_R50_SHA256_BEGINS)


def _download_bonn(sequence: str, folder: Path, progress: DownloadProgress, addresses: Addresses) -> Path:
    destination = folder / sequence
    if destination.is_dir():
        return destination
    zipped = folder / f"{sequence}.zip"
    address = f"{addresses.bonn}/{sequence}.zip"
    fetch(address, zipped, progress, is_plausible=zipfile.is_zipfile)
    unpacked = folder / f".{sequence}.unpacked"
    try:
        unpack(zipped, unpacked)
        # The official archives hold one folder of the sequence's name.
        inner = unpacked / sequence
        (inner if inner.is_dir() else unpacked).replace(destination)
    except BrokenArchiveError as error:
        zipped.unlink()
        raise DownloadError(f"{address}: came broken ({error}); it was removed, run it again") from error
    except DatasetError as error:
        raise DownloadError(str(error)) from error
    finally:
        shutil.rmtree(unpacked, ignore_errors=True)
    zipped.unlink()
    return destination
