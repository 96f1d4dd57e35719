"""Every data set keeps the socket's contract; and the contract notices when one does not."""

import tarfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from stillroom.bench.speed import UnitMeter
from stillroom.data.image import RgbdImage
from stillroom.datasets.open import open_dataset
from stillroom.datasets.selection import select
from stillroom.datasets.tum import open_tum
from stillroom.errors import FrameError
from stillroom.protocols import Dataset
from stillroom.testing.dataset_contract import KnownPixel, check_dataset
from stillroom.testing.tiny_sequence import write_tiny_sequence

Opened = tuple[Dataset, tuple[KnownPixel, ...]]


def tum_folder(tmp_path: Path) -> Opened:
    known = write_tiny_sequence(tmp_path / "tiny")
    return open_dataset(str(tmp_path / "tiny")), known


def tgz(tmp_path: Path) -> Opened:
    known = write_tiny_sequence(tmp_path / "tiny")
    with tarfile.open(tmp_path / "tiny.tgz", "w:gz") as tar:
        tar.add(tmp_path / "tiny", arcname="tiny")
    return open_dataset(str(tmp_path / "tiny.tgz")), known


def plain_folder_timed_by_name(tmp_path: Path) -> Opened:
    known = write_tiny_sequence(tmp_path / "tiny")
    (tmp_path / "tiny" / "rgb.txt").unlink()
    return open_dataset(str(tmp_path / "tiny")), known


def plain_folder_with_a_rate(tmp_path: Path) -> Opened:
    known = write_tiny_sequence(tmp_path / "tiny")
    (tmp_path / "tiny" / "rgb.txt").unlink()
    return open_dataset(str(tmp_path / "tiny"), fps=30.0), known


def with_a_bad_frame(tmp_path: Path) -> Opened:
    known = write_tiny_sequence(tmp_path / "tiny")
    sequence = open_tum(tmp_path / "tiny")
    sequence.rgb_files[2].write_bytes(b"")
    return sequence, tuple(pixel for pixel in known if pixel.index != 2)


def played_backwards(tmp_path: Path) -> Opened:
    known = write_tiny_sequence(tmp_path / "tiny", frames=12)
    chosen = select(open_tum(tmp_path / "tiny"), frames="2:11", reverse=True)
    return chosen, tuple(replace(p, index=10 - p.index) for p in known if 2 <= p.index < 11)


def selection(tmp_path: Path) -> Opened:
    known = write_tiny_sequence(tmp_path / "tiny", frames=12)
    chosen = select(open_tum(tmp_path / "tiny"), frames="2:11", drop=["4:6"])
    place_of = {number: place for place, number in enumerate([2, 3, 6, 7, 8, 9, 10])}
    return chosen, tuple(replace(p, index=place_of[p.index]) for p in known if p.index in place_of)


def blackout(tmp_path: Path) -> Opened:
    write_tiny_sequence(tmp_path / "tiny")
    chosen = select(open_tum(tmp_path / "tiny"), blackout=["1:4"])
    return chosen, (KnownPixel(2, 3, 5, (0, 0, 0), 0.0),)


def metered(tmp_path: Path) -> Opened:
    known = write_tiny_sequence(tmp_path / "tiny", frames=12)
    chosen = select(open_tum(tmp_path / "tiny"), frames="2:11")
    return UnitMeter(chosen), tuple(replace(p, index=p.index - 2) for p in known if 2 <= p.index < 11)


# A rendered sequence joins here, one function each: `def walking(tmp_path) -> Opened`.
OPENERS: list[Callable[[Path], Opened]] = [
    tum_folder,
    tgz,
    plain_folder_timed_by_name,
    plain_folder_with_a_rate,
    with_a_bad_frame,
    selection,
    played_backwards,
    blackout,
    metered,
]


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


@pytest.mark.parametrize("opener", OPENERS, ids=lambda opener: opener.__name__)
def test_keeps_the_contract(opener: Callable[[Path], Opened], tmp_path: Path) -> None:
    dataset, known = opener(tmp_path)
    assert known
    check_dataset(dataset, *known)


def seen_by_pillow(dataset: Dataset, folder: Path, index: int, row: int, column: int) -> KnownPixel:
    """What an independent decoder reads from the files that the lists name, and a factor of 5000."""
    rgb_file = (folder / "rgb.txt").read_text().splitlines()[2 + index].split()[1]
    depth_lines = [line.split() for line in (folder / "depth.txt").read_text().splitlines()[2:]]
    gaps = [abs(float(stamp) - dataset.timestamps_s[index]) for stamp, _ in depth_lines]
    depth_file = depth_lines[int(np.argmin(gaps))][1]
    rgb = np.asarray(Image.open(folder / rgb_file))[row, column]
    depth_m = np.asarray(Image.open(folder / depth_file))[row, column] / 5000.0
    # JPEG decoders may round differently.
    return KnownPixel(index, row, column, tuple(rgb.tolist()), float(depth_m), colour_tolerance=3)


@pytest.mark.parametrize("index", [0, 77, 149])
def test_the_real_freiburg1_stretch_keeps_the_contract(index: int, freiburg1: Path) -> None:
    dataset = open_dataset(str(freiburg1))
    check_dataset(dataset, *(seen_by_pillow(dataset, freiburg1, index, row, 300) for row in (100, 240, 400)))


@pytest.mark.parametrize("index", [0, 300, 559])
def test_the_real_bonn_stretch_keeps_the_contract(index: int, bonn: Path) -> None:
    dataset = open_dataset(str(bonn))
    check_dataset(dataset, *(seen_by_pillow(dataset, bonn, index, row, 300) for row in (100, 240, 400)))


