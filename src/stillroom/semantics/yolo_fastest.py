"""YOLO-Fastest 1.1 and 1.1-xl: boxes of what may move (OC-SLAM 2.1)."""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from stillroom.data.image import RgbdImage
from stillroom.data.locations import cache_folder, models_folder, models_home
from stillroom.data.semantics import Box
from stillroom.errors import ConfigError, WeightsError
from stillroom.geometry.arrays import F32, F64, I64, U8
from stillroom.protocols import Segmenter
from stillroom.semantics.boxes import suppress
from stillroom.semantics.carried_boxes import CarriedBoxes, CarryConfig
from stillroom.semantics.darknet.cfg import read_bytes, read_cfg
from stillroom.semantics.darknet.network import Network
from stillroom.semantics.darknet.onnx_graph import onnx_model
from stillroom.semantics.detector import EachFrameAlone

VARIANTS = ("1.1", "1.1-xl")
FOLDER = "yolo_fastest"
NAMES_FILE = "coco.names"
LARGEST_EXPONENT = 20.0  # of a box whose numbers make no sense


@dataclass(frozen=True)
class YoloFastestConfig:
    """What YOLO-Fastest looks for.

    Attributes:
        variant: "1.1", or the larger "1.1-xl".
        confidence: Objectness × class probability from which a box counts (OC-SLAM 2.1: 80 of 100).
        nms_iou: Highest overlap that two boxes of one class may have; of more, the best is kept.
        movable: Names of the classes that may move; the others are not reported.
        folder: Where the cfg, weights and names lie; "" is the models' usual places.
        carry: How boxes are carried on over the frames in which they are missed.
    """

    variant: str = "1.1"
    confidence: float = 0.80
    nms_iou: float = 0.45
    movable: tuple[str, ...] = ("person",)
    folder: str = ""
    carry: CarryConfig = field(default_factory=CarryConfig)

    def build(self) -> Segmenter:
        """Return the detector.

        Raises:
            ConfigError: A value is impossible, or a class is not among the network's.
            WeightsError: The network's files are absent, damaged or not supported.
        """
        if not self.carry.enabled:
            return EachFrameAlone(self.build_detector(self.confidence))
        detector = self.build_detector(self.carry.lowest(self.confidence))
        return CarriedBoxes(detector, self.confidence, self.carry)

    def build_detector(self, confidence: float) -> "YoloFastest":
        """Return the bare detector, which reports boxes from a confidence on."""
        if self.variant not in VARIANTS:
            raise ConfigError(f"variant is '{self.variant}'; it must be one of {', '.join(VARIANTS)}")
        for key in ("confidence", "nms_iou"):
            if not 0.0 < getattr(self, key) <= 1.0:
                raise ConfigError(f"{key} is {getattr(self, key)}; it must be above 0 and at most 1")
        folder = find_folder(self.folder)
        return YoloFastest(folder, self.variant, self.movable, confidence, self.nms_iou)


def find_folder(named: str = "") -> Path:
    """Return the folder with the networks' files.

    Raises:
        WeightsError: There is none; the message says where it was looked for.
    """
    folder = Path(named) if named else models_folder(FOLDER)
    if folder is not None and folder.is_dir():
        return folder
    usual = dict.fromkeys((models_home(), cache_folder() / "models", Path("../shared/models")))
    places = named or ", ".join(str(place / FOLDER) for place in usual)
    raise WeightsError(
        f"YOLO-Fastest's weights are not in {places}; fetch them with 'stillroom download models', "
        f"or set STILLROOM_MODELS to the folder that holds {FOLDER}"
    )


