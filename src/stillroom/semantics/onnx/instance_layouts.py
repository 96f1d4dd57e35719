"""Output layouts of instance segmentation networks: which output is what, and what it says.

============== ============================================= ========================================================
name           outputs                                       networks
============== ============================================= ========================================================
`detections`   boxes (N, 4): x0 y0 x1 y1, scores (N,), or    torchvision's Mask R-CNN, mmdeploy's RTMDet-Ins and Mask
               both as one (N, 5); labels (N,), whole        R-CNN, the ONNX zoo's Mask R-CNN, D-FINE-seg
               numbers; masks (N, h, w)
`detr`         boxes (Q, 4): x y w h as shares of the        RF-DETR-Seg
               sides; labels (Q, C), a score of each class;
               masks (Q, h, w)
`yolo-seg`     (1, 4 + C + K, N): x y w h, class scores,     YOLO v8 and v11 as Ultralytics exports them
               coefficients; prototypes (1, K, h, w)
============== ============================================= ========================================================

Each may have an axis of length 1 more: in front, and masks also as (N, 1, h, w). x y are a box's middle, in pixels of
the input where nothing else is said. Outputs are told apart by their names (`NAMES`), and by their form where they have
others (docs/reference.md#instance-segmenters).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from stillroom.errors import WeightsError
from stillroom.geometry.arrays import F32, F64, I64
from stillroom.semantics.onnx.layouts import EDGES, Shape

AUTO, DETECTIONS, DETR, YOLO_SEG = "auto", "detections", "detr", "yolo-seg"
INSTANCE_LAYOUTS = (AUTO, DETECTIONS, DETR, YOLO_SEG)
BOXES, LABELS, SCORES, MASKS, ROWS, PROTOTYPES = "boxes", "labels", "scores", "masks", "rows", "prototypes"
NAMES: Mapping[str, tuple[str, ...]] = {
    BOXES: ("dets", "boxes", "pred_boxes", "bboxes"),
    LABELS: ("labels", "logits", "pred_logits", "classes"),
    SCORES: ("scores",),
    MASKS: ("masks", "pred_masks"),
}
"""Names of outputs, by what they are."""

INTEGERS = ("tensor(int64)", "tensor(int32)")
LEAST_SHARE = 1 / 8
"""Masks with fewer rows than this share of the input's are those of boxes: (28, 28) in an input of 640."""


@dataclass(frozen=True)
class Output:
    """An output as a file or an array tells it.

    Attributes:
        name: Its name.
        shape: Its shape; what is no number is an axis of open length.
        is_whole: Whether its values are whole numbers.
    """

    name: str
    shape: Shape
    is_whole: bool

    def ends_in(self, *lengths: int) -> bool:
        """Return whether its last axis may have one of these lengths."""
        return len(self.shape) > 0 and (not isinstance(self.shape[-1], int) or self.shape[-1] in lengths)


@dataclass(frozen=True)
class Candidates:
    """What a network finds, before classes and scores are looked at.

    Attributes:
        edges: Edges x_min y_min x_max y_max (N, 4) of boxes [px of the input].
        scores: In [0, 1]: of each class (N, C), or of the class `numbers` (N,).
        numbers: Class of each (N,); None where scores are those of each class.
        masks: Scores of their pixels (N, h, w), which cover the input, or their boxes; or a function of the chosen
            ones (M,) that returns these.
        are_logits: Whether a pixel is theirs from 0 on; else from 0.5 on.
        in_boxes: Whether masks cover their boxes; else the input.
        cut: Whether masks are cut to their boxes.
        joined: Whether boxes and scores are one output.
    """

    edges: F64
    scores: F64
    numbers: I64 | None
    masks: Any
    are_logits: bool
    in_boxes: bool
    cut: bool = False
    joined: bool = False

    def masks_of(self, chosen: I64) -> F32:
        """Return the masks (M, h, w) of chosen candidates (M,)."""
        values = self.masks(chosen) if callable(self.masks) else self.masks[chosen]
        return np.asarray(values, dtype=np.float32)


