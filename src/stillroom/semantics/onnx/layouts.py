"""Output layouts of detection networks.

============ ==================================================== =====================================================
name         outputs                                              networks
============ ==================================================== =====================================================
`yolo-v8`    (1, 4 + C, N): x y w h, class scores                 YOLO v8, v9, v11 as Ultralytics exports them
`yolo-v5`    (1, N, 5 + C): x y w h, objectness, class scores     YOLO v5, v7, YOLOX decoded
`nms`        (1, N, 6) or (N, 6): x0 y0 x1 y1, score, class       YOLO v10, and what is exported with `nms=True`
`detections` boxes (1, N, 4): x0 y0 x1 y1; labels and scores      torchvision's detectors, SSD
             (1, N), each also without the 1
`darknet`    for each head (1, A (5 + C), h, w), raw              YOLO-Fastest, YOLO v3 by `stillroom export yolo`
============ ==================================================== =====================================================

C is the number of classes, N of boxes, A of a head's anchors; x y are a box's middle. All scores are probabilities, but
for darknet's raw numbers.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from stillroom.errors import WeightsError
from stillroom.geometry.arrays import F64, I64, Ints

DARKNET, YOLO_V8, YOLO_V5, NMS, DETECTIONS = "darknet", "yolo-v8", "yolo-v5", "nms", "detections"
LAYOUTS = (YOLO_V8, YOLO_V5, NMS, DETECTIONS, DARKNET)
EDGES = 4

Shape = Sequence[Any]
"""Shape of an output: numbers, or anything else for an axis of open length; empty where the file has none."""


@dataclass(frozen=True)
class DetectionRequest:
    """The wanted classes and the format of a network's boxes.

    Attributes:
        name: What to call the network in messages, such as its path.
        n_classes: Number of its classes.
        classes: The numbers of the wanted classes (M).
        confidence: Confidence threshold of a box.
        side_px: Width and height of its input where boxes are in pixels of it; (1, 1) where in shares of it.
    """

    name: object
    n_classes: int
    classes: Sequence[int]
    confidence: float
    side_px: tuple[int, int] = (1, 1)


@dataclass(frozen=True)
class Told:
    """The decoded boxes of the wanted classes.

    Attributes:
        unit: Edges x_min y_min x_max y_max (N, 4), the input's sides being of length 1.
        scores: (N,) in [0, 1].
        labels: Which of the wanted classes (N,).
    """

    unit: F64
    scores: F64
    labels: I64


class Layout(Protocol):
    """Decodes a network's outputs."""

    @property
    def expected(self) -> str:
        """The outputs' shapes in words."""

    def fits(self, shapes: Sequence[Shape]) -> bool:
        """Return whether outputs may be of this layout."""

    def read(self, outputs: Sequence[Any]) -> Told:
        """Return the boxes from outputs of fitting shapes.

        Raises:
            WeightsError: The outputs are invalid.
        """


def layout_of(name: str, asked: DetectionRequest) -> Layout:
    """Return the layout of a name; `darknet` is made by the file that knows the heads, and is not among them."""
    known: dict[str, type[YoloV8 | YoloV5 | Suppressed | Detections]] = {
        YOLO_V8: YoloV8,
        YOLO_V5: YoloV5,
        NMS: Suppressed,
        DETECTIONS: Detections,
    }
    return known[name](asked)


def may_be(shape: Shape, *wanted: int | None) -> bool:
    """Return whether a shape may be the wanted one, in which None is any length."""
    if len(shape) == 0:
        return True
    pairs = zip(shape, wanted, strict=False)
    return len(shape) == len(wanted) and all(
        want is None or not isinstance(side, int) or side == want for side, want in pairs
    )


@dataclass(frozen=True)
class YoloV8:
    """(1, 4 + C, N): middle and size in pixels, then a probability for each class."""

    asked: DetectionRequest

    @property
    def expected(self) -> str:
        """The output's shape in words."""
        return f"(1, {EDGES + self.asked.n_classes}, boxes)"

    def fits(self, shapes: Sequence[Shape]) -> bool:
        """Return whether the first output is of this layout."""
        return len(shapes) >= 1 and may_be(shapes[0], 1, EDGES + self.asked.n_classes, None)

    def read(self, outputs: Sequence[Any]) -> Told:
        """Return the boxes; one that is likely of two classes is returned twice."""
        columns = np.asarray(outputs[0][0])
        scores = columns[[EDGES + number for number in self.asked.classes]].T.astype(np.float64)
        which, label = np.nonzero(scores >= self.asked.confidence)
        return Told(_around(columns[:EDGES, which].T, self.asked), scores[which, label], label)


