"""Gathering the examples: people with true masks, empty rooms, the own domain with the teacher's word."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from stillroom.errors import DatasetError
from stillroom.geometry.arrays import F32, U8
from stillroom.semantics.class_names import VOC_CLASSES
from stillroom.semantics.masks.mask_segments import MaskSegments
from stillroom.semantics.masks.refine import RefineConfig, refined
from stillroom_train.pspnet.pictures.example import DOMAIN, PEOPLE, ROOM, Example, images_in, read_mask, read_rgb, split
from stillroom_train.pspnet.pictures.teacher import Teacher

PERSON = VOC_CLASSES.index("person")
SURE = 0.92
"""How certain a pixel is taken to be that depth moved to the other side of a person's border."""
DEPTH_PER_M = 5000.0

Report = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Sources:
    """Where pictures lie.

    Attributes:
        people: Folder with `images/` and `masks/` (255 = person); every fifth image is held out.
        rooms: RGB-D sequences without people (folders with `rgb/`), of which all frames are learnt from as such.
        domain: RGB-D sequence of the own domain, with people, where the teacher's word is taken; None for none.
        domain_frames: First and last frame of it.
        every: Of sequences every n-th frame is taken.
    """

    people: Path
    rooms: tuple[Path, ...] = ()
    domain: Path | None = None
    domain_frames: tuple[int, int] = (280, 560)
    every: int = 3


def gather(sources: Sources, teacher: Teacher, report: Report) -> list[Example]:
    """Return all examples.

    Args:
        sources: Where they lie.
        teacher: Says what else is in them.
        report: Told of a kind, how many are done and how many there are.

    Raises:
        DatasetError: A folder has no images, or one cannot be read.
    """
    learnt, _ = split(images_in(sources.people / "images"))
    found = list(_told(PEOPLE, learnt, lambda path: _people(path, teacher), report))
    for folder in sources.rooms:
        frames = images_in(folder / "rgb")[:: sources.every]
        found += _told(ROOM, frames, lambda path: _room(path, teacher), report)
    if sources.domain is not None:
        first, last = sources.domain_frames
        every_frame = images_in(sources.domain / "rgb")[first : last + 1 : sources.every]
        depth_of = _Depth(sources.domain)
        found += _told(DOMAIN, every_frame, lambda path: _domain(path, teacher, depth_of), report)
    return found


def held_out(people: Path) -> Iterator[tuple[U8, U8]]:
    """Yield the pictures that are held out, and their masks (255 = person)."""
    for path in split(images_in(people / "images"))[1]:
        yield read_rgb(path), read_mask(path)


def _told(kind: str, paths: list[Path], make: Callable[[Path], Example], report: Report) -> Iterator[Example]:
    for number, path in enumerate(paths, start=1):
        yield make(path)
        report(kind, number, len(paths))


def _people(path: Path, teacher: Teacher) -> Example:
    rgb = read_rgb(path)
    mask = read_mask(path)
    if mask.shape != rgb.shape[:2]:
        raise DatasetError(f"{path}: is of another size than its mask")
    return Example(path.stem, PEOPLE, rgb, mask, teacher(rgb), knows_all=False)


def _room(path: Path, teacher: Teacher) -> Example:
    rgb = read_rgb(path)
    return Example(path.stem, ROOM, rgb, np.zeros(rgb.shape[:2], np.uint8), teacher(rgb), knows_all=True)


def _domain(path: Path, teacher: Teacher, depth_of: "_Depth") -> Example:
    rgb = read_rgb(path)
    soft = teacher(rgb)
    rows, columns = rgb.shape[0] // 2, rgb.shape[1] // 2
    likely = cv2.resize(soft[..., PERSON].astype(np.float32), (columns, rows), interpolation=cv2.INTER_LINEAR)
    mended = _mended(np.asarray(likely, dtype=np.float32), depth_of(path, rows, columns))
    full = cv2.resize(mended, (rgb.shape[1], rgb.shape[0]), interpolation=cv2.INTER_LINEAR)
    return Example(path.stem, DOMAIN, rgb, np.rint(255 * full).astype(np.uint8), soft, knows_all=True)


def _mended(likely: F32, depth_m: F32) -> F32:
    """Return how likely pixels are a person's, certain where depth says that the border is elsewhere."""
    before = MaskSegments((likely >= 0.5).astype(np.uint8), likely)
    after = refined(before, depth_m, RefineConfig())
    changed = after.mask != before.mask
    return np.where(changed, np.where(after.mask, SURE, 1.0 - SURE), likely).astype(np.float32)


class _Depth:
    """Depth images of a sequence, by the time in their names."""

    def __init__(self, sequence: Path) -> None:
        self._paths = images_in(sequence / "depth")
        self._times = np.array([_time(path) for path in self._paths])

    def __call__(self, image: Path, rows: int, columns: int) -> F32:
        nearest = self._paths[int(np.abs(self._times - _time(image)).argmin())]
        depth = cv2.imread(str(nearest), cv2.IMREAD_UNCHANGED)
        if depth is None:
            raise DatasetError(f"{nearest}: cannot be read as a depth image")
        small = cv2.resize(depth, (columns, rows), interpolation=cv2.INTER_NEAREST)
        return np.asarray(small, dtype=np.float32) / np.float32(DEPTH_PER_M)


def _time(path: Path) -> float:
    try:
        return float(path.stem)
    except ValueError:
        raise DatasetError(f"{path}: images of a sequence are named by their time in seconds") from None
