"""Write a darknet network as an ONNX file that the core reads, `stillroom.semantics.onnx.darknet`.

The model takes `image` (1, 3, H, W) float32 RGB in [0, 255] and gives the raw numbers of each yolo head as
`head_0`, `head_1` …, (1, anchors × (5 + classes), h, w) float32. Its metadata name the classes and the anchors.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from stillroom.errors import WeightsError
from stillroom.semantics.class_names import read_class_names
from stillroom.semantics.onnx.darknet import Head, Heads
from stillroom_train.darknet.cfg import read_cfg
from stillroom_train.darknet.network import (
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
from stillroom_train.darknet.weights import ConvolutionWeights, read_weights

OPSET = 13
IR_VERSION = 8  # read by every onnxruntime since 1.10
LEAKY_SLOPE = 0.1


def convert_files(cfg: Path, weights: Path, names: Path, about: str = "") -> bytes:
    """Return the ONNX model of darknet's three files.

    Args:
        cfg: The network.
        weights: Its weights.
        names: Its class names, one a line.
        about: Origin and licence, stored in the file.

    Raises:
        WeightsError: A file is missing, damaged or not supported, or they do not belong to each other.
        ConfigError: The names cannot be read.
    """
    network = read_cfg(cfg)
    classes, n_told = read_class_names(names), network.heads[0].classes
    if len(classes) != n_told:
        raise WeightsError(f"{names}: {len(classes)} class names; the network has {n_told}")
    return convert(network, read_weights(weights, network), classes, about)


def convert(network: Network, weights: list[ConvolutionWeights], classes: Sequence[str], about: str = "") -> bytes:
    """Return the ONNX model of a network.

    Args:
        network: What is computed.
        weights: The numbers of its convolutions, in order.
        classes: Names of its classes.
        about: Origin and licence, stored in the file.
    """
    from onnx import TensorProto, checker, helper

    graph = _Graph(network, weights)
    for index, layer in enumerate(network.layers):
        graph.add(index, layer)
    channels, height, width = network.input_shape
    image = helper.make_tensor_value_info("image", TensorProto.FLOAT, (1, channels, height, width))
    heads = [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name, shape in graph.heads]
    body = helper.make_graph(graph.nodes, "darknet", [image], heads, graph.constants)
    model = helper.make_model(
        body,
        producer_name="stillroom",
        doc_string=about,
        ir_version=IR_VERSION,
        opset_imports=[helper.make_opsetid("", OPSET)],
    )
    heads_told = Heads(tuple(classes), tuple(Head(head.anchors_px, head.scale_xy) for head in network.heads))
    helper.set_model_props(model, heads_told.as_metadata())
    checker.check_model(model)
    return bytes(model.SerializeToString())


class _Graph:
    """The growing ONNX graph; `values[i]` is the name of layer i's output."""

    def __init__(self, network: Network, weights: list[ConvolutionWeights]) -> None:
        self.network = network
        self.weights = iter(weights)
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
                self._convolution(layer, before, out)
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
                self.heads.append((name, (1, *self.network.shapes[index])))
                out = before
        self.values.append(out)

    def _convolution(self, layer: Convolution, before: str, out: str) -> None:
        weights = next(self.weights)
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
