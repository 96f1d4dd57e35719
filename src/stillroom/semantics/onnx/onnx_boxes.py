"""A segmenter from any ONNX detection network: boxes."""

from dataclasses import dataclass, field
from pathlib import Path

from stillroom.bounds import bounded, check
from stillroom.errors import ConfigError
from stillroom.protocols import Parts, Segmenter
from stillroom.semantics.carried_boxes import CarriedBoxes, CarryConfig
from stillroom.semantics.class_names import COCO_CLASSES, channels_of, read_class_names
from stillroom.semantics.detector import EachFrameAlone
from stillroom.semantics.onnx.darknet import DarknetFile
from stillroom.semantics.onnx.fit import FITS, LETTERBOX, Colors
from stillroom.semantics.onnx.layouts import DARKNET, LAYOUTS, YOLO_V8, DetectionRequest, Layout, layout_of
from stillroom.semantics.onnx.onnx_detector import DetectionNetwork, DetectorInput, OnnxDetector
from stillroom.semantics.onnx.onnx_session import find_model, open_content, open_file

PIXELS, SHARES = "pixels", "shares"


@dataclass(frozen=True)
class OnnxBoxesConfig:
    """The network, its output layout, and how boxes are propagated.

    The network takes one image, (1, 3, height, width) or (1, height, width, 3). The defaults are those of YOLO v8 to
    v11 as Ultralytics exports them.

    Attributes:
        model: The ONNX file; a bare name is looked up in the model folders.
        layout: Layout of its boxes: "yolo-v8", (1, 4 + classes, boxes); "yolo-v5", (1, boxes, 5 + classes); "nms",
            (1, boxes, 6) or (boxes, 6), of edges, score and class; "detections", boxes, labels and scores as three
            outputs; "darknet", a raw output for each head, in a file of `stillroom export yolo`.
            `semantics/onnx/layouts.py` says more.
        classes: Names of the network's classes in order, with one for the background where it counts that; empty is
            those of `classes_file`, or of a file of `stillroom export yolo`, else the 80 of COCO.
        classes_file: A text file with these names, one a line.
        movable: Names of the potentially dynamic classes.
        named: Names of the classes that are static unless people move them.
        confidence: Confidence threshold of a box.
        nms_iou: Highest overlap that two boxes of one class may have; of more, the best is kept.
        input_px: Width and height of the network's input where the file does not fix them [px].
        fit: How an image gets there: "letterbox" keeps its proportions, with gray around it; "stretch".
        mean, std: Subtracted from the colours, which are RGB in 0–255, and divided by. Networks by darknet, and those
            that take integers, need 0 and 1.
        bgr: Whether the channels are in the order blue, green, red.
        coordinates: Whether edges are in "pixels" of the input, or in "shares" of its sides; darknet's heads are
            read as they are.
        carry: How boxes are propagated over the frames in which they are missed.
    """

    model: Path | None = None
    layout: str = bounded(YOLO_V8, one_of=tuple(LAYOUTS))
    classes: tuple[str, ...] = ()
    classes_file: Path | None = None
    movable: tuple[str, ...] = ("person",)
    named: tuple[str, ...] = ()
    confidence: float = bounded(0.50, above=0, most=1)
    nms_iou: float = bounded(0.45, above=0, most=1)
    input_px: tuple[int, int] = bounded((640, 640), least=1)
    fit: str = bounded(LETTERBOX, one_of=tuple(FITS))
    mean: tuple[float, float, float] = (0.0, 0.0, 0.0)
    std: tuple[float, float, float] = bounded((255.0, 255.0, 255.0), above=0)
    bgr: bool = False
    coordinates: str = bounded(PIXELS, one_of=(PIXELS, SHARES))
    carry: CarryConfig = field(default_factory=CarryConfig)

    def build(self, parts: Parts | None = None) -> Segmenter:
        """Return the segmenter.

        Raises:
            ConfigError: A value is impossible, or a class is not among the network's.
            WeightsError: The network's file is absent, or it is not a network of this kind.
        """
        if not self.carry.enabled:
            return EachFrameAlone(self.build_detector(self.confidence), self.named)
        detector = self.build_detector(self.carry.lowest(self.confidence))
        return CarriedBoxes(detector, self.confidence, self.carry, self.named)

    def build_detector(self, confidence: float) -> OnnxDetector:
        """Return the bare detector, which reports boxes from a confidence on."""
        check(self)
        if self.model is None:
            raise ConfigError("model is not set; name an ONNX file, as in semantics.model=detector.onnx")
        path = find_model(self.model)
        darknet = DarknetFile(path) if self.layout == DARKNET else None
        names = self.class_names(COCO_CLASSES if darknet is None else darknet.heads.classes)
        labels = (*self.movable, *self.named)
        chosen = channels_of(labels, names)
        reading = DetectorInput(self.input_px, self.fit, Colors(self.mean, self.std, self.bgr))
        if darknet is not None:
            network = DetectionNetwork(open_content(darknet.cut_to(chosen), path), path, reading)
            layout: Layout = darknet.layout(DetectionRequest(path, len(chosen), range(len(chosen)), confidence))
        else:
            network = DetectionNetwork(open_file(path), path, reading)
            side_px = network.input_px if self.coordinates == PIXELS else (1, 1)
            layout = layout_of(self.layout, DetectionRequest(path, len(names), chosen, confidence, side_px))
        return OnnxDetector(network, layout, labels, self.nms_iou)

    def class_names(self, default: tuple[str, ...]) -> tuple[str, ...]:
        """Return the names of the network's classes, in order.

        Args:
            default: Those that are used where none are set.

        Raises:
            ConfigError: They are named twice, or their file cannot be read.
        """
        if self.classes_file is None:
            return self.classes or default
        if self.classes:
            raise ConfigError("classes and classes_file are both set; set one of them")
        return read_class_names(self.classes_file)
