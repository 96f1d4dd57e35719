"""The PSPNet segmenter (PSPNet-SLAM III.A): the weights that come with Stillroom, or others of its training."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from stillroom.bounds import bounded, check
from stillroom.errors import WeightsError
from stillroom.geometry.arrays import F32, U8
from stillroom.protocols import Parts, Segmenter
from stillroom.semantics.class_names import VOC_CLASSES, channels_of
from stillroom.semantics.masks.carried_masks import MaskCarryConfig
from stillroom.semantics.masks.network import LOGITS, SegmentationInput, SegmentationNetwork
from stillroom.semantics.masks.onnx_masks import OnnxMasksConfig, segmenter_of
from stillroom.semantics.masks.refine import RefineConfig
from stillroom.semantics.masks.regions import RegionsConfig
from stillroom.semantics.onnx.onnx_session import find_model
from stillroom.semantics.seen_images import IMAGES, SEES

SHIPPED = "pspnet_mobilenetv2_voc.onnx"
INPUTS_PX = {"320x240": 320, "512x384": 512, "640x480": 640}
HALF = (127.5, 127.5, 127.5)
OUTPUT_STRIDE = 4
"""Pixels of the input per pixel of the scores of a network of `stillroom export pspnet`."""


@dataclass(frozen=True)
class PspNetConfig:
    """The PSPNet, its classes, and how its masks are refined and propagated.

    Attributes:
        model: A file of `stillroom export pspnet`; a bare name is looked up in the model folders. Empty is the one
            that comes with Stillroom.
        input: Size of its input: "640x480", "512x384" for two thirds of the time, "320x240" for a third.
        movable: Names of the potentially dynamic classes, of the 21 of PASCAL VOC.
        named: Names of the classes that are static unless people move them; they become boxes.
        probability: Threshold of the summed probabilities of the movable classes.
        sees: "images", every n-th of them; or "keyframes" only and the first image, as in the paper: `every` and
            `latency_frames` then have no effect. Masks are propagated to all other images.
        every: Stride in images at which the network runs.
        latency_frames: Delay of the network's result, in images.
        refine: How borders are refined by depth.
        carry: How masks are propagated.
        regions: Dilation of masks, and boxes of regions.
    """

    model: Path | None = None
    input: str = bounded("640x480", one_of=tuple(INPUTS_PX))
    movable: tuple[str, ...] = ("person",)
    named: tuple[str, ...] = ()
    probability: float = bounded(0.5, above=0, most=1)
    sees: str = bounded(IMAGES, one_of=SEES)
    every: int = bounded(1, least=1)
    latency_frames: int = bounded(0, least=0)
    refine: RefineConfig = field(default_factory=RefineConfig)
    carry: MaskCarryConfig = field(default_factory=MaskCarryConfig)
    regions: RegionsConfig = field(default_factory=RegionsConfig)

    def build(self, parts: Parts | None = None) -> Segmenter:
        """Return the segmenter.

        Raises:
            ConfigError: A value is impossible, or a class is not among VOC's.
            WeightsError: The network's file is absent, or none of `stillroom export pspnet`.
        """
        check(self)
        masks = OnnxMasksConfig(
            movable=self.movable, named=self.named, probability=self.probability, sees=self.sees,
            every=self.every, latency_frames=self.latency_frames, refine=self.refine, carry=self.carry,
            regions=self.regions,
        )  # fmt: skip
        channels = channels_of((*self.movable, *self.named), VOC_CLASSES)
        network = pspnet(self.model, channels, INPUTS_PX[self.input])
        return segmenter_of(network, masks, parts)


def pspnet(model: Path | None, channels: list[int], longer_side_px: int) -> SegmentationNetwork:
    """Return a network of `stillroom export pspnet`.

    Args:
        model: The file; None is the one that comes with Stillroom.
        channels: Channels of the wanted classes.
        longer_side_px: Longer side of its input [px]; the file says to what it is rounded.

    Raises:
        WeightsError: The file is absent, or none of `stillroom export pspnet`.
    """
    if model is not None:
        return PspNetwork(find_model(model), channels, longer_side_px)
    with as_file(files("stillroom.semantics") / "weights" / SHIPPED) as shipped:
        return PspNetwork(shipped, channels, longer_side_px)


class PspNetwork(SegmentationNetwork):
    """A network with scores at a fourth of its input's size, whose file gives the alignment of their pixels."""

    def __init__(self, path: Path, channels: list[int], longer_side_px: int) -> None:
        """Load it.

        Raises:
            WeightsError: The file is absent, or none of `stillroom export pspnet`.
        """
        # The file's metadata is known only after loading; until then any size will do.
        super().__init__(
            path, channels, len(VOC_CLASSES), SegmentationInput(longer_side_px, 1, 0, HALF, HALF, False, LOGITS)
        )
        about: Mapping[str, str] = self._session.get_modelmeta().custom_metadata_map
        try:
            self._corners = about["corners"] == "1"
            step, offset = int(about["stride"]), int(self._corners)
            mean, std = _three(about["mean"]), _three(about["std"])
        except (KeyError, ValueError) as error:
            raise WeightsError(
                f"{path}: not written by 'stillroom export pspnet'; other networks plug in as semantics.kind=onnx-masks"
            ) from error
        self._reading = SegmentationInput(longer_side_px, step, offset, mean, std, False, LOGITS)

    def probabilities(self, rgb: U8, width: int, height: int) -> F32:
        """Return how likely each pixel is of each wanted class (M, height, width) float32 in [0, 1].

        Args:
            rgb: Colours (H, W, 3) uint8.
            width: Columns of the result.
            height: Rows of the result.

        Raises:
            WeightsError: The network cannot be run on the image.
        """
        blob = self._blob(rgb)
        try:
            output = self._session.run(None, {self._input.name: blob})[0]
        except self._failures as error:
            raise WeightsError(f"{self._path}: cannot be run on an image ({error})") from error
        likely = self._likely(self._classes_first(np.asarray(output)))
        to_scores = np.array([self._line(blob.shape[3], width), self._line(blob.shape[2], height)])
        affine = np.array([[to_scores[0, 0], 0.0, to_scores[0, 1]], [0.0, to_scores[1, 0], to_scores[1, 1]]])
        return np.stack([_warped(channel, affine, width, height) for channel in likely])

    def _line(self, input_px: int, answer_px: int) -> tuple[float, float]:
        """Return factor and offset from a pixel of the result to the pixel of the scores along one axis."""
        factor = input_px / answer_px
        offset = 0.5 * factor - 0.5
        if self._corners:
            return factor / OUTPUT_STRIDE, offset / OUTPUT_STRIDE
        return factor / OUTPUT_STRIDE, (offset + 0.5) / OUTPUT_STRIDE - 0.5


def _three(text: str) -> tuple[float, float, float]:
    red, green, blue = (float(word) for word in text.split())
    return red, green, blue


def _warped(channel: F32, affine: Any, width: int, height: int) -> F32:
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    fit = cv2.warpAffine(
        np.ascontiguousarray(channel), affine, (width, height), flags=flags, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(fit, dtype=np.float32)
