"""What `stillroom download` knows by name, and where it comes from."""

import hashlib
import re
import shutil
import tarfile
import zipfile
from dataclasses import dataclass
from pathlib import Path

from stillroom.datasets.archive import BrokenArchiveError, unpack
from stillroom.download.fetch import Progress, fetch, no_progress, sha256_of
from stillroom.errors import DatasetError, DownloadError


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
"""PSPNet on ResNet-50 v1c by OpenMMLab (Apache-2.0), trained on VOC2012-aug: what PSPNet-SLAM starts from."""
PSPNET_R50_MD5 = "c563f7683bab2a869fe095a9eb801f6c"
PSPNET_R50_SHA256_BEGINS = "ed5dfbd9"

TUM_NAME = re.compile(r"(?:rgbd_dataset_)?(?:freiburg|fr)([123])_(\w+)", re.ASCII)
BONN_NAME = re.compile(r"(?:rgbd_bonn_)?(\w+)", re.ASCII)
KNOWN = "tum/<name> (tum/freiburg1_rpy), bonn/<name> (bonn/crowd), pspnet-r50"


def download(target: str, folder: Path, progress: Progress = no_progress, addresses: Addresses = OFFICIAL) -> Path:
    """Fetch a data set or a network, and return where it lies.

    Args:
        target: `tum/<name>` or `bonn/<name>`, the names as the data sets give them, with or without their prefix, "fr1"
            for "freiburg1"; or `pspnet-r50`, OpenMMLab's checkpoint of PSPNet on ResNet-50, for
            `stillroom train pspnet --backbone resnet50`.
        folder: Where to put it. A TUM sequence stays the archive it is, which is read as it is; a Bonn sequence
            becomes a folder.
        progress: Told how far each file has come.
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


def _download_bonn(sequence: str, folder: Path, progress: Progress, addresses: Addresses) -> Path:
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
