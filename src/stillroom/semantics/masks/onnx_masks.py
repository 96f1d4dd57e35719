"""A segmenter from any ONNX segmentation network: the semantic thread of PSPNet-SLAM (III.A) and DynaSLAM."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from stillroom.bounds import bounded, check
from stillroom.data.image import Image
from stillroom.data.semantics import Semantics
from stillroom.geometry.arrays import F32, U8
from stillroom.protocols import Parts, Schedule, Segmenter
from stillroom.semantics.class_names import VOC_CLASSES, channels_of
from stillroom.semantics.masks.carried_masks import KnownImage, LateMasks, MaskCarryConfig
from stillroom.semantics.masks.keyframe_masks import AskedMasks
from stillroom.semantics.masks.mask_segments import HalfImage, MaskSegments
from stillroom.semantics.masks.network import LOGITS, PROBABILITIES, SegmentationInput, SegmentationNetwork
from stillroom.semantics.masks.refine import RefineConfig
from stillroom.semantics.masks.regions import RegionsConfig, as_semantics, without_specks
from stillroom.semantics.onnx.onnx_session import find_model
from stillroom.semantics.seen_images import IMAGES, KEYFRAMES, SEES

DEEPLAB = Path("deeplabv3_mobilenetv2_voc.onnx")
"""The network where none is named: DeepLabv3 on MobileNetV2, VOC classes."""


@dataclass(frozen=True)
class OnnxMasksConfig:
    """The network, its classes, and how its masks are refined and propagated.

    The network takes one image, (1, 3, height, width) or (1, height, width, 3), and returns a score of each class for
    each pixel, (1, classes, h, w) or (1, h, w, classes), or the number of the best class, (1, h, w).

    Attributes:
        model: The ONNX file; a bare name is looked up in the model folders. Empty is DeepLabv3-MobileNetV2.
        classes: Names of the network's classes in the order of its channels.
        movable: Names of the potentially dynamic classes.
        named: Names of the classes that are static unless people move them; they become boxes, which help to cluster
            the depth cloud.
        probability: Threshold of the summed probabilities of the movable classes.
        sees: "images", every n-th of them; or "keyframes" only and the first image, as the segmentation threads of the
            papers do: `every` and `latency_frames` then have no effect. Masks are propagated to all other images.
        every: Stride in images at which the network runs.
        latency_frames: Delay of the network's result, in images.
        longer_side_px: Longer side of the network's input where the file does not fix its size [px].
        step_px, offset_px: Sides of the input are a multiple of `step_px`, plus `offset_px` [px].
        mean, std: Subtracted from the colours, which are RGB in 0–255, and divided by.
        bgr: Whether the channels are in the order blue, green, red.
        scores: Output of the network: "logits" or "probabilities". Integers are always the best class.
        refine: How borders are refined by depth.
        carry: How masks are propagated.
        regions: Dilation of masks, and boxes of regions.
    """

    model: Path | None = None
    classes: tuple[str, ...] = VOC_CLASSES
    movable: tuple[str, ...] = ("person",)
    named: tuple[str, ...] = ()
    probability: float = bounded(0.5, above=0, most=1)
    sees: str = bounded(IMAGES, one_of=SEES)
    every: int = bounded(1, least=1)
    latency_frames: int = bounded(0, least=0)
    longer_side_px: int = bounded(321, least=1)
    step_px: int = bounded(16, least=1)
    offset_px: int = bounded(1, least=0)
    mean: tuple[float, float, float] = (127.5, 127.5, 127.5)
    std: tuple[float, float, float] = bounded((127.5, 127.5, 127.5), above=0)
    bgr: bool = False
    scores: str = bounded(LOGITS, one_of=(LOGITS, PROBABILITIES))
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
        channels = channels_of((*self.movable, *self.named), self.classes)
        network = SegmentationNetwork(find_model(self.model or DEEPLAB), channels, len(self.classes), self._reading())
        return segmenter_of(network, self, parts)

    def _reading(self) -> SegmentationInput:
        return SegmentationInput(
            self.longer_side_px, self.step_px, self.offset_px, self.mean, self.std, self.bgr, self.scores
        )


def segmenter_of(network: SegmentationNetwork, config: OnnxMasksConfig, parts: Parts | None) -> Segmenter:
    """Return a network's segmenter: of all images, or a `KeyframeSegmenter`."""
    reading = Reading(network, config)
    schedule = None if parts is None else parts.schedule
    return OnnxKeyframeMasks(reading, schedule) if config.sees == KEYFRAMES else OnnxMasks(reading, schedule)