class Broken:
    """A sequence that breaks one promise."""

    def __init__(self, inner: Dataset) -> None:
        self._inner = inner

    def __getattr__(self, name: str) -> object:
        return getattr(self._inner, name)

    def __len__(self) -> int:
        return len(self._inner)

    def __iter__(self) -> Iterator[RgbdImage]:
        return (self.load(place) for place in range(len(self)))

    def load(self, index: int) -> RgbdImage:
        return self.spoil(self._inner.load(index))

    def spoil(self, image: RgbdImage) -> RgbdImage:
        return image


class BlueFirst(Broken):
    def spoil(self, image: RgbdImage) -> RgbdImage:
        return replace(image, rgb=np.ascontiguousarray(image.rgb[:, :, ::-1]))


class Backwards(Broken):
    def __iter__(self) -> Iterator[RgbdImage]:
        return (self.load(place) for place in reversed(range(len(self))))


class Millimetres(Broken):
    def spoil(self, image: RgbdImage) -> RgbdImage:
        return replace(image, depth_m=image.depth_m * np.float32(1000))


class DoubleDepth(Broken):
    def spoil(self, image: RgbdImage) -> RgbdImage:
        return replace(image, depth_m=image.depth_m.astype(np.float64))


class NanDepth(Broken):
    def spoil(self, image: RgbdImage) -> RgbdImage:
        return replace(image, depth_m=np.where(image.depth_m > 0, image.depth_m, np.float32(np.nan)))


class Strided(Broken):
    def spoil(self, image: RgbdImage) -> RgbdImage:
        return replace(image, rgb=np.asfortranarray(image.rgb))


class Scaled(Broken):
    def spoil(self, image: RgbdImage) -> RgbdImage:
        return replace(image, rgb=image.rgb[::2, ::2].copy(), depth_m=image.depth_m[::2, ::2].copy())


class Unstable(Broken):
    calls = 0

    def spoil(self, image: RgbdImage) -> RgbdImage:
        self.calls += 1
        return replace(image, rgb=image.rgb + np.uint8(self.calls > 9))


class Shared(Broken):
    def load(self, index: int) -> RgbdImage:
        kept = self.__dict__.setdefault("kept", {})
        return kept.setdefault(index, self._inner.load(index))


class OneTime(Broken):
    @property
    def timestamps_s(self) -> np.ndarray:
        return np.zeros(len(self))


class FloatTimes(Broken):
    @property
    def timestamps_s(self) -> np.ndarray:
        return np.arange(len(self), dtype=np.float32)


class OtherTimes(Broken):
    def spoil(self, image: RgbdImage) -> RgbdImage:
        return replace(image, timestamp_s=image.timestamp_s + 0.01)


class Pythonic(Broken):
    def load(self, index: int) -> RgbdImage:
        return self._inner.load(range(len(self))[index])  # −1 is the last


class FrameErrorOutside(Broken):
    def load(self, index: int) -> RgbdImage:
        try:
            return self._inner.load(index)
        except IndexError as error:
            raise FrameError("absent") from error


class Hopeless(Broken):
    def load(self, index: int) -> RgbdImage:
        self._inner.load(index)
        raise FrameError("bad")


class Unnumbered(Broken):
    def spoil(self, image: RgbdImage) -> RgbdImage:
        return replace(image, index=0)


class Silent(Broken):
    camera_source = ""


class OtherNumbers(Broken):
    @property
    def numbers(self) -> np.ndarray:
        return self._inner.numbers + 1

    original_length = 7


class TooManyNumbers(Broken):
    @property
    def numbers(self) -> np.ndarray:
        return np.arange(len(self) + 1)


class BackwardNumbers(Broken):
    @property
    def numbers(self) -> np.ndarray:
        return self._inner.numbers[::-1]


class Shorter(Broken):
    original_length = 3


class Undecided(Broken):
    is_reversed = None


class AtCameraAlone(Broken):
    groundtruth = None

    @property
    def groundtruth_at_camera(self) -> object:
        return self._inner.groundtruth


@pytest.mark.parametrize(
    ("broken", "said"),
    [
        (BlueFirst, "is it BGR"),
        (Backwards, "iterating gives image"),
        (Millimetres, "is the depth factor right"),
        (DoubleDepth, "depth_m is float64"),
        (NanDepth, "NaN"),
        (Strided, "not contiguous"),
        (Scaled, "the camera"),
        (Unstable, "differs when it is loaded again"),
        (Shared, "when it is loaded again"),
        (OneTime, "must strictly increase"),
        (FloatTimes, "not float64"),
        (OtherTimes, "another time"),
        (Pythonic, "must raise IndexError"),
        (FrameErrorOutside, "an absent image is an IndexError"),
        (Hopeless, "no sampled frame can be loaded"),
        (Unnumbered, "is numbered 0"),
        (Silent, "camera_source is empty"),
        (OtherNumbers, "is numbered 0, but numbers says 1"),
        (TooManyNumbers, "numbers has shape"),
        (BackwardNumbers, "numbers must strictly increase"),
        (Shorter, "original_length is 3"),
        (Undecided, "is_reversed is a NoneType"),
        (AtCameraAlone, "without groundtruth"),
    ],
)
def test_the_contract_notices(broken: type[Broken], said: str, tmp_path: Path) -> None:
    dataset, known = tum_folder(tmp_path)
    with pytest.raises(AssertionError, match=said):
        check_dataset(broken(dataset), *known)
