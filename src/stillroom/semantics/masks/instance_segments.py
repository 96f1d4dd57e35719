"""Instances as segments that can be propagated, and back: each object has a number in the half image."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from stillroom.data.semantics import Box, Instance, Semantics, union_of
from stillroom.geometry.arrays import F32, F64, U8, Bool
from stillroom.geometry.pixels import Shape, grown
from stillroom.semantics.masks.mask_segments import MaskSegments, Numbered
from stillroom.semantics.masks.regions import RegionsConfig
from stillroom.semantics.onnx.fit import Fit

MOST = 255
"""How many objects an image can have: numbers are of 8 bits."""


@dataclass(frozen=True, eq=False)
class NetworkMask:
    """The mask of an object as a network tells it.

    Attributes:
        values: Score of each pixel (h, w) float32.
        least: Score from which on a pixel is the object's.
        edges: The rectangle of the input that the mask covers, x_min y_min x_max y_max [px, from corner to corner].
        alone: Whether it lies in there alone: around the rectangle is nothing.
        cut: A rectangle of the input that it is cut to (4,); None for none.
    """

    values: F32
    least: float
    edges: F64
    alone: bool
    cut: F64 | None = None

    def in_half_image(self, fit: Fit, shape: tuple[int, int]) -> Bool:
        """Return its pixels in the half image.

        Args:
            fit: Where the image lies in the network's input.
            shape: Rows and columns (h, w) of the half image.
        """
        # A pixel of the half image has its middle between two of the image: at 2 c + 1 from the image's corner.
        gain = np.array(fit.content_px, dtype=np.float64) / np.array(fit.image_px)
        corner = np.array(fit.corner_px, dtype=np.float64)
        side = self.edges[2:] - self.edges[:2]
        pitch = np.array(self.values.shape[::-1]) / side
        factor, offset = 2.0 * gain * pitch, (gain + corner - self.edges[:2]) * pitch - 0.5
        affine = np.array([[factor[0], 0.0, offset[0]], [0.0, factor[1], offset[1]]])
        border = cv2.BORDER_CONSTANT if self.alone else cv2.BORDER_REPLICATE
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        values = np.ascontiguousarray(self.values)
        mask = np.asarray(cv2.warpAffine(values, affine, shape[::-1], flags=flags, borderMode=border) > self.least)
        if self.cut is not None:
            x, y = (gain[k] * (2.0 * np.arange(shape[1 - k]) + 1.0) + corner[k] for k in range(2))
            mask[(y < self.cut[1]) | (y > self.cut[3])] = False
            mask[:, (x < self.cut[0]) | (x > self.cut[2])] = False
        return mask


def painted(
    masks: Sequence[Bool], things: Sequence[Numbered], are_named: Sequence[bool], shape: tuple[int, int], named: bool
) -> MaskSegments:
    """Return objects as segments: of two that overlap, the surer one has the pixel.

    Args:
        masks: Pixels (h, w) of each.
        things: Class and score of each.
        are_named: Whether each is of a class that is static unless people move it.
        shape: Rows and columns of the half image.
        named: Whether there are such classes.
    """
    order = sorted(range(len(masks)), key=lambda k: -things[k].score)[:MOST]
    label, still = np.zeros(shape, dtype=np.uint8), np.zeros(shape, dtype=np.uint8)
    probability = np.zeros(shape, dtype=np.float32)
    for number, k in reversed(list(enumerate(order, start=1))):
        (still if are_named[k] else label)[masks[k]] = number
        probability[masks[k]] = things[k].score
    still[label > 0] = 0
    return MaskSegments(label, probability, still if named else None, tuple(things[k] for k in order))


def as_instances(segments: MaskSegments, height: int, width: int, age: int, config: RegionsConfig) -> Semantics:
    """Return numbered segments as instances of an image, and a mask of all of them; each is dilated.

    Args:
        segments: Objects by their numbers, at half size.
        height: Rows of the image.
        width: Its columns.
        age: Age of the network's result, in frames.
        config: Dilation and boxes.
    """
    found = _objects(segments.label, segments.things, height, width, config.min_px)
    dilated = _dilated(found, config.dilate_px)
    mask = union_of(dilated, height, width)
    if config.crowd_px < config.dilate_px and np.count_nonzero(mask) > config.crowd_share * mask.size:
        dilated = _dilated(found, config.crowd_px)
        mask = union_of(dilated, height, width)
    still = () if segments.named is None else _objects(segments.named, segments.things, height, width, config.min_px)
    boxes = _boxes(found, age) if config.boxes else ()
    return Semantics(height, width, boxes, mask, named=_boxes(still, age), instances=dilated)


def _objects(label: U8, things: Sequence[Numbered], height: int, width: int, min_px: int) -> tuple[Instance, ...]:
    """Return the objects in an image of numbers (h, w) that are large enough, the surest first."""
    counts = np.bincount(label.ravel(), minlength=len(things) + 1)
    found = []
    for number, thing in enumerate(things, start=1):
        if counts[number] > 0 and 4 * counts[number] >= min_px:
            half = (label == number).view(np.uint8)
            whole = cv2.resize(half, (width, height), interpolation=cv2.INTER_NEAREST)
            found.append(Instance.of(np.asarray(whole, dtype=np.uint8).view(np.bool_), thing.label, thing.score))
    return tuple(found)


def _dilated(instances: Sequence[Instance], reach_px: int) -> tuple[Instance, ...]:
    if reach_px == 0:
        return tuple(instances)
    return tuple(Instance.of(grown(one.mask, reach_px, Shape.ELLIPSE), one.label, one.score) for one in instances)


def _boxes(instances: Sequence[Instance], age: int) -> tuple[Box, ...]:
    """Return the box around each object, the largest first."""
    largest_first = sorted(instances, key=lambda one: -one.area_px)
    return tuple(replace(one.box, carried=age) for one in largest_first)