def roles_of(outputs: Sequence[Output], layout: str, name: object) -> tuple[str, dict[str, int]]:
    """Return the layout of a network, and the place of each output by what it is.

    Args:
        outputs: All of them.
        layout: That which is set; "auto" is told by what there is.
        name: What to call the network in messages.

    Raises:
        WeightsError: An output is missing.
    """
    if layout == YOLO_SEG or (layout == AUTO and len(outputs) == 2 and _named(outputs) == {}):
        found = _yolo_roles(outputs)
        layout = YOLO_SEG
    else:
        found = _roles(outputs)
        if LABELS not in found and SCORES in found and len(outputs[found[SCORES]].shape) == 3:
            found[LABELS] = found.pop(SCORES)
        if layout == AUTO:
            wide = LABELS in found and not outputs[found[LABELS]].is_whole and len(outputs[found[LABELS]].shape) == 3
            layout = DETR if wide else DETECTIONS
    needed = (ROWS, PROTOTYPES) if layout == YOLO_SEG else (BOXES, LABELS, MASKS)
    missing = [role for role in needed if role not in found]
    has_scores = (
        layout != DETECTIONS or SCORES in found or (BOXES in found and outputs[found[BOXES]].ends_in(EDGES + 1))
    )
    if not missing and not has_scores:
        missing = [SCORES]
    if missing:
        told = ", ".join(f"{output.name} {tuple(output.shape)}" for output in outputs)
        raise WeightsError(
            f"{name}: no output tells {' or '.join(missing)} ({told}), which layout '{layout}' needs; "
            "set semantics.layout to another one, or use another network"
        )
    return layout, found


def _named(outputs: Sequence[Output]) -> dict[str, int]:
    found: dict[str, int] = {}
    for role, names in NAMES.items():
        for place, output in enumerate(outputs):
            if output.name.lower() in names and role not in found:
                found[role] = place
    return found


def _roles(outputs: Sequence[Output]) -> dict[str, int]:
    """Return the outputs with a name that says what they are, and of the others those with its form."""
    found = _named(outputs)
    for place, output in enumerate(outputs):
        if place in found.values():
            continue
        rank = len(output.shape)
        forms = {
            MASKS: rank == 4 and not output.is_whole,
            BOXES: rank in (2, 3) and not output.is_whole and output.ends_in(EDGES, EDGES + 1),
            LABELS: (rank in (1, 2) and output.is_whole) or (rank == 3 and not output.is_whole),
            SCORES: rank in (1, 2) and not output.is_whole,
        }
        role = next((role for role, fits in forms.items() if fits and role not in found), None)
        if role is not None:
            found[role] = place
    return found


def _yolo_roles(outputs: Sequence[Output]) -> dict[str, int]:
    found: dict[str, int] = {}
    for place, output in enumerate(outputs):
        role = {3: ROWS, 4: PROTOTYPES}.get(len(output.shape))
        if role is not None:
            found.setdefault(role, place)
    return found


# What the outputs say


@dataclass(frozen=True)
class ReadingConfig:
    """How numbers are to be taken.

    Attributes:
        name: What to call the network in messages.
        input_px: Width and height of the input.
        in_shares: Whether edges are shares of the input's sides; those of `detr` always are.
        softmax: Whether the classes of a candidate exclude each other; else each has a probability of its own.
        in_boxes: Whether masks cover their boxes; None is told by their size.
    """

    name: object
    input_px: tuple[int, int]
    in_shares: bool = False
    softmax: bool = False
    in_boxes: bool | None = None


