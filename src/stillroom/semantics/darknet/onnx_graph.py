"""Write a darknet network as an ONNX model.

The model takes `image` (1, 3, H, W) float32 RGB in [0, 255] and gives the raw numbers of each yolo head as
`head_0`, `head_1` …, (1, anchors × (5 + classes), h, w) float32, of the chosen classes in the chosen order.
"""

import hashlib
import logging
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from stillroom.data.locations import cache_folder
from stillroom.semantics.darknet.cfg import fingerprint, read_cfg
from stillroom.semantics.darknet.network import (
    Convolution,
    Dropout,
    Layer,
    Maxpool,
    Network,
    Route,
    Shortcut,
    Upsample,
    YoloHead,
)
from stillroom.semantics.darknet.weights import ConvolutionWeights, read_weights

CONVERTER_VERSION = 2
OPSET = 13
IR_VERSION = 8  # read by every onnxruntime since 1.10
LEAKY_SLOPE = 0.1
SEAL_BYTES = 32

logger = logging.getLogger(__name__)


def onnx_model(cfg: Path, weights: Path, classes: Sequence[int]) -> bytes:
    """Return the ONNX model of a cfg and its weights, from the user's cache when it was made before.

    Args:
        cfg: The network.
        weights: Its numbers.
        classes: The classes that the heads shall tell; leaving out the others saves a twentieth of the time.

    Raises:
        WeightsError: The cfg or the weights are missing, damaged or not supported.
    """
    made_of = f"{CONVERTER_VERSION} {fingerprint(cfg, weights)} {list(classes)}"
    path = cache_folder() / "darknet" / f"{hashlib.sha256(made_of.encode()).hexdigest()[:32]}.onnx.sealed"
    kept = _read_kept(path)
    if kept is not None:
        return kept
    network = read_cfg(cfg)
    model = convert(network, read_weights(weights, network), classes)
    _keep(model, path)
    return model


def convert(network: Network, weights: list[ConvolutionWeights], classes: Sequence[int]) -> bytes:
    """Return the ONNX model of a network; `weights` are those of its convolutions, in order."""
    from onnx import TensorProto, checker, helper

    graph = _Graph(network, weights, classes)
    for index, layer in enumerate(network.layers):
        graph.add(index, layer)
    channels, height, width = network.input_shape
    image = helper.make_tensor_value_info("image", TensorProto.FLOAT, (1, channels, height, width))
    heads = [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name, shape in graph.heads]
    body = helper.make_graph(graph.nodes, "darknet", [image], heads, graph.constants)
    model = helper.make_model(
        body,
        producer_name="stillroom",
        ir_version=IR_VERSION,
        opset_imports=[helper.make_opsetid("", OPSET)],
    )
    checker.check_model(model)
    return bytes(model.SerializeToString())


