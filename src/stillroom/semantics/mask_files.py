"""The user's own masks, one image file a frame."""

import logging
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from stillroom.bounds import bounded, check
from stillroom.data.image import Image
from stillroom.data.semantics import Box, Instance, Semantics, nothing, union_of
from stillroom.errors import ConfigError, DatasetError
from stillroom.geometry.arrays import U8, Ints
from stillroom.geometry.pixels import Shape, grown
from stillroom.protocols import Parts, Segmenter

SUFFIXES = {".png", ".bmp", ".tif", ".tiff", ".pgm", ".webp"}  # without loss; JPEG blurs labels
TIME_TOLERANCE_S = 0.001
LABEL = "mask"

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class MaskFilesConfig:
    """Where masks are stored and how they are read.

    A file belongs to a frame by its name: that of the colour image, whatever it is; else `1548339819.87426.png` (a
    number with a point) by the colour image's timestamp in seconds, and `000012.png` or `mask_12.png` (no point) by the
    frame's index, counted from 0.

    Attributes:
        folder: The folder with the masks.
        movable_values: Pixel values of potentially dynamic pixels; empty is any but 0.
        dilate_px: Dilation of the masks [px].
        missing: Meaning of a frame without a readable mask: "nothing" in it is potentially dynamic (with one warning),
            or "error".
        boxes: Whether each connected region becomes a box, too.
        min_box_px: Smallest region that becomes a box [px²].
        instances: Whether the files separate objects: each value but 0, of 8 or 16 bits, or each colour but black
            (a palette's too), is one object, which becomes an instance, with a box of its own instead of its regions'.
            Values need not name the same object in the next frame.
    """

    folder: Path | None = None
    movable_values: tuple[int, ...] = ()
    dilate_px: int = bounded(0, least=0, pixels=1)
    missing: str = bounded("nothing", one_of=("nothing", "error"))
    boxes: bool = True
    min_box_px: int = bounded(100, least=0, pixels=2)
    instances: bool = False

    def build(self, parts: Parts | None = None) -> Segmenter:
        """Return the segmenter.

        Raises:
            ConfigError: No folder is named, or a value is impossible.
            DatasetError: The folder does not exist, or has no masks; two masks claim one frame.
        """
        if self.folder is None:
            raise ConfigError("semantics.folder is not set; name the folder that holds the masks")
        check(self)
        return MaskFiles(self.folder, self)