def read_candidates(layout: str, arrays: Mapping[str, Any], reading: ReadingConfig) -> Candidates:
    """Return what a network's outputs say.

    Args:
        layout: Their layout.
        arrays: The outputs by what they are.
        reading: How to take them.

    Raises:
        WeightsError: They contradict each other.
    """
    if layout == YOLO_SEG:
        return _of_yolo(arrays[ROWS], arrays[PROTOTYPES], reading)
    masks = np.asarray(arrays[MASKS])
    masks = masks.reshape(int(np.prod(masks.shape[:-2])), *masks.shape[-2:])
    boxes = np.asarray(arrays[BOXES], dtype=np.float64)
    boxes = boxes.reshape(int(np.prod(boxes.shape[:-1])), boxes.shape[-1])
    labels, numbers = np.asarray(arrays[LABELS]), None
    if layout == DETR:
        labels = labels.reshape(int(np.prod(labels.shape[:-1])), labels.shape[-1])
        scores = _probabilities(labels.astype(np.float64), reading.softmax)
        edges = _around(boxes[:, :EDGES]) * np.tile(np.array(reading.input_px, dtype=np.float64), 2)
    else:
        numbers = np.rint(labels.ravel()).astype(np.int64)
        scores = boxes[:, EDGES] if boxes.shape[1] > EDGES else np.asarray(arrays[SCORES], dtype=np.float64).ravel()
        edges = boxes[:, :EDGES] * (np.tile(np.array(reading.input_px), 2) if reading.in_shares else 1.0)
    n_labels = len(labels) if numbers is None else len(numbers)
    if not len(edges) == len(scores) == n_labels == len(masks):
        raise WeightsError(
            f"{reading.name}: returns {len(edges)} boxes, {n_labels} labels, {len(scores)} scores and {len(masks)} "
            f"masks; layout '{layout}' has one of each"
        )
    in_boxes = masks.shape[1] < LEAST_SHARE * reading.input_px[1] if reading.in_boxes is None else reading.in_boxes
    are_logits = _are_logits(masks)
    if in_boxes and are_logits:  # around a box there is nothing, which has a probability
        masks, are_logits = _sigmoid(masks.astype(np.float32)), False
    return Candidates(edges, scores, numbers, masks, are_logits, in_boxes, joined=boxes.shape[1] > EDGES)


def _of_yolo(rows: Any, prototypes: Any, reading: ReadingConfig) -> Candidates:
    """Return candidates of (1, 4 + C + K, N) and (1, K, h, w): a mask is a sum of prototypes (Bolya et al., 2019)."""
    columns, basis = np.asarray(rows)[0], np.asarray(prototypes)[0].astype(np.float32)
    n_classes = len(columns) - EDGES - len(basis)
    if n_classes < 1:
        raise WeightsError(
            f"{reading.name}: returns {len(columns)} numbers for each box and {len(basis)} prototypes, which leaves "
            "no class; layout 'yolo-seg' has (1, 4 + classes + prototypes, boxes) and (1, prototypes, h, w)"
        )
    coefficients = columns[EDGES + n_classes :].T.astype(np.float32)

    def masks_of(chosen: I64) -> F32:
        return np.asarray(np.tensordot(coefficients[chosen], basis, axes=1), dtype=np.float32)

    scores = columns[EDGES : EDGES + n_classes].T.astype(np.float64)
    edges = _around(columns[:EDGES].T.astype(np.float64))
    if reading.in_shares:
        edges = edges * np.tile(np.array(reading.input_px, dtype=np.float64), 2)
    return Candidates(edges, scores, None, masks_of, are_logits=True, in_boxes=False, cut=True)


def _around(middle_and_size: F64) -> F64:
    """Return the edges (N, 4) of boxes given by centre and size (N, 4)."""
    middle, half = middle_and_size[:, :2], 0.5 * middle_and_size[:, 2:]
    return np.concatenate([middle - half, middle + half], axis=1)


def _are_logits(values: Any) -> bool:
    """Return whether numbers are no probabilities: one is negative, or above 1."""
    if values.dtype == np.bool_ or values.size == 0:
        return False
    return bool(values.min() < 0 or values.max() > 1)


def _probabilities(values: F64, softmax: bool) -> F64:
    if not _are_logits(values):
        return values
    if not softmax:
        return np.asarray(_sigmoid(values), dtype=np.float64)
    exponent = np.exp(values - values.max(axis=1, keepdims=True))
    return np.asarray(exponent / exponent.sum(axis=1, keepdims=True), dtype=np.float64)


def _sigmoid(values: Any) -> Any:
    return 0.5 * (1.0 + np.tanh(0.5 * values))
