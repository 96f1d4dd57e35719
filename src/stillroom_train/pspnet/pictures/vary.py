"""Data augmentation: translation, scale, rotation, brightness, blur, pasted people."""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from stillroom.geometry.arrays import F32, F64, U8
from stillroom_train.pspnet.pictures.example import Example
from stillroom_train.pspnet.recipe import Variation

LABEL_STRIDE = 4
"""Pixels of the crop per pixel of its labels, which lie at 0, 4, 8 …"""

SURE_PERSON = 0.6
"""Probability from which the teacher's label counts as a person missing in the mask."""
FAR_PX = 13
PERSON = 15


@dataclass(frozen=True, eq=False)
class View:
    """What the network gets of a picture, and what it should say.

    Attributes:
        rgb: Colours (H, W, 3) float32 in 0–255.
        classes: Probability of each class (h, w, classes) float32 at a fourth of the size.
        weight: 1 where it is known what the network should say, else 0 (h, w) float32.
    """

    rgb: F32
    classes: F32
    weight: F32


def varied(example: Example, crop: tuple[int, int], variation: Variation, lot: np.random.Generator) -> View:
    """Return a view of a picture.

    Args:
        example: The picture.
        crop: Rows and columns of the view.
        variation: Within which limits.
        lot: Decides.
    """
    to_picture = _placement(example.rgb.shape[:2], crop, variation, lot)
    shrinks = float(np.hypot(to_picture[0, 0], to_picture[1, 0]))
    rgb = _warped(_softened(example.rgb, shrinks), to_picture, crop)
    inside = _warped(np.full(example.person.shape, 255, np.uint8), to_picture, crop)
    person = _thinned(_warped(_softened(example.person, shrinks), to_picture, crop))
    classes = _warped_classes(example, to_picture, crop)
    weight = _thinned(inside) > 0.99
    if not example.knows_all:
        weight &= ~_left_out(person, classes[..., PERSON])
    return View(_looks(rgb, variation, lot), _together(person, classes), weight.astype(np.float32))


def with_stranger(room: Example, people: Example, lot: np.random.Generator) -> Example:
    """Return a room with the people of another picture put into it."""
    height, width = room.person.shape
    columns, rows = (np.flatnonzero(people.person.max(axis=axis)) for axis in (0, 1))
    if len(rows) == 0:
        return room
    tall = float(rows[-1] - rows[0] + 1)
    scale = float(np.exp(lot.uniform(np.log(0.4), np.log(1.6)))) * height / tall
    center = np.array([columns.mean(), rows.mean()])
    target = np.array([lot.uniform(0.05, 0.95) * width, lot.uniform(0.4, 0.95) * height])
    mirror = -1.0 if lot.random() < 0.5 else 1.0
    linear = np.diag([mirror * scale, scale])
    move = np.column_stack([linear, target - linear @ center])
    size = (width, height)
    alpha = cv2.warpAffine(cv2.GaussianBlur(people.person, (3, 3), 0), move, size, flags=cv2.INTER_LINEAR)
    paint = cv2.warpAffine(people.rgb, move, size, flags=cv2.INTER_LINEAR)
    share = alpha[..., None].astype(np.float32) / 255.0
    rgb = np.rint(share * paint + (1.0 - share) * room.rgb).astype(np.uint8)
    return replace(room, rgb=rgb, person=np.maximum(room.person, np.asarray(alpha, dtype=np.uint8)))


def _placement(size: tuple[int, int], crop: tuple[int, int], variation: Variation, lot: np.random.Generator) -> F64:
    """Return which point of the picture each point of the crop shows, as an affine map (2, 3)."""
    longer = np.exp(lot.uniform(np.log(variation.smallest), np.log(variation.largest))) * max(crop)
    scale = longer / max(size)
    angle = np.deg2rad(lot.uniform(-variation.rotation_deg, variation.rotation_deg))
    mirror = -1.0 if lot.random() < 0.5 else 1.0
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    linear = turn @ np.diag([mirror, 1.0]) / scale
    free = np.array([size[1] - crop[1] / scale, size[0] - crop[0] / scale])
    # Where the picture is the larger one, the crop lies anywhere in it; else the picture anywhere in the crop.
    center = np.array([size[1], size[0]]) / 2 + lot.uniform(-0.5, 0.5, 2) * free
    return np.column_stack([linear, center - linear @ np.array([crop[1], crop[0]]) / 2])


def _softened(image: U8, shrinks: float) -> U8:
    """Return an image, low-pass filtered for subsampling by a factor."""
    return image if shrinks < 1.3 else np.asarray(cv2.GaussianBlur(image, (0, 0), 0.4 * shrinks), dtype=np.uint8)


