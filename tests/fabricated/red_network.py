"""A segmentation network of one layer: what is redder than it is green is a person. And people for it to find."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from stillroom.data.image import Image
from stillroom.semantics.masks.onnx_masks import OnnxMasksConfig

CLASSES = ("background", "person", "dog")
LEAST_REDNESS = 0.2
"""Red less green of a pixel, in colours from −1 to 1, from which it is a person's; it is a dog's when blue by that."""


def save_red_network(
    path: Path,
    *,
    channels_last: bool = False,
    output: str = "logits",
    size: tuple[Any, Any] = ("h", "w"),
    input_type: int = TensorProto.FLOAT,
    colors: int = 3,
) -> Path:
    """Write the network; its output is "logits", "probabilities", or the "labels" of the best classes."""
    # Logits 0, 20 (R − G − least), 20 (B − G − least): by how much a pixel is of each class.
    weight = np.zeros((3, colors, 1, 1), np.float32)
    weight[1, :2, 0, 0] = 20, -20
    if colors > 2:
        weight[2, 1:3, 0, 0] = -20, 20
    bias = np.array([0, -20 * LEAST_REDNESS, -20 * LEAST_REDNESS], np.float32)
    shape = [1, *size, colors] if channels_last else [1, colors, *size]
    nodes = [helper.make_node("Cast", ["image"], ["cast"], to=TensorProto.FLOAT)]
    first = "cast"
    if channels_last:
        nodes.append(helper.make_node("Transpose", ["cast"], ["turned"], perm=[0, 3, 1, 2]))
        first = "turned"
    nodes.append(helper.make_node("Conv", [first, "weight", "bias"], ["scores"]))
    out_type, out_shape = TensorProto.FLOAT, [1, 3, None, None]
    if output == "labels":
        nodes.append(helper.make_node("ArgMax", ["scores"], ["answer"], axis=1, keepdims=0))
        out_type, out_shape = TensorProto.INT64, [1, None, None]
    elif output == "probabilities":
        nodes.append(helper.make_node("Softmax", ["scores"], ["answer"], axis=1))
    elif channels_last:
        nodes.append(helper.make_node("Transpose", ["scores"], ["answer"], perm=[0, 2, 3, 1]))
        out_shape = [1, None, None, 3]
    else:
        nodes.append(helper.make_node("Identity", ["scores"], ["answer"]))
    graph = helper.make_graph(
        nodes,
        "red",
        [helper.make_tensor_value_info("image", input_type, shape)],
        [helper.make_tensor_value_info("answer", out_type, out_shape)],
        [numpy_helper.from_array(weight, "weight"), numpy_helper.from_array(bias, "bias")],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    onnx.checker.check_model(model)
    onnx.save(model, str(path))
    return path


def red_config(model: Path, **options: Any) -> OnnxMasksConfig:
    """Return a config for the network; masks are not grown, so that they can be compared with true ones."""
    config = OnnxMasksConfig(model, CLASSES, **({"longer_side_px": 320, "step_px": 1, "offset_px": 0} | options))
    return replace(config, regions=replace(config.regions, dilate_px=0))


def reddened(image: Image) -> Image:
    """Return a rendered image in gray with its people in red, darker or brighter as they were."""
    gray = np.repeat(image.gray[..., None], 3, axis=2)
    people = image.truth.mask
    gray[people] = (0.5 * gray[people] + np.array([120, 0, 0])).astype(np.uint8)
    return replace(image, rgb=gray)
