"""YOLO-Fastest 1.1 and 1.1-xl: boxes of what is potentially dynamic (OC-SLAM 2.1). The networks come with Stillroom."""

from dataclasses import dataclass, field
from importlib.resources import as_file, files
from pathlib import Path

from stillroom.bounds import bounded, check
from stillroom.errors import ConfigError
from stillroom.protocols import Parts, Segmenter
from stillroom.semantics.carried_boxes import CarriedBoxes, CarryConfig
from stillroom.semantics.detector import EachFrameAlone
from stillroom.semantics.keyframe_boxes import KeyframeBoxes
from stillroom.semantics.onnx.darknet import DarknetFile
from stillroom.semantics.onnx.layouts import DetectionRequest
from stillroom.semantics.onnx.onnx_detector import DetectionNetwork, DetectorInput, OnnxDetector
from stillroom.semantics.onnx.onnx_session import find_model, open_content
from stillroom.semantics.seen_images import IMAGES, KEYFRAMES, SEES

SHIPPED = {"1.1": "yolo_fastest_1.1_coco.onnx", "1.1-xl": "yolo_fastest_1.1_xl_coco.onnx"}
EVERY_CLASS = ("*",)


@dataclass(frozen=True)
class YoloFastestConfig:
    """The YOLO-Fastest detector.

    Attributes:
        variant: "1.1", or the larger "1.1-xl".
        confidence: Objectness × class probability from which a box counts (OC-SLAM 2.1: 80 of 100).
        nms_iou: Highest overlap that two boxes of one class may have; of more, the best is kept.
        movable: Names of the potentially dynamic classes, or "*" for all; the others are not reported.
        model: Another network, a file of `stillroom export yolo`; a bare name is looked up in the model folders.
            Empty is the variant that comes with Stillroom.
        longer_side: Longer side of the network's input, as a share of that in its file; the other follows from the
            proportions of the camera's images, and both are rounded to the cells of its coarsest head. 0: the input is
            as the file has it, 320 × 320 in those that come with Stillroom, and images are stretched to it.
        carry: How boxes are propagated over the frames in which they are missed.
        sees: Which images the network sees: all "images", or "keyframes" only, whose boxes are not propagated
            (docs/reference.md#detect-slam).
    """

    variant: str = bounded("1.1", one_of=tuple(SHIPPED))
    confidence: float = bounded(0.80, above=0, most=1)
    nms_iou: float = bounded(0.45, above=0, most=1)
    movable: tuple[str, ...] = ("person",)
    model: Path | None = None
    longer_side: float = bounded(0.0, least=0)
    carry: CarryConfig = field(default_factory=CarryConfig)
    sees: str = bounded(IMAGES, one_of=SEES)

    def build(self, parts: Parts | None = None) -> Segmenter:
        """Return the detector.

        Raises:
            ConfigError: A value is impossible, or a class is not among the network's.
            WeightsError: The network's file is absent, damaged, or none of `stillroom export yolo`.
        """
        if self.sees == KEYFRAMES:
            return KeyframeBoxes(self.build_detector(self.confidence, parts))
        if not self.carry.enabled:
            return EachFrameAlone(self.build_detector(self.confidence, parts))
        detector = self.build_detector(self.carry.lowest(self.confidence), parts)
        return CarriedBoxes(detector, self.confidence, self.carry)

    def build_detector(self, confidence: float, parts: Parts | None = None) -> OnnxDetector:
        """Return the bare detector, which reports boxes from a confidence on; without parts, of the file's input."""
        check(self)
        file = self._file()
        if self.longer_side > 0 and parts is not None:
            file.fit_input((parts.camera.width, parts.camera.height), self.longer_side)
        names = file.heads.classes if self.movable == EVERY_CLASS else self.movable
        chosen = [self._number(name, file) for name in names]
        # The input is RGB in 0–255, stretched; a little only where its proportions are those of the images.
        network = DetectionNetwork(open_content(file.cut_to(chosen), file.path), file.path, DetectorInput())
        heads = file.layout(DetectionRequest(file.path, len(chosen), range(len(chosen)), confidence))
        return OnnxDetector(network, heads, names, self.nms_iou)

    def _file(self) -> DarknetFile:
        if self.model is not None:
            return DarknetFile(find_model(self.model))
        with as_file(files("stillroom.semantics") / "weights" / SHIPPED[self.variant]) as shipped:
            return DarknetFile(shipped)

    def _number(self, name: str, file: DarknetFile) -> int:
        classes = file.heads.classes
        if name not in classes:
            raise ConfigError(f"movable class '{name}' is not one of the network's: {', '.join(classes)}")
        return classes.index(name)