def _warped(image: U8, to_picture: F64, crop: tuple[int, int]) -> U8:
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    gray = (127, 127, 127) if image.ndim == 3 else 0
    return np.asarray(
        cv2.warpAffine(image, to_picture, (crop[1], crop[0]), flags=flags, borderValue=gray), dtype=np.uint8
    )


def _thinned(mask: U8) -> F32:
    """Return a mask in [0, 1] at the pixels of the labels, each the mean of what is around it."""
    soft = cv2.blur(mask, (LABEL_STRIDE + 1, LABEL_STRIDE + 1), borderType=cv2.BORDER_REPLICATE)
    return soft[::LABEL_STRIDE, ::LABEL_STRIDE].astype(np.float32) / np.float32(255.0)


def _warped_classes(example: Example, to_picture: F64, crop: tuple[int, int]) -> F32:
    """Return what the teacher says at the pixels of the labels (h, w, classes)."""
    height, width = example.person.shape
    soft = example.soft.astype(np.float32)
    shrink = np.array([soft.shape[1] / width, soft.shape[0] / height])
    linear = shrink[:, None] * to_picture[:, :2] * LABEL_STRIDE
    offset = shrink * (to_picture[:, 2] + 0.5) - 0.5
    to_soft = np.column_stack([linear, offset])
    size = ((crop[1] - 1) // LABEL_STRIDE + 1, (crop[0] - 1) // LABEL_STRIDE + 1)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    parts = [
        cv2.warpAffine(
            np.ascontiguousarray(soft[..., c : c + 3]), to_soft, size, flags=flags, borderMode=cv2.BORDER_REPLICATE
        )
        for c in range(0, soft.shape[2], 3)
    ]
    return np.concatenate([part.reshape(size[1], size[0], -1) for part in parts], axis=-1)


def _left_out(person: F32, said: F32) -> "np.ndarray[tuple[int, int], np.dtype[np.bool_]]":
    """Return where the teacher finds a person far from all people of the mask."""
    near = cv2.dilate(person, np.ones((FAR_PX, FAR_PX), np.uint8)) > 0.1
    return np.asarray((said > SURE_PERSON) & ~near)


def _together(person: F32, classes: F32) -> F32:
    """Return the teacher's classes with the person's true share."""
    others = classes.copy()
    others[..., PERSON] = 0.0
    total = others.sum(axis=-1, keepdims=True)
    # Where the teacher was sure of a person that is none, nothing else is known: background.
    others[..., 0] += np.maximum(0.05 - total[..., 0], 0.0)
    others *= (1.0 - person[..., None]) / others.sum(axis=-1, keepdims=True)
    others[..., PERSON] = person
    return others


def _looks(rgb: U8, variation: Variation, lot: np.random.Generator) -> F32:
    """Return colours (H, W, 3) float32 in 0–255 as another camera in other light would give them."""
    image = rgb
    if lot.random() < variation.blurs:
        image = _blurred(image, lot)
    seen = image.astype(np.float32)
    if variation.colors:
        seen = _recolored(seen, lot)
    if lot.random() < variation.noisy:
        seen = seen + lot.normal(0.0, lot.uniform(2.0, 12.0), seen.shape).astype(np.float32)
    return np.clip(seen, 0.0, 255.0)


def _blurred(image: U8, lot: np.random.Generator) -> U8:
    if lot.random() < 0.5:
        return np.asarray(cv2.GaussianBlur(image, (0, 0), lot.uniform(0.6, 2.0)), dtype=np.uint8)
    length = int(lot.integers(3, 12))
    trace = np.zeros((length, length), np.float32)
    angle, half = lot.uniform(0.0, np.pi), (length - 1) / 2
    for along in np.linspace(-half, half, 2 * length):
        trace[round(half + along * np.sin(angle)), round(half + along * np.cos(angle))] = 1.0
    return np.asarray(cv2.filter2D(image, -1, trace / trace.sum()), dtype=np.uint8)


def _recolored(image: F32, lot: np.random.Generator) -> F32:
    if lot.random() < 0.5:
        image = 255.0 * (image / 255.0) ** np.float32(np.exp(lot.uniform(-0.4, 0.4)))
    gains = np.exp(lot.normal(0.0, 0.08, 3)) * np.exp(lot.uniform(-0.25, 0.25))
    gray = image.mean(axis=-1, keepdims=True)
    saturation = 0.0 if lot.random() < 0.05 else float(lot.uniform(0.6, 1.4))
    mean = gray.mean()
    contrast = float(np.exp(lot.uniform(-0.25, 0.25)))
    colored = gray + saturation * (image - gray)
    return np.asarray(((colored - mean) * contrast + mean) * gains, dtype=np.float32)