class YoloFastest:
    """The network with its reading of the image and of the answer; keeps no state over time."""

    def __init__(self, folder: Path, variant: str, movable: Sequence[str], confidence: float, nms_iou: float) -> None:
        """Load the network from `yolo-fastest-<variant>.cfg`, `.weights` and `coco.names` of a folder."""
        cfg, weights = (folder / f"yolo-fastest-{variant}{suffix}" for suffix in (".cfg", ".weights"))
        self._network = read_cfg(cfg)
        names = _read_names(folder / NAMES_FILE, self._network)
        self._labels = tuple(movable)
        self._confidence = confidence
        self._nms_iou = nms_iou
        self._session = _session(onnx_model(cfg, weights, _class_indices(movable, names, folder / NAMES_FILE)))
        self._cells = _cells_of(self._network)
        self._input = np.empty((1, *self._network.input_shape), dtype=np.float32)

    def detect(self, image: RgbdImage) -> tuple[Box, ...]:
        """Return the boxes of movable classes, the most confident first."""
        heads = self._session.run(None, {"image": self._blob(image.rgb)})
        unit, scores, labels = self._decode(heads)
        kept = suppress(unit, scores, labels, self._nms_iou)
        edges = _to_pixels(unit[kept], image.width, image.height)
        return tuple(
            Box(x0, y0, x1, y1, self._labels[labels[k]], float(scores[k]))
            for (x0, y0, x1, y1), k in zip(edges.tolist(), kept, strict=True)
        )

    def _blob(self, rgb: U8) -> F32:
        """Stretch the image to the network's size: (1, 3, H, W) in [0, 255]; good until the next call."""
        _, height, width = self._network.input_shape
        small = cv2.resize(rgb, (width, height), interpolation=cv2.INTER_LINEAR)
        np.copyto(self._input[0], small.transpose(2, 0, 1))
        return self._input

    def _decode(self, heads: list[F32]) -> tuple[F64, F64, I64]:
        """Read the heads' answers: boxes (N, 4) in [0, 1], confidences (N,), indices of movable classes (N,)."""
        width = 5 + len(self._labels)
        rows = [
            raw.reshape(-1, width, raw.shape[2] * raw.shape[3]).transpose(0, 2, 1).reshape(-1, width) for raw in heads
        ]
        raw_rows = np.concatenate(rows)
        # Objectness bounds confidence from above, and few cells pass.
        limit = np.log(self._confidence / max(1.0 - self._confidence, 1e-12))
        likely = np.flatnonzero(raw_rows[:, 4] >= limit)
        values = raw_rows[likely].astype(np.float64)
        confidence = _sigmoid(values[:, 4:5]) * _sigmoid(values[:, 5:])
        which, label = np.nonzero(confidence >= self._confidence)
        values, cells = values[which], self._cells[likely[which]]
        center = cells[:, 0] + _sigmoid(values[:, :2]) * cells[:, 1]
        half = 0.5 * np.exp(np.minimum(values[:, 2:4], LARGEST_EXPONENT)) * cells[:, 2]
        return np.concatenate([center - half, center + half], axis=1), confidence[which, label], label


def _cells_of(network: Network) -> F64:
    """Return of each box that a network may tell its cell's corner and span and its anchor's size, (N, 3, 2) in [0, 1].

    Heads, anchors, rows, columns: the order in which `_decode` reads them.
    """
    tables = []
    _, height_px, width_px = network.input_shape
    for head, (_, rows, columns) in zip(network.heads, network.head_shapes, strict=True):
        table = np.zeros((len(head.anchors_px), rows, columns, 3, 2))
        row, column = np.indices((rows, columns))
        table[..., 0, :] = np.stack([column, row], axis=2) - 0.5 * (head.scale_xy - 1.0)
        table[..., 1, :] = head.scale_xy
        table[..., :2, :] /= (columns, rows)
        table[..., 2, :] = np.array(head.anchors_px)[:, None, None] / (width_px, height_px)
        tables.append(table.reshape(-1, 3, 2))
    return np.concatenate(tables)


def _sigmoid(x: F64) -> F64:
    return np.asarray(0.5 * (1.0 + np.tanh(0.5 * x)))


def _to_pixels(unit: F64, width: int, height: int) -> F64:
    """Move boxes (N, 4) from [0, 1] to pixels whose centres are at integers, cut to the image."""
    size = np.array([width, height, width, height], dtype=np.float64)
    return np.clip(unit * size - 0.5, 0.0, size - 1.0)


def _read_names(path: Path, network: Network) -> tuple[str, ...]:
    names = tuple(read_bytes(path).decode("utf-8", errors="replace").splitlines())
    classes = network.heads[0].classes
    if len(names) != classes:
        raise WeightsError(f"{path}: {len(names)} class names; the network has {classes}")
    return names


def _class_indices(movable: Sequence[str], labels: Sequence[str], path: Path) -> list[int]:
    for name in movable:
        if name not in labels:
            raise ConfigError(f"movable class '{name}' is not one of the network's; they are listed in {path}")
    return [labels.index(name) for name in movable]


@functools.lru_cache(maxsize=2)
def _session(model: bytes) -> Any:
    """Return an inference session on one thread: the same image gives the same numbers, and tracking its cores."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
    options.log_severity_level = 3
    return onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
