"""A detection network that says the same of every image: its outputs are constants."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper


def save_constant_detector(
    path: Path,
    outputs: Mapping[str, Any],
    *,
    shape: Sequence[Any] = (1, 3, 96, 128),
    input_type: int = TensorProto.FLOAT,
    says_shapes: bool = True,
) -> Path:
    """Write the network.

    Args:
        path: The file.
        outputs: Arrays by name, in order.
        shape: Of its input; a name is an open axis.
        input_type: Of its input.
        says_shapes: Whether the file tells the outputs' shapes, or only how many axes they have.
    """
    nodes, infos, constants = [], [], []
    for name, value in outputs.items():
        array = np.asarray(value)
        constants.append(numpy_helper.from_array(array, f"{name}_value"))
        nodes.append(helper.make_node("Identity", [f"{name}_value"], [name]))
        said = array.shape if says_shapes else [f"{name}_{axis}" for axis in range(array.ndim)]
        infos.append(helper.make_tensor_value_info(name, helper.np_dtype_to_tensor_dtype(array.dtype), said))
    image = helper.make_tensor_value_info("image", input_type, list(shape))
    graph = helper.make_graph(nodes, "constant", [image], infos, constants)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    onnx.checker.check_model(model)
    onnx.save(model, str(path))
    return path
