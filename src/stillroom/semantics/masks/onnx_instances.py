"""A segmenter from any ONNX instance segmentation network: DynaSLAM's kind of semantics (Mask R-CNN)."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from stillroom.bounds import bounded, check
from stillroom.data.image import Image
from stillroom.data.semantics import Semantics
from stillroom.errors import ConfigError
from stillroom.geometry.arrays import I64
from stillroom.protocols import Parts, Schedule, Segmenter
from stillroom.semantics.class_names import COCO_CLASSES, channels_of, read_class_names
from stillroom.semantics.detector import suppress
from stillroom.semantics.masks.carried_masks import LateMasks, MaskCarryConfig
from stillroom.semantics.masks.instance_segments import NetworkMask, as_instances, painted
from stillroom.semantics.masks.mask_segments import HalfImage, MaskSegments, Numbered
from stillroom.semantics.masks.refine import RefineConfig
from stillroom.semantics.masks.regions import RegionsConfig
from stillroom.semantics.onnx.fit import FITS, LETTERBOX, Colors
from stillroom.semantics.onnx.instance_classes import NUMBERINGS, Chosen, ClassTable
from stillroom.semantics.onnx.instance_layouts import (
    AUTO,
    INSTANCE_LAYOUTS,
    INTEGERS,
    YOLO_SEG,
    Candidates,
    Output,
    ReadingConfig,
    read_candidates,
    roles_of,
)
from stillroom.semantics.onnx.onnx_detector import DetectionNetwork, DetectorInput
from stillroom.semantics.onnx.onnx_session import find_model, open_file

PIXELS, SHARES = "pixels", "shares"
INPUT, BOX = "input", "box"
SIGMOID, SOFTMAX = "sigmoid", "softmax"


@dataclass(frozen=True)
class OnnxInstancesConfig:
    """The network, its output layout and classes, and how its masks are refined and propagated.

    The network takes one image, (1, 3, height, width), (3, height, width), or the same with the colours last. The
    defaults are those of torchvision's Mask R-CNN; docs/add-a-segmenter.md has the settings of others.

    Attributes:
        model: The ONNX file; a bare name is looked up in the model folders.
        layout: Layout of its outputs: "detections", boxes, labels, scores and masks; "detr", boxes, a score of each
            class, and masks; "yolo-seg", rows and prototypes; "auto" is told by them.
            `semantics/onnx/instance_layouts.py` says more.
        classes: Names of the network's classes from number 0 on, with one for the background where it counts that;
            empty is those of `classes_file`, else COCO's.
        classes_file: A text file with these names, one a line.
        numbering: How COCO's classes are numbered: "from-0", 0 to 79; "from-1", 1 to 80; "ids", 1 to 90 with gaps;
            "auto" is told by the number of scores, and where a class has a number is "ids", or, where boxes and scores
            are one output, "from-0".
        movable: Names of the potentially dynamic classes. DynaSLAM's are person, bicycle, car, motorcycle, airplane,
            bus, train, truck, boat, and bird to giraffe (docs/reference.md#dynaslam).
        named: Names of the classes that are static unless people move them.
        confidence: Threshold of an object's score.
        probability: Threshold of a pixel's probability.
        nms_iou: Highest overlap that boxes of one class may have in layout "yolo-seg"; the others are suppressed
            already.
        masks_cover: Whether a mask covers the whole "input", or its "box"; "auto" is told by its size.
        scores: How a score of each class becomes a probability where it is none: by "sigmoid" or "softmax".
        coordinates: Whether edges are in "pixels" of the input, or in "shares" of its sides; those of "detr" always
            are shares.
        input_px: Width and height of the network's input where the file does not fix them [px].
        fit: How an image gets there: "letterbox" keeps its proportions, with gray around it; "stretch".
        mean, std: Subtracted from the colours, which are RGB in 0–255, and divided by.
        bgr: Whether the channels are in the order blue, green, red.
        every: Stride in images at which the network runs; masks are propagated to those between.
        latency_frames: Delay of the network's result, in images.
        refine: How borders are refined by depth.
        carry: How masks are propagated.
        regions: Dilation of masks, and boxes.
    """

    model: Path | None = None
    layout: str = bounded(AUTO, one_of=INSTANCE_LAYOUTS)
    classes: tuple[str, ...] = ()
    classes_file: Path | None = None
    numbering: str = bounded(AUTO, one_of=NUMBERINGS)
    movable: tuple[str, ...] = ("person",)
    named: tuple[str, ...] = ()
    confidence: float = bounded(0.50, above=0, most=1)
    probability: float = bounded(0.5, above=0, below=1)
    nms_iou: float = bounded(0.45, above=0, most=1)
    masks_cover: str = bounded(AUTO, one_of=(AUTO, INPUT, BOX))
    scores: str = bounded(SIGMOID, one_of=(SIGMOID, SOFTMAX))
    coordinates: str = bounded(PIXELS, one_of=(PIXELS, SHARES))
    input_px: tuple[int, int] = bounded((640, 480), least=1)
    fit: str = bounded(LETTERBOX, one_of=tuple(FITS))
    mean: tuple[float, float, float] = (0.0, 0.0, 0.0)
    std: tuple[float, float, float] = bounded((255.0, 255.0, 255.0), above=0)
    bgr: bool = False
    every: int = bounded(1, least=1)
    latency_frames: int = bounded(0, least=0)
    refine: RefineConfig = field(default_factory=RefineConfig)
    carry: MaskCarryConfig = field(default_factory=MaskCarryConfig)
    regions: RegionsConfig = field(default_factory=RegionsConfig)

    def build(self, parts: Parts | None = None) -> Segmenter:
        """Return the segmenter.

        Raises:
            ConfigError: A value is impossible, or a class is not among the network's.
            WeightsError: The network's file is absent, or it is not a network of this kind.
        """
        check(self)
        if self.model is None:
            raise ConfigError("model is not set; name an ONNX file, as in semantics.model=mask_rcnn.onnx")
        names = self._class_names()
        channels_of((*self.movable, *self.named), names or COCO_CLASSES)
        return OnnxInstances(find_model(self.model), names, self, None if parts is None else parts.schedule)

    def _class_names(self) -> tuple[str, ...]:
        """Return the names of the network's classes, in order; none where they are COCO's."""
        if self.classes_file is None:
            return self.classes
        if self.classes:
            raise ConfigError("classes and classes_file are both set; set one of them")
        return read_class_names(self.classes_file)


class OnnxInstances:
    """A network's instances, refined by depth, and propagated where it is late.

    Masks have half the image's size, as those of other networks here. Of two instances that overlap, the one with the
    higher score has the pixel.
    """

    def __init__(
        self, path: Path, names: tuple[str, ...], config: OnnxInstancesConfig, schedule: Schedule | None = None
    ) -> None:
        """Load the network, and start without images.

        Args:
            path: The ONNX file.
            names: Names of its classes; empty for COCO's.
            config: The settings.
            schedule: Runs the network; at once by default.

        Raises:
            WeightsError: It is no ONNX file, does not take one image, or lacks an output.
        """
        self._path, self._config = path, config
        session = open_file(path)
        colors = Colors(config.mean, config.std, config.bgr)
        self._network = DetectionNetwork(session, path, DetectorInput(config.input_px, config.fit, colors))
        nodes = session.get_outputs()
        self._output_names = [node.name for node in nodes]
        told = [Output(node.name, list(node.shape or ()), node.type in INTEGERS) for node in nodes]
        if all(len(output.shape) for output in told):
            roles_of(told, config.layout, path)  # now: before the first image, as far as the file tells it
        self._labels = (*config.movable, *config.named)
        self._classes = ClassTable(self._labels, names, config.numbering, path)
        self._reading = ReadingConfig(
            path,
            self._network.input_px,
            config.coordinates == SHARES,
            config.scores == SOFTMAX,
            None if config.masks_cover == AUTO else config.masks_cover == BOX,
        )
        self._masks = LateMasks(
            self.segments, config.every, config.latency_frames, config.carry, config.refine, schedule
        )

    def __call__(self, image: Image) -> Semantics:
        """Return what is potentially dynamic in the image.

        Raises:
            WeightsError: The network's outputs do not match its layout or its classes.
        """
        known = self._masks(image)
        return as_instances(known.segments, image.height, image.width, known.age, self._config.regions)

    def segments(self, image: Image, view: HalfImage) -> MaskSegments:
        """Return the network's instances of one image, at half size."""
        fit = self._network.fit(image)
        layout, candidates = self._read(self._network.run(image.rgb, fit))
        chosen = self._sound(candidates, self._classes.choose(candidates, self._config.confidence))
        if layout == YOLO_SEG:
            chosen = chosen[suppress(candidates.edges[chosen.rows], chosen.scores, chosen.place, self._config.nms_iou)]
        masks = [mask.in_half_image(fit, view.shape) for mask in self._network_masks(candidates, chosen.rows)]
        things = [
            Numbered(self._labels[place], float(score))
            for place, score in zip(chosen.place, chosen.scores, strict=True)
        ]
        are_named = [bool(place >= len(self._config.movable)) for place in chosen.place]
        return painted(masks, things, are_named, view.shape, bool(self._config.named))

    def _network_masks(self, candidates: Candidates, rows: I64) -> list[NetworkMask]:
        """Return the masks of some candidates (M,), where they are in the input."""
        probability, whole = self._config.probability, np.array([0.0, 0.0, *self._network.input_px])
        least = float(np.log(probability / (1.0 - probability))) if candidates.are_logits else probability
        found = []
        for edges, values in zip(candidates.edges[rows], candidates.masks_of(rows), strict=True):
            cover = edges if candidates.in_boxes else whole
            found.append(NetworkMask(values, least, cover, candidates.in_boxes, edges if candidates.cut else None))
        return found

    @staticmethod
    def _sound(candidates: Candidates, chosen: Chosen) -> Chosen:
        """Return those whose boxes have an area."""
        edges = candidates.edges[chosen.rows]
        return chosen[np.flatnonzero(np.isfinite(edges).all(axis=1) & (edges[:, :2] < edges[:, 2:]).all(axis=1))]

    def _read(self, outputs: list[Any]) -> tuple[str, Candidates]:
        arrays = [np.asarray(output) for output in outputs]
        told = [
            Output(name, array.shape, bool(np.issubdtype(array.dtype, np.integer)))
            for name, array in zip(self._output_names, arrays, strict=True)
        ]
        layout, roles = roles_of(told, self._config.layout, self._path)
        return layout, read_candidates(layout, {role: arrays[k] for role, k in roles.items()}, self._reading)
