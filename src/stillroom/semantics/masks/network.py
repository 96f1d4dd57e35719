"""Any segmentation network in an ONNX file: what its input wants, and what its output means."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from stillroom.errors import WeightsError
from stillroom.geometry.arrays import F32, U8

COLORS = 3
INPUT_TYPES = {"tensor(float)": np.float32, "tensor(float16)": np.float16, "tensor(uint8)": np.uint8}
LOGITS, PROBABILITIES = "logits", "probabilities"


@dataclass(frozen=True)
class Reading:
    """How an image becomes a network's input, and its output probabilities.

    Attributes:
        longer_side_px: Longer side of the input where the network leaves its size open [px].
        step_px, offset_px: Sides of the input are a multiple of `step_px`, plus `offset_px`.
        mean, std: Subtracted from the colours, and divided by; colours are RGB in 0–255.
        bgr: Whether the network wants the channels in the order blue, green, red.
        scores: What a network with a channel for each class tells: "logits" or "probabilities".
        width, height: Largest size in which the answer is wanted [px]; networks that say more are thinned out.
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

    def __init__(self, path: Path, channels: Sequence[int], n_classes: int, reading: Reading) -> None:
        """Load the network.

        Args:
            path: The ONNX file.
            channels: Channels of the classes that are asked for (M).
            n_classes: How many classes it tells.
            reading: What its input and output mean.

        Raises:
            WeightsError: The file is absent or no ONNX file, or the network does not take one image.
        """
        self._path = path
        self._channels = list(channels)
        self._n_classes = n_classes
        self._reading = reading
        self._session = _session(path)
        self._failures = _failures()
        self._input = self._session.get_inputs()[0]
        self._channels_last = self._check_input()

    def probabilities(self, rgb: U8, width: int, height: int) -> F32:
        """Return how likely each pixel is of each class that is asked for.

        Args:
            rgb: Colours (H, W, 3) uint8.
            width: Columns of the answer.
            height: Rows of the answer.

        Returns:
            (M, height, width) float32 in [0, 1].

        Raises:
            WeightsError: The network cannot be run on the image, or its output is not what its classes promise.
        """
        try:
            output = self._session.run(None, {self._input.name: self._blob(rgb)})[0]
        except self._failures as error:
            raise WeightsError(f"{self._path}: cannot be run on an image ({_first_line(error)})") from error
        scores = self._classes_first(np.asarray(output))
        thinned = scores[:, :: max(scores.shape[1] // height, 1), :: max(scores.shape[2] // width, 1)]
        likely = self._likely(thinned)
        return np.stack([_resized(channel, width, height) for channel in likely])

    def _check_input(self) -> bool:
        """Make sure that the network takes one image; tell whether its channels come last."""
        shape, inputs = self._input.shape, self._session.get_inputs()
        if len(inputs) != 1:
            names = ", ".join(node.name for node in inputs)
            raise WeightsError(f"{self._path}: takes {len(inputs)} inputs ({names}); it must take one image")
        if self._input.type not in INPUT_TYPES:
            raise WeightsError(f"{self._path}: takes {self._input.type}; it must take {', '.join(INPUT_TYPES)}")
        first, last = (len(shape) == 4 and shape[axis] == COLORS for axis in (1, 3))
        if not (first or last) or (isinstance(shape[0], int) and shape[0] > 1):
            raise WeightsError(
                f"{self._path}: its input '{self._input.name}' is of shape {shape}; "
                "it must be (1, 3, height, width) or (1, height, width, 3)"
            )
        return last and not first

    def _blob(self, rgb: U8) -> Any:
        height, width = rgb.shape[:2]
        rows, columns = self._input.shape[1:3] if self._channels_last else self._input.shape[2:4]
        longer = max(height, width)
        size = (
            columns if isinstance(columns, int) else self._reading.side_px(width, longer),
            rows if isinstance(rows, int) else self._reading.side_px(height, longer),
        )
        planes = color_planes(rgb, size, self._reading.mean, self._reading.std, self._reading.bgr)
        ordered = planes.transpose(1, 2, 0) if self._channels_last else planes
        return np.ascontiguousarray(ordered[None], dtype=INPUT_TYPES[self._input.type])

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
        """Return the probabilities of the classes that are asked for (M, h, w)."""
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
    shrinks = size[0] * size[1] < 0.5 * rgb.shape[0] * rgb.shape[1]
    fit = np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR))
    # Plane by plane: a sixth of the time that it takes with the colours beside each other.
    planes = np.empty((COLORS, size[1], size[0]), dtype=np.float32)
    for plane, color, middle, width in zip(planes, cv2.split(fit)[:: -1 if bgr else 1], mean, std, strict=True):
        np.subtract(color, np.float32(middle), out=plane)
        plane /= np.float32(width)
    return planes


def _resized(channel: F32, width: int, height: int) -> F32:
    fit = cv2.resize(np.ascontiguousarray(channel), (width, height), interpolation=cv2.INTER_LINEAR)
    return np.asarray(fit, dtype=np.float32)


def _session(path: Path) -> Any:
    if not path.is_file():
        raise WeightsError(f"{path}: no such file; set semantics.model to an ONNX file")
    try:
        return on_one_thread(str(path))
    except _failures() as error:
        raise WeightsError(f"{path}: not an ONNX network that can be run ({_first_line(error)})") from error


def on_one_thread(model: str | bytes) -> Any:
    """Return onnxruntime's session of a file, or of a file's content.

    On one thread the same image gives the same numbers, and tracking keeps its cores.
    """
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
    options.log_severity_level = 4  # what fails is raised, and told in one line
    return onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])


def _failures() -> tuple[type[Exception], ...]:
    """Return what onnxruntime raises; its errors have no base of their own."""
    from onnxruntime.capi import onnxruntime_pybind11_state as state

    names = (
        "Fail", "InvalidArgument", "InvalidGraph", "InvalidProtobuf", "NoModel", "NoSuchFile", "NotImplemented",
        "RuntimeException",
    )  # fmt: skip
    return tuple(getattr(state, name) for name in names)


def _first_line(error: Exception) -> str:
    return str(error).strip().splitlines()[0][:200]
