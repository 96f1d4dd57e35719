"""The layers of a darknet network, without weights."""

from dataclasses import dataclass
from typing import TypeAlias

ACTIVATIONS = ("linear", "leaky", "relu", "relu6", "logistic")


@dataclass(frozen=True)
class Convolution:
    """A convolution over `channels` inputs; `padding` [px] on each side."""

    channels: int
    filters: int
    size: int
    stride: int
    padding: int
    groups: int
    batch_normalize: bool
    activation: str


@dataclass(frozen=True)
class Maxpool:
    """A maximum over windows; `padding` is the total of both sides, the odd one on the right."""

    size: int
    stride: int
    padding: int


@dataclass(frozen=True)
class Route:
    """The outputs of other layers, one after the other along the channels."""

    sources: tuple[int, ...]


@dataclass(frozen=True)
class Shortcut:
    """The sum of the layer before and another one."""

    source: int
    activation: str


@dataclass(frozen=True)
class Upsample:
    """Each pixel `stride` times in both directions."""

    stride: int


@dataclass(frozen=True)
class Dropout:
    """Nothing: it matters in training only."""


@dataclass(frozen=True)
class YoloHead:
    """Boxes: for each cell and anchor x, y, w, h, objectness, then the classes.

    Attributes:
        anchors_px: Width and height of its anchors (A, 2) [px of the network's input].
        classes: Number of classes.
        scale_xy: How far a centre may leave its cell; 1 is not at all.
    """

    anchors_px: tuple[tuple[float, float], ...]
    classes: int
    scale_xy: float


Layer: TypeAlias = Convolution | Maxpool | Route | Shortcut | Upsample | Dropout | YoloHead
Shape: TypeAlias = tuple[int, int, int]


@dataclass(frozen=True)
class Network:
    """A darknet cfg: what is computed, without the numbers.

    Attributes:
        input_shape: Channels, height, width.
        layers: In darknet's order; `route` and `shortcut` name others by their index.
        shapes: Channels, height, width that each layer puts out.
    """

    input_shape: Shape
    layers: tuple[Layer, ...]
    shapes: tuple[Shape, ...]

    @property
    def heads(self) -> tuple[YoloHead, ...]:
        """Its yolo layers, in order."""
        return tuple(layer for layer in self.layers if isinstance(layer, YoloHead))

    @property
    def head_shapes(self) -> tuple[Shape, ...]:
        """Channels, height, width of its yolo layers, in order."""
        pairs = zip(self.layers, self.shapes, strict=True)
        return tuple(shape for layer, shape in pairs if isinstance(layer, YoloHead))