class _Graph:
    """The growing ONNX graph; `values[i]` is the name of layer i's output."""

    def __init__(self, network: Network, weights: list[ConvolutionWeights], classes: Sequence[int]) -> None:
        self.network = network
        self.weights = iter(weights)
        self.classes = classes
        self.nodes: list[Any] = []
        self.constants: list[Any] = []
        self.values: list[str] = []
        self.heads: list[tuple[str, tuple[int, ...]]] = []

    def add(self, index: int, layer: Layer) -> None:
        """Append one layer."""
        before = self.values[-1] if self.values else "image"
        out = f"layer_{index}"
        match layer:
            case Convolution():
                following = self.network.layers[index + 1 : index + 2]
                head = next((layer for layer in following if isinstance(layer, YoloHead)), None)
                self._convolution(layer, head, before, out)
            case Maxpool(size=size, stride=stride, padding=padding):
                left, right = padding // 2, padding - padding // 2
                pads = [left, left, right, right]
                self._node("MaxPool", [before], out, kernel_shape=[size] * 2, strides=[stride] * 2, pads=pads)
            case Route(sources=(source,)):
                out = self.values[source]
            case Route(sources=sources):
                self._node("Concat", [self.values[source] for source in sources], out, axis=1)
            case Shortcut(source=source, activation=activation):
                self._activated("Add", [before, self.values[source]], out, activation)
            case Upsample(stride=stride):
                self._upsample(before, out, stride)
            case Dropout():
                out = before
            case YoloHead():
                name = f"head_{len(self.heads)}"
                self._node("Identity", [before], name)
                channels = len(layer.anchors_px) * (5 + len(self.classes))
                self.heads.append((name, (1, channels, *self.network.shapes[index][1:])))
                out = before
        self.values.append(out)

    def _convolution(self, layer: Convolution, head: YoloHead | None, before: str, out: str) -> None:
        weights = next(self.weights)
        if head is not None:
            rows = _rows_of(head, self.classes)
            weights = ConvolutionWeights(weights.kernel[rows], weights.bias[rows])
        # darknet sees brightness in [0, 1]; its zero padding is zero in either scale.
        kernel = weights.kernel / np.float32(255.0) if before == "image" else weights.kernel
        names = [before, self._constant(f"{out}_kernel", kernel), self._constant(f"{out}_bias", weights.bias)]
        self._activated(
            "Conv",
            names,
            out,
            layer.activation,
            kernel_shape=[layer.size] * 2,
            strides=[layer.stride] * 2,
            pads=[layer.padding] * 4,
            group=layer.groups,
        )

    def _upsample(self, before: str, out: str, stride: int) -> None:
        scales = self._constant(f"{out}_scales", np.array([1, 1, stride, stride], dtype=np.float32))
        self._node(
            "Resize",
            [before, "", scales],
            out,
            mode="nearest",
            coordinate_transformation_mode="asymmetric",
            nearest_mode="floor",
        )

    def _activated(self, kind: str, inputs: list[str], out: str, activation: str, **options: Any) -> None:
        """Append a node, and its activation behind it."""
        if activation == "linear":
            self._node(kind, inputs, out, **options)
            return
        self._node(kind, inputs, f"{out}_raw", **options)
        match activation:
            case "leaky":
                self._node("LeakyRelu", [f"{out}_raw"], out, alpha=LEAKY_SLOPE)
            case "relu":
                self._node("Relu", [f"{out}_raw"], out)
            case "relu6":
                limits = [self._constant(f"{out}_{limit}", np.float32(limit)) for limit in (0, 6)]
                self._node("Clip", [f"{out}_raw", *limits], out)
            case "logistic":
                self._node("Sigmoid", [f"{out}_raw"], out)

    def _node(self, kind: str, inputs: list[str], out: str, **options: Any) -> None:
        from onnx import helper

        self.nodes.append(helper.make_node(kind, inputs, [out], **options))

    def _constant(self, name: str, value: Any) -> str:
        from onnx import numpy_helper

        self.constants.append(numpy_helper.from_array(np.asarray(value, dtype=np.float32), name))
        return name


def _rows_of(head: YoloHead, classes: Sequence[int]) -> list[int]:
    """Return which filters of the convolution before a head tell the box, the objectness and the chosen classes."""
    per_anchor = [*range(5), *(5 + number for number in classes)]
    return [anchor * (5 + head.classes) + row for anchor in range(len(head.anchors_px)) for row in per_anchor]


def _read_kept(path: Path) -> bytes | None:
    """Return the model that `_keep` wrote; None where there is none, or a damaged one."""
    try:
        content = path.read_bytes()
    except OSError:
        return None
    seal, model = content[:SEAL_BYTES], content[SEAL_BYTES:]
    return model if hashlib.sha256(model).digest() == seal else None


def _keep(model: bytes, path: Path) -> None:
    """Write the model behind its hash, whole or not at all: several runs may convert at once."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as file:
            file.write(hashlib.sha256(model).digest() + model)
        Path(file.name).replace(path)
    except OSError as error:
        logger.info("%s: the converted network could not be kept (%s)", path, error)
