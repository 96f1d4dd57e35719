"""Any segmentation network in an ONNX file: its input format and the meaning of its output."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from stillroom.errors import WeightsError
from stillroom.geometry.arrays import F32, U8
from stillroom.semantics.onnx.onnx_session import COLORS, failures, first_line, image_input, open_file

LOGITS, PROBABILITIES = "logits", "probabilities"


@dataclass(frozen=True)
class SegmentationInput:
    """How an image becomes a network's input, and its output probabilities.

    Attributes:
        longer_side_px: Longer side of the input where the network does not fix its size [px].
        step_px, offset_px: Sides of the input are a multiple of `step_px`, plus `offset_px`.
        mean, std: Subtracted from the colours, and divided by; colours are RGB in 0–255.
        bgr: Whether the network wants the channels in the order blue, green, red.
        scores: Output of a network with a channel for each class: "logits" or "probabilities".
        width, height: Largest size of the result [px]; larger outputs are subsampled.
    """

    longer_side_px: int
    step_px: int
    offset_px: int
    mean: tuple[float, float, float]
    std: tuple[float, float, float]
    bgr: bool
    scores: str

    def side_px(self, side: int, longer: int) -> int:
        """Return a side of the input for a side of the image [px]."""
        wanted = self.longer_side_px * side / longer
        steps = max(round((wanted - self.offset_px) / self.step_px), 1)
        return steps * self.step_px + self.offset_px


class SegmentationNetwork:
    """A network with one image as input and a score of each class, or the best class, for each pixel as output."""

    def __init__(self, path: Path, channels: Sequence[int], n_classes: int, reading: SegmentationInput) -> None:
        """Load the network.

        Args:
            path: The ONNX file.
            channels: Channels of the wanted classes (M).
            n_classes: Number of its classes.
            reading: Format of its input and output.

        Raises:
            WeightsError: The file is absent or no ONNX file, or the network does not take one image.
        """
        self._path = path
        self._channels = list(channels)
        self._n_classes = n_classes
        self._reading = reading
        self._session = open_file(path)
        self._failures = failures()
        self._input = image_input(self._session, path)

    def probabilities(self, rgb: U8, width: int, height: int) -> F32:
        """Return how likely each pixel is of each wanted class.

        Args:
            rgb: Colours (H, W, 3) uint8.
            width: Columns of the result.
            height: Rows of the result.

        Returns:
            (M, height, width) float32 in [0, 1].

        Raises:
            WeightsError: The network cannot be run on the image, or its output does not match its classes.
        """
        try:
            output = self._session.run(None, {self._input.name: self._blob(rgb)})[0]
        except self._failures as error:
            raise WeightsError(f"{self._path}: cannot be run on an image ({first_line(error)})") from error
        scores = self._classes_first(np.asarray(output))
        thinned = scores[:, :: max(scores.shape[1] // height, 1), :: max(scores.shape[2] // width, 1)]
        likely = self._likely(thinned)
        return np.stack([_resized(channel, width, height) for channel in likely])

    def _blob(self, rgb: U8) -> Any:
        height, width = rgb.shape[:2]
        longer = max(height, width)
        size = (
            self._input.columns or self._reading.side_px(width, longer),
            self._input.rows or self._reading.side_px(height, longer),
        )
        planes = color_planes(rgb, size, self._reading.mean, self._reading.std, self._reading.bgr)
        return self._input.blob(planes)

    def _classes_first(self, output: Any) -> Any:
        """Return an output as scores (classes, h, w); a map of best classes as scores of 0 and 1."""
        if output.ndim == 3 and output.shape[0] == 1:
            output = output[:, None]
        if output.ndim == 4 and output.shape[0] == 1:
            if np.issubdtype(output.dtype, np.integer) and 1 in (output.shape[1], output.shape[3]):
                labels = output[0, 0] if output.shape[1] == 1 else output[0, ..., 0]
                return labels[None] == np.arange(self._n_classes).reshape(-1, 1, 1)
            if output.shape[1] == self._n_classes:
                return output[0]
            if output.shape[3] == self._n_classes:
                return output[0].transpose(2, 0, 1)
        raise WeightsError(
            f"{self._path}: its output is of shape {output.shape}, where {self._n_classes} classes are named: it must "
            f"be (1, {self._n_classes}, height, width), or whole numbers (1, height, width); set classes to its names"
        )

    def _likely(self, scores: Any) -> F32:
        """Return the probabilities of the wanted classes (M, h, w)."""
        asked = scores[self._channels].astype(np.float32)
        if scores.dtype == np.bool_ or self._reading.scores == PROBABILITIES:
            return np.asarray(np.clip(np.nan_to_num(asked, nan=0.0), 0.0, 1.0), dtype=np.float32)
        if self._n_classes == 1:
            return np.asarray(0.5 * (1.0 + np.tanh(0.5 * asked)), dtype=np.float32)
        exponent = np.exp(scores.astype(np.float32) - scores.max(axis=0).astype(np.float32))
        likely = exponent[self._channels] / exponent.sum(axis=0)
        return np.asarray(np.nan_to_num(likely, nan=0.0), dtype=np.float32)


def color_planes(
    rgb: U8, size: tuple[int, int], mean: tuple[float, float, float], std: tuple[float, float, float], bgr: bool = False
) -> F32:
    """Return an image as a network sees it (3, rows, columns) float32.

    Args:
        rgb: Colours (H, W, 3) uint8.
        size: Columns and rows wanted.
        mean, std: Subtracted from each colour, and divided by.
        bgr: Whether blue comes first.
    """
    # Down to half the width and height every pixel has its say in a linear interpolation, at an eighth of the time.
    shrinks = size[0] * size[1] < 0.25 * rgb.shape[0] * rgb.shape[1]
    fit = np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR))
    # Plane by plane: a sixth of the time that it takes with interleaved colours.
    planes = np.empty((COLORS, size[1], size[0]), dtype=np.float32)
    for plane, color, middle, width in zip(planes, cv2.split(fit)[:: -1 if bgr else 1], mean, std, strict=True):
        np.subtract(color, np.float32(middle), out=plane)
        plane /= np.float32(width)
    return planes


def _resized(channel: F32, width: int, height: int) -> F32:
    fit = cv2.resize(np.ascontiguousarray(channel), (width, height), interpolation=cv2.INTER_LINEAR)
    return np.asarray(fit, dtype=np.float32)
