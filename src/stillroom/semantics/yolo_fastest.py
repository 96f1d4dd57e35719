"""YOLO-Fastest 1.1 and 1.1-xl: boxes of what may move (OC-SLAM 2.1)."""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from stillroom.data.locations import model_folders, model_path
from stillroom.errors import ConfigError, WeightsError
from stillroom.protocols import Parts, Segmenter
from stillroom.semantics.carried_boxes import CarriedBoxes, CarryConfig
from stillroom.semantics.darknet.cfg import read_bytes, read_cfg
from stillroom.semantics.darknet.heads import DarknetHeads
from stillroom.semantics.darknet.network import Network
from stillroom.semantics.darknet.onnx_graph import onnx_model
from stillroom.semantics.detector import EachFrameAlone
from stillroom.semantics.onnx.detector import DetectionNetwork, OnnxDetector, Reading
from stillroom.semantics.onnx.layouts import Asked
from stillroom.semantics.onnx.session import on_one_thread

VARIANTS = ("1.1", "1.1-xl")
FOLDER = "yolo_fastest"
NAMES_FILE = "coco.names"


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

    def build(self, parts: Parts | None = None) -> Segmenter:
        """Return the detector.

        Raises:
            ConfigError: A value is impossible, or a class is not among the network's.
            WeightsError: The network's files are absent, damaged or not supported.
        """
        if not self.carry.enabled:
            return EachFrameAlone(self.build_detector(self.confidence))
        detector = self.build_detector(self.carry.lowest(self.confidence))
        return CarriedBoxes(detector, self.confidence, self.carry)

    def build_detector(self, confidence: float) -> OnnxDetector:
        """Return the bare detector, which reports boxes from a confidence on."""
        if self.variant not in VARIANTS:
            raise ConfigError(f"variant is '{self.variant}'; it must be one of {', '.join(VARIANTS)}")
        for key in ("confidence", "nms_iou"):
            if not 0.0 < getattr(self, key) <= 1.0:
                raise ConfigError(f"{key} is {getattr(self, key)}; it must be above 0 and at most 1")
        folder = find_folder(self.folder)
        cfg, weights = (folder / f"yolo-fastest-{self.variant}{suffix}" for suffix in (".cfg", ".weights"))
        darknet = read_cfg(cfg)
        names = _read_names(folder / NAMES_FILE, darknet)
        chosen = _class_indices(self.movable, names, folder / NAMES_FILE)
        # The converter cuts the heads to the chosen classes; their input is RGB in 0–255, stretched.
        network = DetectionNetwork(_session(onnx_model(cfg, weights, chosen)), weights, Reading())
        heads = DarknetHeads(darknet, Asked(weights, len(chosen), range(len(chosen)), confidence))
        return OnnxDetector(network, heads, self.movable, self.nms_iou)


def find_folder(named: str = "") -> Path:
    """Return the folder with the networks' files.

    Raises:
        WeightsError: There is none; the message says where it was looked for.
    """
    folder = Path(named) if named else model_path(FOLDER)
    if folder is not None and folder.is_dir():
        return folder
    places = named or ", ".join(str(place / FOLDER) for place in model_folders())
    raise WeightsError(
        f"YOLO-Fastest's weights are not in {places}; fetch them with 'stillroom download models', "
        f"or set STILLROOM_MODELS to the folder that holds {FOLDER}"
    )


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
    """Return onnxruntime's session of a model, opened once for several runs after each other."""
    return on_one_thread(model)
