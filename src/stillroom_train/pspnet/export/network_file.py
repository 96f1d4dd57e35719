"""A network's steps and weights as an ONNX file."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from stillroom.errors import WeightsError
from stillroom.geometry.arrays import F32
from stillroom_train.pspnet.export.graph import Graph
from stillroom_train.pspnet.export.slim import slim
from stillroom_train.pspnet.networks.steps import (
    AUXILIARY,
    IMAGE,
    LOGITS,
    RELU6,
    Add,
    Architecture,
    Concat,
    Conv,
    Drop,
    Enlarge,
    MaxPool,
    Pyramid,
    Step,
)

NORM_EPSILON = 1e-5
OUTPUT_STRIDE = 4
"""Image pixels per pixel of the scores that the file tells."""

NOTHING_ELSE: Mapping[str, str] = {}


def onnx_model(
    network: Architecture, weights: Mapping[str, F32], half: bool = True, about: Mapping[str, str] = NOTHING_ELSE
) -> Any:
    """Return a network as an ONNX model: `image` (1, 3, H, W), normalised, to `logits` (1, classes, h, w).

    The scores lie at a fourth of the image's size. Batch norms are folded into the convolutions; the auxiliary head is
    left out.

    Args:
        network: The steps.
        weights: By name.
        half: Whether weights are stored as 16-bit numbers.
        about: What is written into the file beside the network.

    Raises:
        WeightsError: A weight is absent.
    """
    absent = [name for name in network.shapes(auxiliary=False) if name not in weights]
    if absent:
        raise WeightsError(f"the network's weights lack '{absent[0]}'")
    network, weights = slim(network, weights)
    graph, names = written(network, weights, half)
    size = graph.size(names[LOGITS])
    times = network.stride // OUTPUT_STRIDE
    if network.corners:
        size = graph.add("Sub", [size, graph.numbers([1], np.int64)])
    size = graph.add("Mul", [size, graph.numbers([times], np.int64)])
    if network.corners:
        size = graph.add("Add", [size, graph.numbers([1], np.int64)])
    graph.resized(names[LOGITS], size, network.corners, LOGITS)
    *_, last = (conv for conv in network.convolutions if conv.to == LOGITS)
    return graph.model(IMAGE, {LOGITS: last.channels[1]}, network.about() | dict(about))


def write_onnx(
    path: Path,
    network: Architecture,
    weights: Mapping[str, F32],
    half: bool = True,
    about: Mapping[str, str] = NOTHING_ELSE,
) -> None:
    """Write a network as an ONNX file, after a check that it is one.

    Raises:
        WeightsError: A weight is absent, or the file cannot be written.
    """
    import onnx

    model = onnx_model(network, weights, half, about)
    onnx.checker.check_model(model, full_check=True)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_name(path.name + ".part")
        part.write_bytes(model.SerializeToString(deterministic=True))
        part.replace(path)
    except OSError as error:
        raise WeightsError(f"{path}: cannot be written ({error.strerror or error})") from error


def written(network: Architecture, weights: Mapping[str, F32], half: bool) -> tuple[Graph, dict[str, str]]:
    """Return a graph of all steps but the auxiliary head's, and under which name each step's value goes there."""
    graph = Graph(half)
    names = {IMAGE: IMAGE}
    for step in network.steps:
        if not step.to.startswith(AUXILIARY):
            names[step.to] = _step_written(graph, step, names, weights)
    return graph, names


def _step_written(graph: Graph, step: Step, names: Mapping[str, str], weights: Mapping[str, F32]) -> str:
    match step:
        case Conv():
            return _convolution(graph, step, names, weights)
        case MaxPool():
            return graph.add("MaxPool", [names[step.source]], kernel_shape=[3, 3], strides=[2, 2], pads=[1, 1, 1, 1])
        case Pyramid():
            return graph.pooled(names[step.source], step.bins)
        case Enlarge():
            return graph.enlarged(names[step.source], names[step.like])
        case Concat():
            return graph.add("Concat", [names[source] for source in step.sources], axis=1)
        case Add():
            return graph.add("Sum", [names[source] for source in step.sources])
        case Drop():
            return names[step.source]


def _convolution(graph: Graph, conv: Conv, names: Mapping[str, str], weights: Mapping[str, F32]) -> str:
    weight, bias = _folded(conv, weights)
    inputs = [names[conv.source], graph.weight(f"{conv.name}.weight", weight), graph.weight(f"{conv.name}.bias", bias)]
    value = graph.add(
        "Conv", inputs, kernel_shape=[conv.kernel] * 2, strides=[conv.stride] * 2, dilations=[conv.dilation] * 2,
        pads=[conv.padding] * 4, group=conv.groups,
    )  # fmt: skip
    if conv.plus:
        value = graph.add("Add", [value, names[conv.plus]])
    if conv.activation == RELU6:
        return graph.add("Clip", [value, graph.numbers(0.0, np.float32), graph.numbers(6.0, np.float32)])
    return graph.add("Relu", [value]) if conv.activation else value


def _folded(conv: Conv, weights: Mapping[str, F32]) -> tuple[F32, F32]:
    """Return a convolution's weights and bias with its batch norm in them."""
    weight = weights[f"{conv.name}.weight"]
    bias = weights[f"{conv.name}.bias"] if conv.bias else np.zeros(conv.channels[1], dtype=np.float32)
    if not conv.norm:
        return weight, bias
    gain, shift, mean, variance = (
        weights[f"{conv.norm}.{key}"].astype(np.float64) for key in ("weight", "bias", "running_mean", "running_var")
    )
    scale = gain / np.sqrt(variance + NORM_EPSILON)
    folded = weight * scale[:, None, None, None]
    return folded.astype(np.float32), ((bias - mean) * scale + shift).astype(np.float32)