class MaskFiles:
    """Reads the mask of each frame from a folder."""

    def __init__(self, folder: Path, config: MaskFilesConfig) -> None:
        self._folder = folder
        self._config = config
        self._by_index, by_time, self._by_name = _list_masks(folder)
        self._times_s = np.array(sorted(by_time))
        self._by_time = [by_time[time] for time in self._times_s]
        self._warned = False

    def __call__(self, image: Image) -> Semantics:
        """Return the mask of the image.

        Raises:
            DatasetError: The mask has another size than the image, or is not what the config says; it is absent or
                unreadable, and `missing` is "error".
        """
        path = self._find(image)
        if path is None:
            return self._without(image, f"{self._folder}: no mask for frame {image.index} ({image.timestamp_s:.6f} s)")
        pixels: Any = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        if pixels is None:
            return self._without(image, f"{path}: cannot be read as an image")
        movable = self._movable(np.asarray(pixels), path)
        size = (image.height, image.width)
        if movable.shape != size:
            raise DatasetError(
                f"{path}: the mask is {movable.shape[1]}×{movable.shape[0]}, "
                f"the image {image.width}×{image.height}; they must be of one size"
            )
        if self._config.instances:
            instances = self._instances(np.where(movable, _numbers(np.asarray(pixels)), 0))
            known = Semantics(*size, mask=union_of(instances, *size), instances=instances)
        else:
            known = Semantics(*size, mask=grown(movable != 0, self._config.dilate_px, Shape.ELLIPSE))
        return replace(known, boxes=_boxes(known.objects, self._config.min_box_px)) if self._config.boxes else known

    def _instances(self, numbers: Ints) -> tuple[Instance, ...]:
        """Return the object of each number but 0 in an image of numbers (H, W), dilated."""
        found = []
        for number in np.unique(numbers[numbers > 0]).tolist():
            own = grown(np.asarray(numbers == number), self._config.dilate_px, Shape.ELLIPSE)
            found.append(Instance.of(own, LABEL))
        return tuple(found)

    def _find(self, image: Image) -> Path | None:
        if image.name in self._by_name:
            return self._by_name[image.name]
        if len(self._times_s):
            nearest = int(np.argmin(np.abs(self._times_s - image.timestamp_s)))
            if abs(self._times_s[nearest] - image.timestamp_s) <= TIME_TOLERANCE_S:
                return self._by_time[nearest]
        return self._by_index.get(image.index)

    def _without(self, image: Image, problem: str) -> Semantics:
        if self._config.missing == "error":
            raise DatasetError(f"{problem}; add it, or set missing to 'nothing'")
        if not self._warned:
            logger.warning(
                "%s: taken as 'nothing is potentially dynamic', here and wherever a mask is missing", problem
            )
            self._warned = True
        return nothing(image.height, image.width)

    def _movable(self, pixels: U8, path: Path) -> U8:
        """Return 1 where the mask (H, W) or (H, W, channels) marks something potentially dynamic."""
        colors = pixels[..., :3] if pixels.ndim == 3 else pixels[..., None]  # a fourth channel is opacity
        if not self._config.movable_values:
            return np.asarray(np.any(colors != 0, axis=2), dtype=np.uint8)
        if np.any(colors != colors[..., :1]):
            raise DatasetError(
                f"{path}: a colour image, where movable_values needs labels; save the labels as one channel"
            )
        return np.asarray(np.isin(colors[..., 0], self._config.movable_values), dtype=np.uint8)


def _list_masks(folder: Path) -> tuple[dict[int, Path], dict[float, Path], dict[str, Path]]:
    """Return the masks of a folder by index, by time [s], and by name without suffix."""
    if not folder.is_dir():
        raise DatasetError(f"{folder}: no such folder; mask_files.folder names the folder that holds the masks")
    by_index: dict[int, Path] = {}
    by_time: dict[float, Path] = {}
    by_name: dict[str, Path] = {}
    for path in sorted(folder.iterdir()):
        if path.suffix.lower() not in SUFFIXES:
            continue
        rivals = [by_name.setdefault(path.stem, path)]
        number = re.search(r"(\d+\.\d+|\d+)$", path.stem)
        if number is not None:
            text = number.group()
            numbered = by_time.setdefault(float(text), path) if "." in text else by_index.setdefault(int(text), path)
            rivals.append(numbered)
        for rival in rivals:
            if rival != path:
                raise DatasetError(f"{path}: claims the same frame as {rival.name}; remove one of them")
    if not by_name:
        raise DatasetError(
            f"{folder}: no masks in it; expected <name of the colour image>.png, <timestamp>.png or <index>.png "
            f"({', '.join(sorted(SUFFIXES))})"
        )
    return by_index, by_time, by_name


def _numbers(pixels: Ints) -> Ints:
    """Return one number a pixel (H, W) of an image (H, W) or (H, W, channels): its value, or its colour's."""
    if pixels.ndim == 2:
        return pixels
    blue, green, red = np.moveaxis(pixels[..., :3].astype(np.int64), 2, 0)  # a fourth channel is opacity
    return np.asarray(blue + (green << 16) + (red << 32))


def _boxes(objects: Sequence[Instance], smallest_px: int) -> tuple[Box, ...]:
    """Return the box around each object, the largest first."""
    largest_first = sorted(objects, key=lambda thing: -thing.area_px)
    return tuple(replace(thing.box, label=LABEL) for thing in largest_first if thing.area_px >= smallest_px)
