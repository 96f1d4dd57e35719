"""What `stillroom download` knows by name, and where it comes from."""

import hashlib
import re
import shutil
import tarfile
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from stillroom.datasets.archive import BrokenArchiveError, unpack
from stillroom.download.fetch import AbsentError, Progress, fetch, no_progress, sha256_of
from stillroom.errors import DatasetError, DownloadError


@dataclass(frozen=True)
class Addresses:
    """Where the files lie: a mirror of one's own has others.

    Attributes:
        tum: The folder with `freiburgN/<name>.tgz`.
        bonn: The folder with `<name>.zip`.
        yolo_fastest: Folders with YOLO-Fastest's cfg and weights, tried in this order.
        coco_names: Files with the 80 COCO class names, tried in this order.
        pspnet_r50: The folder with OpenMMLab's checkpoint of PSPNet on ResNet-50.
    """

    tum: str = "https://cvg.cit.tum.de/rgbd/dataset"
    bonn: str = "https://www.ipb.uni-bonn.de/html/projects/rgbd_dynamic2019"
    # The commit first, because its files are the ones with the checksums below; the branch should it move.
    yolo_fastest: tuple[str, ...] = (
        "https://raw.githubusercontent.com/dog-qiuqiu/Yolo-Fastest/96a2900/ModelZoo/yolo-fastest-1.1_coco",
        "https://raw.githubusercontent.com/dog-qiuqiu/Yolo-Fastest/master/ModelZoo/yolo-fastest-1.1_coco",
    )
    coco_names: tuple[str, ...] = (
        "https://raw.githubusercontent.com/pjreddie/darknet/master/data/coco.names",
        "https://raw.githubusercontent.com/dog-qiuqiu/Yolo-Fastest/master/data/coco.names",
    )
    pspnet_r50: str = "https://download.openmmlab.com/mmsegmentation/v0.5/pspnet/pspnet_r50-d8_512x512_20k_voc12aug"


OFFICIAL = Addresses()

YOLO_FOLDER = "yolo_fastest"
COCO_NAMES = "coco.names"
MODELS: dict[str, str] = {
    COCO_NAMES: "634a1132eb33f8091d60f2c346ababe8b905ae08387037aed883953b7329af84",
    "yolo-fastest-1.1.cfg": "f6df5775c1e862998cf69046eba9265be3ae84dfe8b2caab7529823f0795bf70",
    "yolo-fastest-1.1.weights": "1c445c42bbd6df63edea2cc69f99667b5650d663ca11e34b116240740cd42890",
    "yolo-fastest-1.1-xl.cfg": "c458427acc4fbeabceff4528ef7b65b066c0308ce599460f8ba299eba63abad3",
    "yolo-fastest-1.1-xl.weights": "fac5fb41786c1f38f04972a658443b189f48720d7d117f9a044100e98a35b0c5",
}
"""YOLO-Fastest 1.1 (github.com/dog-qiuqiu/Yolo-Fastest, "YOLO licence v2"): SHA-256 of each file."""

PSPNET_R50 = "pspnet_r50-d8_512x512_20k_voc12aug_20200617_101958-ed5dfbd9.pth"
"""PSPNet on ResNet-50 v1c by OpenMMLab (Apache-2.0), trained on VOC2012-aug: what PSPNet-SLAM starts from."""
PSPNET_R50_MD5 = "c563f7683bab2a869fe095a9eb801f6c"
PSPNET_R50_SHA256_BEGINS = "ed5dfbd9"

TUM_NAME = re.compile(r"(?:rgbd_dataset_)?(?:freiburg|fr)([123])_(\w+)", re.ASCII)
BONN_NAME = re.compile(r"(?:rgbd_bonn_)?(\w+)", re.ASCII)
KNOWN = "tum/<name> (tum/freiburg1_rpy), bonn/<name> (bonn/crowd), models"


def download(target: str, folder: Path, progress: Progress = no_progress, addresses: Addresses = OFFICIAL) -> Path:
    """Fetch a data set or the weights, and return where they lie.

    Args:
        target: `tum/<name>`, `bonn/<name>` or `models`; the names as the data sets give them, with or without
            their prefix, "fr1" for "freiburg1".
        folder: Where to put it. A TUM sequence stays the archive it is, which is read as it is; a Bonn sequence
            becomes a folder; the weights go into a folder `yolo_fastest`.
        progress: Told how far each file has come.
        addresses: Where to fetch from.

    Raises:
        DownloadError: The target is unknown, or a file cannot be fetched or is not what it should be.
    """
    kind, _, name = target.partition("/")
    if target == "models":
        return _download_models(folder, progress, addresses)
    if kind == "tum" and (tum := TUM_NAME.fullmatch(name)):
        sequence = f"rgbd_dataset_freiburg{tum[1]}_{tum[2]}"
        address = f"{addresses.tum}/freiburg{tum[1]}/{sequence}.tgz"
        return fetch(address, folder / f"{sequence}.tgz", progress, is_plausible=tarfile.is_tarfile)
    if kind == "bonn" and (bonn := BONN_NAME.fullmatch(name)):
        return _download_bonn(f"rgbd_bonn_{bonn[1]}", folder, progress, addresses)
    raise DownloadError(f"'{target}': nothing of this name can be downloaded; known: {KNOWN}")


def download_pspnet_r50(folder: Path, progress: Progress = no_progress, addresses: Addresses = OFFICIAL) -> Path:
    """Fetch OpenMMLab's checkpoint of PSPNet on ResNet-50, for `stillroom train pspnet --backbone resnet50`.

    Args:
        folder: Where to put it.
        progress: Told how far it has come.
        addresses: Where to fetch from.

    Raises:
        DownloadError: It cannot be fetched, or is not what it should be.
    """
    destination = folder / PSPNET_R50
    return fetch(f"{addresses.pspnet_r50}/{PSPNET_R50}", destination, progress, is_plausible=_is_pspnet_r50)


def _is_pspnet_r50(path: Path) -> bool:
    """Tell whether a file has the checksum that is known, and the digits of the other that its name has."""
    with path.open("rb") as file:
        md5 = hashlib.file_digest(file, lambda: hashlib.md5(usedforsecurity=False)).hexdigest()
    return md5 == PSPNET_R50_MD5 and sha256_of(path).startswith(PSPNET_R50_SHA256_BEGINS)


def _download_models(folder: Path, progress: Progress, addresses: Addresses) -> Path:
    for name, sha256 in MODELS.items():
        where = [f"{base}/{name}" for base in addresses.yolo_fastest]
        if name == COCO_NAMES:
            where = list(addresses.coco_names)
        _fetch_from_any(where, folder / YOLO_FOLDER / name, progress, sha256)
    return folder / YOLO_FOLDER


def _fetch_from_any(where: Sequence[str], destination: Path, progress: Progress, sha256: str) -> None:
    """Fetch a file from the first address that has it."""
    for address in where[:-1]:
        try:
            fetch(address, destination, progress, sha256)
        except AbsentError:
            continue
        return
    fetch(where[-1], destination, progress, sha256)


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