class Reading:
    """What a network finds in one image: its segments, and what they mean.

    Attributes:
        config, network: What it was made of.
    """

    def __init__(self, network: SegmentationNetwork, config: OnnxMasksConfig) -> None:
        """Take the network, and which of its classes are movable."""
        self.config = config
        self.network = network

    def segments(self, image: Image, view: HalfImage) -> MaskSegments:
        """Return the network's segments of one image, at half size.

        Raises:
            WeightsError: The network's output does not match its classes.
        """
        rows, columns = view.shape
        every, least = self.network.probabilities(image.rgb, columns, rows), self.config.probability
        n_movable = len(self.config.movable)
        likely, others = every[:n_movable], every[n_movable:]
        together = np.minimum(likely.sum(axis=0), 1.0)
        label = _best(likely)[0] * (together >= least)
        if len(others) == 0:
            return MaskSegments(label, together)
        best, highest = _best(others)
        named = best * ((label == 0) & (highest >= least))
        return MaskSegments(label, np.where(named > 0, highest, together), named)

    def semantics(self, known: KnownImage, image: Image) -> Semantics:
        """Return segments of an image, from the network or propagated, as what is potentially dynamic in it."""
        config = self.config
        segments = without_specks(known.segments, config.regions.min_px)
        size = image.height, image.width
        return as_semantics(segments, config.movable, *size, known.age, config.regions, config.named)


class OnnxMasks:
    """A network's masks, refined by depth, and propagated where it is late."""

    def __init__(self, reading: Reading, schedule: Schedule | None = None) -> None:
        """Start without images."""
        self.reading, config = reading, reading.config
        self._masks = LateMasks(
            reading.segments, config.every, config.latency_frames, config.carry, config.refine, schedule
        )

    def __call__(self, image: Image) -> Semantics:
        """Return what is potentially dynamic in the image.

        Raises:
            WeightsError: The network's output does not match its classes.
        """
        return self.reading.semantics(self._masks(image), image)


class OnnxKeyframeMasks:
    """A network's masks of keyframes, refined by depth, and propagated to the images between: a `KeyframeSegmenter`."""

    def __init__(self, reading: Reading, schedule: Schedule | None = None) -> None:
        """Start without images."""
        self.reading, config = reading, reading.config
        self._masks = AskedMasks(reading.segments, config.carry, config.refine, schedule)

    def __call__(self, image: Image) -> Semantics:
        """Return the masks of the last keyframe, propagated to the image; of the first image its own.

        Raises:
            WeightsError: The network's output does not match its classes.
        """
        return self.reading.semantics(self._masks(image), image)

    def see(self, image: Image) -> Semantics:
        """Return what the network finds in an image that becomes a keyframe.

        Raises:
            WeightsError: The network's output does not match its classes.
        """
        return self.reading.semantics(self._masks.see(image), image)


def _best(likely: F32) -> tuple[U8, F32]:
    """Return which of the classes (M, h, w) is the likeliest at each pixel, counted from 1, and how likely it is."""
    # Class by class: a tenth of the time of numpy's argmax, which goes through each pixel's classes by itself.
    best, highest = np.ones(likely.shape[1:], dtype=np.uint8), likely[0]
    for number, channel in enumerate(likely[1:], start=2):
        best[channel > highest] = number
        highest = np.maximum(highest, channel)
    return best, highest
