"""A picture to learn from, and where pictures lie."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from stillroom.errors import DatasetError
from stillroom.geometry.arrays import U8, Floats

PEOPLE, ROOM, DOMAIN = "people", "room", "domain"
"""What a picture is: of people, with true masks; of an empty room; of the domain that is learnt for, by the teacher."""

KINDS = (PEOPLE, ROOM, DOMAIN)
HELD_OUT_EVERY = 5
IMAGE_ENDINGS = {".jpg", ".jpeg", ".png"}


@dataclass(frozen=True, eq=False)
class Example:
    """A picture and what is known of its pixels.

    Attributes:
        name: For messages.
        kind: "people", "room" or "domain".
        rgb: Colours (H, W, 3) uint8.
        person: How certainly a pixel is a person's, 0–255 (H, W) uint8.
        soft: What the teacher says of the classes (h, w, 21) in [0, 1]; its pixels are parts of the picture.
        knows_all: Whether `person` is complete. In pictures where somebody walking by may have been left out, pixels
            far from the mask that the teacher takes for a person are not learnt from.
    """

    name: str
    kind: str
    rgb: U8
    person: U8
    soft: Floats
    knows_all: bool


def images_in(folder: Path) -> list[Path]:
    """Return the images of a folder in sorted order.

    Raises:
        DatasetError: There are none.
    """
    found = sorted(path for path in folder.glob("*") if path.suffix.lower() in IMAGE_ENDINGS)
    if not found:
        raise DatasetError(f"{folder}: no images here; name a folder of .jpg or .png files")
    return found


def split(images: Sequence[Path]) -> tuple[list[Path], list[Path]]:
    """Return what is learnt from, and what is held out: every fifth in sorted order, from the first on."""
    ordered = sorted(images)
    learnt = [path for place, path in enumerate(ordered) if place % HELD_OUT_EVERY]
    return learnt, ordered[::HELD_OUT_EVERY]


def read_rgb(path: Path) -> U8:
    """Return an image (H, W, 3) uint8.

    Raises:
        DatasetError: It cannot be read.
    """
    bgr = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if bgr is None:
        raise DatasetError(f"{path}: cannot be read as an image")
    return np.ascontiguousarray(bgr[..., ::-1], dtype=np.uint8)


def read_mask(image: Path) -> U8:
    """Return the mask that belongs to `images/<name>.jpg`: `masks/<name>.png`, 255 = person, (H, W) uint8.

    Raises:
        DatasetError: It cannot be read.
    """
    path = image.parent.parent / "masks" / f"{image.stem}.png"
    mask = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if mask is None:
        raise DatasetError(f"{path}: cannot be read as a mask; each image in images/ needs one of its name in masks/")
    return np.where(mask > 127, 255, 0).astype(np.uint8)
