"""A network as torch trains it."""

import functools
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from stillroom.errors import MissingExtraError
from stillroom.geometry.arrays import F32
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

if TYPE_CHECKING:
    from torch import Tensor
    from torch.nn import Module

LABEL_STRIDE = 4
"""Image pixels per pixel of the scores that are compared with labels, and of those that an ONNX file tells."""


def torch_or_error() -> Any:
    """Return torch.

    Raises:
        MissingExtraError: It is not installed.
    """
    try:
        import torch
    except ImportError as error:
        raise MissingExtraError("torch", "train") from error
    return torch


def torch_network(architecture: Architecture) -> "Module":
    """Return a network with random weights, whose state has the names of `Architecture.shapes`.

    Called with images (N, 3, H, W), normalised, it returns the scores of all classes at 1 / stride of their size: of
    the network, and of the auxiliary head, which is None while evaluating.
    """
    network: Module = _network_class()(architecture)
    return network


def enlarged(scores: "Tensor", architecture: Architecture, stride: int = LABEL_STRIDE) -> "Tensor":
    """Return scores at 1 / `stride` of the image's size."""
    torch = torch_or_error()
    times = architecture.stride // stride
    size = [(side - 1) * times + 1 if architecture.corners else side * times for side in scores.shape[2:]]
    large: Tensor = torch.nn.functional.interpolate(scores, size, mode="bilinear", align_corners=architecture.corners)
    return large


def arrays(network: "Module") -> dict[str, F32]:
    """Return the weights by name, without the counters that batch norms keep."""
    state: Mapping[str, Any] = network.state_dict()
    return {
        name: value.detach().cpu().numpy() for name, value in state.items() if not name.endswith("num_batches_tracked")
    }


@functools.cache
def _network_class() -> Any:
    torch = torch_or_error()

    class Network(torch.nn.Module):  # type: ignore[misc, name-defined]
        def __init__(self, architecture: Architecture) -> None:
            super().__init__()
            self._steps = architecture.steps
            self._parts: dict[str, Any] = {}
            for conv in architecture.convolutions:
                self._parts[conv.name] = _placed(self, conv.name, _convolution(conv))
                if conv.norm:
                    self._parts[conv.norm] = _placed(self, conv.norm, torch.nn.BatchNorm2d(conv.channels[1]))

        def forward(self, image: Any) -> tuple[Any, Any]:
            values = {IMAGE: image}
            for step in self._steps:
                if step.to.startswith(AUXILIARY) and not self.training:
                    continue
                values[step.to] = _taken(step, values, self._parts, self.training)
            return values[LOGITS], values.get(AUXILIARY)

    return Network


def _convolution(conv: Conv) -> Any:
    torch = torch_or_error()
    made = torch.nn.Conv2d(
        *conv.channels, conv.kernel, conv.stride, conv.padding, conv.dilation, conv.groups, bias=conv.bias
    )
    torch.nn.init.kaiming_normal_(made.weight, mode="fan_in" if conv.groups > 1 else "fan_out", nonlinearity="relu")
    if conv.to in (LOGITS, AUXILIARY):
        # A classifier that says nothing yet leaves a trained backbone in peace at first.
        torch.nn.init.zeros_(made.weight)
    if conv.bias:
        torch.nn.init.zeros_(made.bias)
    return made


def _placed(network: Any, name: str, part: Any) -> Any:
    """Put a part where its dotted name says, making what lies on the way."""
    torch = torch_or_error()
    *way, last = name.split(".")
    place = network
    for word in way:
        if word not in dict(place.named_children()):
            place.add_module(word, torch.nn.Module())
        place = getattr(place, word)
    place.add_module(last, part)
    return part


def _taken(step: Step, values: dict[str, Any], parts: dict[str, Any], training: bool) -> Any:
    """Return what a step makes."""
    functional = torch_or_error().nn.functional
    match step:
        case Conv():
            return _convolved(step, values, parts)
        case MaxPool():
            return functional.max_pool2d(values[step.source], 3, stride=2, padding=1)
        case Pyramid():
            return functional.adaptive_avg_pool2d(values[step.source], step.bins)
        case Enlarge():
            size = values[step.like].shape[2:]
            return functional.interpolate(values[step.source], size, mode="bilinear", align_corners=False)
        case Concat():
            return torch_or_error().cat([values[name] for name in step.sources], dim=1)
        case Add():
            return sum(values[name] for name in step.sources)
        case Drop():
            return functional.dropout2d(values[step.source], step.rate, training)


def _convolved(conv: Conv, values: dict[str, Any], parts: dict[str, Any]) -> Any:
    functional = torch_or_error().nn.functional
    value = parts[conv.name](values[conv.source])
    if conv.norm:
        value = parts[conv.norm](value)
    if conv.plus:
        value = value + values[conv.plus]
    if conv.activation == RELU6:
        return functional.relu6(value, inplace=True)
    return functional.relu(value, inplace=True) if conv.activation else value
