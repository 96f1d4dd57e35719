"""Any detection network in an ONNX file: boxes in one image, without memory."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from stillroom.data.image import Image
from stillroom.data.semantics import Box
from stillroom.errors import ConfigError, WeightsError
from stillroom.geometry.arrays import U8
from stillroom.semantics.detector import suppress
from stillroom.semantics.onnx.fit import STRETCH, Colors, Fit
from stillroom.semantics.onnx.layouts import Layout, Told
from stillroom.semantics.onnx.onnx_session import failures, first_line, image_input

SLACK = 1e-3  # of a probability in half precision


@dataclass(frozen=True)
class DetectorInput:
    """How an image becomes a detector's input.

    Attributes:
        input_px: Width and height of the input where the network does not fix them.
        fit: "letterbox" or "stretch".
        colors: Normalisation of its colours.
    """

    input_px: tuple[int, int] = (640, 640)
    fit: str = STRETCH
    colors: Colors = field(default_factory=Colors)


class DetectionNetwork:
    """A network with one image as input, and its outputs."""

    def __init__(self, session: Any, name: object, reading: DetectorInput) -> None:
        """Take an opened network.

        Args:
            session: onnxruntime's session.
            name: What to call the network in messages, such as its path.
            reading: How an image becomes its input.

        Raises:
            WeightsError: The network does not take one image.
            ConfigError: It takes colours as they are, and the config normalises them.
        """
        self.name = name
        self._session = session
        self._failures = failures()
        self._reading = reading
        self._input = image_input(session, name, may_lack_batch=True)
        if self._input.dtype == np.uint8 and not reading.colors.are_raw:
            raise ConfigError(f"{name} takes whole numbers from 0 to 255; set mean to 0,0,0 and std to 1,1,1")
        width, height = reading.input_px
        self.input_px = self._input.columns or width, self._input.rows or height
        self._planes = np.empty((3, self.input_px[1], self.input_px[0]), dtype=np.float32)

    @property
    def output_shapes(self) -> list[list[Any]]:
        """The outputs' shapes as far as the file fixes them."""
        return [list(node.shape or ()) for node in self._session.get_outputs()]

    def fit(self, image: Image) -> Fit:
        """Return where an image lies in the input."""
        return Fit.of((image.width, image.height), self.input_px, self._reading.fit)

    def run(self, rgb: U8, fit: Fit) -> list[Any]:
        """Return the outputs for an image (H, W, 3) uint8.

        Raises:
            WeightsError: The network cannot be run on it.
        """
        fit.fill(self._planes, rgb, self._reading.colors)
        try:
            outputs: list[Any] = self._session.run(None, {self._input.name: self._input.blob(self._planes)})
        except self._failures as error:
            raise WeightsError(f"{self.name}: cannot be run on an image ({first_line(error)})") from error
        return outputs


class OnnxDetector:
    """A network, the layout of its output, and non-maximum suppression."""

    def __init__(self, network: DetectionNetwork, layout: Layout, labels: Sequence[str], nms_iou: float) -> None:
        """Take a network, and the layout of its boxes.

        Args:
            network: The network.
            layout: Layout of its boxes.
            labels: Names of the wanted classes (M).
            nms_iou: Highest overlap that two boxes of one class may have; of more, the best is kept.

        Raises:
            WeightsError: The network's outputs are not of this layout.
        """
        self._network = network
        self._layout = layout
        self._labels = tuple(labels)
        self._nms_iou = nms_iou
        self._check(network.output_shapes)

    def detect(self, image: Image) -> tuple[Box, ...]:
        """Return the boxes of the wanted classes, the most confident first.

        Raises:
            WeightsError: The network's output does not match its layout.
        """
        fit = self._network.fit(image)
        outputs = self._network.run(image.rgb, fit)
        self._check([np.shape(output) for output in outputs])
        told = self._sound(self._layout.read(outputs))
        kept = suppress(told.unit, told.scores, told.labels, self._nms_iou)
        edges = fit.to_image_px(told.unit[kept])
        return tuple(
            Box(x0, y0, x1, y1, self._labels[told.labels[k]], min(float(told.scores[k]), 1.0))
            for (x0, y0, x1, y1), k in zip(edges.tolist(), kept, strict=True)
        )

    def _check(self, shapes: Sequence[Sequence[Any]]) -> None:
        if not self._layout.fits(shapes):
            told = ", ".join(str(tuple(shape)) for shape in shapes)
            raise WeightsError(
                f"{self._network.name}: its output is of shape {told}, where layout and classes promise "
                f"{self._layout.expected}; set semantics.layout to what it tells, or classes to its names"
            )

    def _sound(self, told: Told) -> Told:
        """Return the boxes with finite edges; refuse scores that are no probabilities."""
        if len(told.scores) and told.scores.max() > 1.0 + SLACK:
            raise WeightsError(
                f"{self._network.name}: returns a score of {told.scores.max():.3g}; scores must be probabilities: "
                "export it with its last sigmoid, or set semantics.layout to what it tells"
            )
        sound = np.isfinite(told.unit).all(axis=1) & (told.unit[:, :2] <= told.unit[:, 2:]).all(axis=1)
        return told if sound.all() else Told(told.unit[sound], told.scores[sound], told.labels[sound])