@dataclass(frozen=True)
class YoloV5:
    """(1, N, 5 + C): middle and size in pixels, the probability of an object, and of each class given there is one."""

    asked: DetectionRequest

    @property
    def expected(self) -> str:
        """The output's shape in words."""
        return f"(1, boxes, {EDGES + 1 + self.asked.n_classes})"

    def fits(self, shapes: Sequence[Shape]) -> bool:
        """Return whether the first output is of this layout."""
        return len(shapes) >= 1 and may_be(shapes[0], 1, None, EDGES + 1 + self.asked.n_classes)

    def read(self, outputs: Sequence[Any]) -> Told:
        """Return the boxes; one that is likely of two classes is returned twice."""
        rows = np.asarray(outputs[0][0])
        # Objectness bounds confidence from above, and few boxes pass.
        rows = rows[rows[:, EDGES] >= self.asked.confidence].astype(np.float64)
        scores = rows[:, EDGES : EDGES + 1] * rows[:, [EDGES + 1 + number for number in self.asked.classes]]
        which, label = np.nonzero(scores >= self.asked.confidence)
        return Told(_around(rows[which, :EDGES], self.asked), scores[which, label], label)


@dataclass(frozen=True)
class Suppressed:
    """(1, N, 6) or (N, 6): edges in pixels, score, number of the class."""

    asked: DetectionRequest

    @property
    def expected(self) -> str:
        """The output's shape in words."""
        return f"(1, boxes, {EDGES + 2}) or (boxes, {EDGES + 2})"

    def fits(self, shapes: Sequence[Shape]) -> bool:
        """Return whether the first output is of this layout."""
        if not shapes:
            return False
        return may_be(shapes[0], 1, None, EDGES + 2) or may_be(shapes[0], None, EDGES + 2)

    def read(self, outputs: Sequence[Any]) -> Told:
        """Return the boxes.

        Raises:
            WeightsError: A class has no name.
        """
        rows = np.asarray(outputs[0]).reshape(-1, EDGES + 2).astype(np.float64)
        return _chosen(rows[:, :EDGES], rows[:, EDGES], rows[:, EDGES + 1], self.asked)


@dataclass(frozen=True)
class Detections:
    """Three outputs: edges (N, 4) in pixels, labels (N,), scores (N,); each may be (1, N, …).

    The edges come first. Of the two others the labels are the one of whole numbers, or else the first. Further outputs,
    such as masks, are not read.
    """

    asked: DetectionRequest

    @property
    def expected(self) -> str:
        """The outputs' shapes in words."""
        return "boxes (1, boxes, 4), labels (1, boxes) and scores (1, boxes), or the same without the 1"

    def fits(self, shapes: Sequence[Shape]) -> bool:
        """Return whether the first three outputs are of this layout."""
        if len(shapes) < 3:
            return False
        edges, *others = shapes[:3]
        batched = may_be(edges, 1, None, EDGES) and all(may_be(shape, 1, None) for shape in others)
        return batched or (may_be(edges, None, EDGES) and all(may_be(shape, None) for shape in others))

    def read(self, outputs: Sequence[Any]) -> Told:
        """Return the boxes.

        Raises:
            WeightsError: There are not as many labels and scores as boxes, or a class has no name.
        """
        edges, labels, scores = (np.asarray(output) for output in outputs[:3])
        if np.issubdtype(scores.dtype, np.integer) and not np.issubdtype(labels.dtype, np.integer):
            labels, scores = scores, labels
        edges = edges.reshape(-1, EDGES).astype(np.float64)
        if not len(edges) == labels.size == scores.size:
            raise WeightsError(
                f"{self.asked.name}: returns {len(edges)} boxes, {labels.size} labels and {scores.size} scores; "
                "layout 'detections' has one of each"
            )
        return _chosen(edges, scores.ravel().astype(np.float64), labels.ravel(), self.asked)


def _around(middle_and_size: Any, asked: DetectionRequest) -> F64:
    """Return the edges (N, 4) of boxes given by centre and size (N, 4)."""
    values = np.asarray(middle_and_size, dtype=np.float64) / np.tile(np.array(asked.side_px, dtype=np.float64), 2)
    middle, half = values[:, :2], 0.5 * values[:, 2:]
    return np.concatenate([middle - half, middle + half], axis=1)


def _chosen(edges: F64, scores: F64, labels: Ints | F64, asked: DetectionRequest) -> Told:
    """Return the boxes of the wanted classes, from edges (N, 4), scores (N,) and class numbers (N,)."""
    likely = np.flatnonzero(scores >= asked.confidence)
    number = np.rint(labels[likely]).astype(np.int64)
    unnamed = number[(number < 0) | (number >= asked.n_classes)]
    if len(unnamed):
        raise WeightsError(
            f"{asked.name}: returns class {unnamed[0]}, where {asked.n_classes} classes are named, counted from 0; "
            "set classes to its names, with one for the background where it counts that"
        )
    place = np.full(asked.n_classes, -1, dtype=np.int64)
    place[list(asked.classes)] = np.arange(len(asked.classes))
    label = place[number]
    kept = likely[label >= 0]
    unit = edges[kept] / np.tile(np.array(asked.side_px, dtype=np.float64), 2)
    return Told(unit, scores[kept], label[label >= 0])
