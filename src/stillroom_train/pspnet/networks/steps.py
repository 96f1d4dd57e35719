"""What a network consists of: a list of steps from image to scores.

One list is read twice, by torch for training and by the writer of ONNX files, so that the two cannot differ; and names
and shapes of all weights are known without either.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TypeAlias

IMAGE, LOGITS, AUXILIARY = "image", "logits", "auxiliary"
"""Names of the values that every network begins and ends with."""

RELU, RELU6 = "relu", "relu6"


@dataclass(frozen=True)
class Conv:
    """A convolution, and what follows it at once: batch norm, another value added, an activation.

    Padding keeps the size: dilation × (kernel − 1) / 2.

    Attributes:
        name: Of its weights: `<name>.weight` (out, in / groups, kernel, kernel), `<name>.bias`.
        source, to: Names of the values that it reads and makes.
        channels: In and out.
        kernel, stride, dilation, groups: As everywhere.
        norm: Name of the batch norm's weights; empty where there is none.
        bias: Whether it has one.
        plus: Name of a value that is added before the activation; empty for none.
        activation: "relu", "relu6", or empty.
    """

    name: str
    source: str
    to: str
    channels: tuple[int, int]
    kernel: int = 1
    stride: int = 1
    dilation: int = 1
    groups: int = 1
    norm: str = ""
    bias: bool = True
    plus: str = ""
    activation: str = ""

    @property
    def padding(self) -> int:
        """Pixels of zeros around its input."""
        return self.dilation * (self.kernel - 1) // 2

    @property
    def weight_shape(self) -> tuple[int, int, int, int]:
        """Shape of its weights."""
        return self.channels[1], self.channels[0] // self.groups, self.kernel, self.kernel


@dataclass(frozen=True)
class MaxPool:
    """The largest of 3×3 pixels, every second pixel."""

    source: str
    to: str


@dataclass(frozen=True)
class Pyramid:
    """Mean over each of bins × bins parts of the image (the pyramid's levels)."""

    source: str
    to: str
    bins: int


@dataclass(frozen=True)
class Enlarge:
    """Bilinear enlargement of a pyramid's level to the size of another value; parts lie between their borders."""

    source: str
    like: str
    to: str


@dataclass(frozen=True)
class Concat:
    """Values one after another along the channels."""

    sources: tuple[str, ...]
    to: str


@dataclass(frozen=True)
class Add:
    """The sum of values of one shape."""

    sources: tuple[str, ...]
    to: str


@dataclass(frozen=True)
class Drop:
    """Whole channels left out at random while training."""

    source: str
    to: str
    rate: float


Step: TypeAlias = Conv | MaxPool | Pyramid | Enlarge | Concat | Add | Drop


@dataclass(frozen=True)
class Architecture:
    """A segmentation network.

    Attributes:
        name: As on the command line.
        steps: From "image" to "logits" (all classes, at 1 / stride of the size) and "auxiliary", used only in training.
        stride: Image pixels per pixel of the scores.
        corners: Whether its first and last pixel lie on the image's, as with input sides of stride × k + 1; otherwise
            its pixels are parts of stride × stride image pixels.
        mean, std: Subtracted from RGB in 0–255, and divided by.
    """

    name: str
    steps: tuple[Step, ...]
    stride: int
    corners: bool
    mean: tuple[float, float, float]
    std: tuple[float, float, float]

    @property
    def convolutions(self) -> Iterator[Conv]:
        """All convolutions in order."""
        return (step for step in self.steps if isinstance(step, Conv))

    def shapes(self, auxiliary: bool = True) -> dict[str, tuple[int, ...]]:
        """Return the shape of each weight by name, as torch names them.

        Args:
            auxiliary: Whether those that only training uses are wanted, too.
        """
        found: dict[str, tuple[int, ...]] = {}
        for conv in self.convolutions:
            if conv.name.startswith(AUXILIARY) and not auxiliary:
                continue
            found[f"{conv.name}.weight"] = conv.weight_shape
            if conv.bias:
                found[f"{conv.name}.bias"] = (conv.channels[1],)
            if conv.norm:
                of_norm = ("weight", "bias", "running_mean", "running_var")
                found |= {f"{conv.norm}.{key}": (conv.channels[1],) for key in of_norm}
        return found

    def about(self) -> dict[str, str]:
        """Return what a file says of the network: how its pixels lie, and what its input is."""
        return {
            "architecture": self.name,
            "stride": str(self.stride),
            "corners": "1" if self.corners else "0",
            "mean": " ".join(map(str, self.mean)),
            "std": " ".join(map(str, self.std)),
        }
