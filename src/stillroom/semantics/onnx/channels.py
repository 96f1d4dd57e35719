"""Convolutions of few channels, given as many as one vector register holds: onnxruntime is much faster so.

onnxruntime keeps the channels of a block beside each other, as many as a register holds. Images with fewer of them are
taken out of that order before each convolution and put back after it. Channels of zeros cost less, and change nothing
but the last digits.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import llvmlite.binding as llvm
import numpy as np

from stillroom.geometry.arrays import I64

_Groups = list[tuple[Any, int]]
"""Attributes that say how many groups of channels a convolution has, and how many it will have."""
WIDE, NARROW = 16, 8
"""Channels of a block, with registers of 512 bits and without."""
KEEPS_CHANNELS = {"LeakyRelu", "MaxPool", "Resize", "Identity", "Relu", "Clip", "Sigmoid"}


@dataclass(frozen=True)
class _Place:
    """Where the channels of an image (C, h, w) lie in a wider one.

    Attributes:
        at: The place of each (C,).
        n: Channels of the wider one.
    """

    at: I64
    n: int


def channels_of_a_block() -> int:
    """Return how many channels onnxruntime keeps together on this machine."""
    return WIDE if llvm.get_host_cpu_features().get("avx512f", False) else NARROW


def widen(model: Any, least: int) -> None:
    """Give the images between the convolutions of a network `least` channels, where they have fewer.

    Args:
        model: An ONNX model, changed in place; it stays as it is where it has steps that are not known here.
        least: The number of channels.
    """
    graph = model.graph
    constants = {constant.name: constant for constant in graph.initializer}
    places = {value.name: _wide(value.type.tensor_type.shape.dim[1].dim_value, 0) for value in graph.input}
    makers = {name: node for node in graph.node for name in node.output}
    ends = {_convolution_of(makers, output.name) for output in graph.output}
    changed: dict[str, Any] = {}
    groups: _Groups = []
    for node in graph.node:
        known = [places[name] for name in node.input if name in places]
        if node.op_type == "Conv" and len(node.input) == 3 and known:
            weights, bias = (_array(constants[name]) for name in node.input[1:])
            group = next((attribute for attribute in node.attribute if attribute.name == "group"), None)
            if node.input[1] in changed:
                return  # weights that two steps share
            if group is None or group.i == 1:
                columns, place = known[0], _wide(len(weights), 0 if node.output[0] in ends else least)
            elif group.i == len(weights):
                columns, place = None, known[0]
                groups.append((group, place.n))
            else:
                return
            changed[node.input[1]], changed[node.input[2]] = _spread(weights, place, columns), _spread(bias, place)
        elif node.op_type == "Concat" and len(known) == len(node.input):
            place = _beside(known)
        elif known and (node.op_type in KEEPS_CHANNELS or (node.op_type == "Add" and _agree(known))):
            place = known[0]
        else:
            return
        places[node.output[0]] = place
    _change(graph, constants, changed, groups)


def _change(graph: Any, constants: Mapping[str, Any], changed: Mapping[str, Any], groups: _Groups) -> None:
    """Put the wider weights into the network; what it says of the sizes in between is no longer true."""
    import onnx

    for name, array in changed.items():
        constants[name].CopyFrom(onnx.numpy_helper.from_array(array, name))
    for group, n in groups:
        group.i = n
    del graph.value_info[:]


def _array(constant: Any) -> np.ndarray:
    import onnx

    return np.asarray(onnx.numpy_helper.to_array(constant))


def _convolution_of(makers: Mapping[str, Any], name: str) -> str:
    """Return the output of the convolution that makes an output of the network."""
    while name in makers and makers[name].op_type != "Conv":
        name = makers[name].input[0]
    return name


def _wide(n: int, least: int) -> _Place:
    """Return the place of `n` channels at the beginning of at least `least`."""
    return _Place(np.arange(n), max(n, least))


def _beside(places: list[_Place]) -> _Place:
    """Return where the channels of images lie when these are put one after the other."""
    starts = np.cumsum([0] + [place.n for place in places])
    return _Place(np.concatenate([place.at + start for place, start in zip(places, starts, strict=False)]), starts[-1])


def _agree(places: list[_Place]) -> bool:
    """Return whether two images have their channels at the same places."""
    first, *others = places
    return len(others) == 1 and first.n == others[0].n and np.array_equal(first.at, others[0].at)


def _spread(array: np.ndarray, rows: _Place, columns: _Place | None = None) -> np.ndarray:
    """Return weights (M, C, …) or a bias (M,) with their rows, and their columns, at other places, zeros between."""
    if columns is not None:
        wider = np.zeros((len(array), columns.n, *array.shape[2:]), dtype=array.dtype)
        wider[:, columns.at] = array
        array = wider
    spread = np.zeros((rows.n, *array.shape[1:]), dtype=array.dtype)
    spread[rows.at] = array
    return spread
