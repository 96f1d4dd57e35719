"""Read darknet's cfg: a text with one section a layer."""

import math
from dataclasses import dataclass
from pathlib import Path

from stillroom.errors import WeightsError
from stillroom_train.darknet.network import (
    ACTIVATIONS,
    Convolution,
    Dropout,
    Layer,
    Maxpool,
    Network,
    Route,
    Shape,
    Shortcut,
    Upsample,
    YoloHead,
)

SUPPORTED = "convolutional, maxpool, route, shortcut, upsample, dropout, yolo"


@dataclass(frozen=True)
class _Section:
    """One `[name]` of a cfg with its `key=value` lines, and where it stands."""

    name: str
    options: dict[str, str]
    where: str

    def number(self, key: str, default: int | None = None, least: int = 0) -> int:
        """Return the whole number of a key; the default where the key is absent."""
        text = self.options.get(key, "" if default is None else str(default))
        try:
            number = int(text)
        except ValueError:
            said = f"is '{text}', not a whole number" if text else "is missing"
            raise WeightsError(f"{self.where}: [{self.name}] {key} {said}; is this a darknet cfg?") from None
        if number < least:
            raise WeightsError(f"{self.where}: [{self.name}] {key} is {number}; it must be at least {least}")
        return number

    def numbers(self, key: str) -> list[float]:
        """Return the comma-separated numbers of a key."""
        try:
            numbers = [float(word) for word in self.options.get(key, "").split(",")]
        except ValueError:
            numbers = [math.nan]
        if not all(map(math.isfinite, numbers)):
            raise WeightsError(f"{self.where}: [{self.name}] {key} is not a list of numbers")
        return numbers

    def allow_only(self, *known: str) -> None:
        """Refuse unknown options, which could change the result."""
        for key in self.options:
            if key not in known:
                raise WeightsError(f"{self.where}: [{self.name}] option '{key}' is not supported")


def read_cfg(path: Path) -> Network:
    """Read a darknet cfg.

    Raises:
        WeightsError: The file is missing or empty, is no detector, or has a layer, option or value that is not
            supported.
    """
    sections = _read_sections(path)
    net = sections[0]
    if net.name not in {"net", "network"}:
        raise WeightsError(f"{net.where}: begins with [{net.name}], not with [net]; is this a darknet cfg?")
    input_shape = (net.number("channels", 3, least=1), net.number("height", least=1), net.number("width", least=1))
    layers: list[Layer] = []
    shapes: list[Shape] = []
    for section in sections[1:]:
        layer = _read_layer(section, shapes, input_shape)
        shapes.append(_shape_after(layer, shapes, input_shape, section))
        layers.append(layer)
    network = Network(input_shape, tuple(layers), tuple(shapes))
    if not network.heads or not isinstance(layers[0], Convolution):
        raise WeightsError(f"{path}: a detector begins with a [convolutional] layer and has a [yolo] layer")
    _check_heads(network, path)
    return network


def read_bytes(path: Path) -> bytes:
    """Return the content of a network's file.

    Raises:
        WeightsError: It cannot be read.
    """
    try:
        return path.read_bytes()
    except OSError as error:
        reason = error.strerror or "cannot be read"
        raise WeightsError(f"{path}: {reason}") from None


def _check_heads(network: Network, path: Path) -> None:
    """Check that each head has a convolution of its own, which can be reduced to the wanted classes."""
    read = {layer.source for layer in network.layers if isinstance(layer, Shortcut)}
    read.update(*(layer.sources for layer in network.layers if isinstance(layer, Route)))
    for index, layer in enumerate(network.layers):
        if not isinstance(layer, YoloHead):
            continue
        before = network.layers[index - 1]
        if not isinstance(before, Convolution) or {index - 1, index} & read:
            raise WeightsError(f"{path}: layer {index} [yolo] has no [convolutional] of its own before it")
        if len(layer.anchors_px) % before.groups:
            anchors, groups = len(layer.anchors_px), before.groups
            raise WeightsError(f"{path}: layer {index} [yolo]: {anchors} anchors do not go in {groups} groups")


def _read_sections(path: Path) -> list[_Section]:
    sections: list[_Section] = []
    text = read_bytes(path).decode("utf-8", errors="replace")
    for number, raw in enumerate(text.splitlines(), start=1):
        line = raw.split("#")[0].split(";")[0].strip()
        if line.startswith("["):
            sections.append(_Section(line.strip("[] "), {}, f"{path}:{number}"))
        elif line:
            key, equals, value = (part.strip() for part in line.partition("="))
            if not equals or not sections:
                raise WeightsError(f"{path}:{number}: '{line[:40]}' is no 'key=value'; is this a darknet cfg?")
            sections[-1].options[key] = value
    if not sections:
        raise WeightsError(f"{path}: empty; expected a darknet cfg")
    return sections


def _read_layer(section: _Section, shapes: list[Shape], input_shape: Shape) -> Layer:
    match section.name:
        case "convolutional" | "conv":
            return _read_convolution(section, (shapes[-1] if shapes else input_shape)[0])
        case "maxpool":
            section.allow_only("size", "stride", "padding")
            stride = section.number("stride", 1, least=1)
            size = section.number("size", stride, least=1)
            return Maxpool(size, stride, section.number("padding", size - 1))
        case "route":
            section.allow_only("layers")
            return Route(tuple(_index(section, number, len(shapes)) for number in section.numbers("layers")))
        case "shortcut":
            section.allow_only("from", "activation")
            source = _index(section, section.number("from", least=-len(shapes)), len(shapes))
            return Shortcut(source, _activation(section, "linear"))
        case "upsample":
            section.allow_only("stride")
            return Upsample(section.number("stride", 2, least=1))
        case "dropout":
            return Dropout()
        case "yolo":
            return _read_head(section)
    raise WeightsError(f"{section.where}: layer [{section.name}] is not supported; known are {SUPPORTED}")


def _read_convolution(section: _Section, channels: int) -> Convolution:
    section.allow_only("batch_normalize", "filters", "size", "stride", "pad", "padding", "groups", "activation")
    size, groups = section.number("size", 1, least=1), section.number("groups", 1, least=1)
    # darknet: `pad` is a switch that keeps the image's size; `padding` is a number.
    padding = size // 2 if section.number("pad", 0) else section.number("padding", 0)
    filters = section.number("filters", 1)
    if channels % groups or filters % groups:
        raise WeightsError(f"{section.where}: {channels} channels to {filters} filters do not go in {groups} groups")
    return Convolution(
        channels,
        filters,
        size,
        section.number("stride", 1, least=1),
        padding,
        groups,
        bool(section.number("batch_normalize", 0)),
        _activation(section, "logistic"),
    )


def _read_head(section: _Section) -> YoloHead:
    sides = section.numbers("anchors")
    pairs = list(zip(sides[0::2], sides[1::2], strict=False))
    mask = [int(number) for number in section.numbers("mask")]
    if len(sides) % 2 or not all(0 <= index < len(pairs) for index in mask):
        raise WeightsError(f"{section.where}: [yolo] mask {mask} does not fit its {len(sides)} anchor numbers")
    if section.number("new_coords", 0):
        raise WeightsError(f"{section.where}: [yolo] option 'new_coords' is not supported")
    scale = section.numbers("scale_x_y")[0] if "scale_x_y" in section.options else 1.0
    return YoloHead(tuple(pairs[index] for index in mask), section.number("classes", 20), scale)


def _activation(section: _Section, default: str) -> str:
    name = section.options.get("activation", default)
    if name not in ACTIVATIONS:
        raise WeightsError(f"{section.where}: activation '{name}' is not supported; known are {', '.join(ACTIVATIONS)}")
    return name


def _index(section: _Section, number: float, here: int) -> int:
    """Turn a layer's number, negative ones counted back from here, into its index."""
    index = int(number) + here if number < 0 else int(number)
    if not 0 <= index < here:
        raise WeightsError(f"{section.where}: [{section.name}] names layer {int(number)}, which is not before it")
    return index


def _shape_after(layer: Layer, shapes: list[Shape], input_shape: Shape, section: _Section) -> Shape:
    channels, height, width = shapes[-1] if shapes else input_shape
    wrong = ""
    match layer:
        case Convolution(size=size, stride=stride, padding=padding):
            channels = layer.filters
            height, width = ((side + 2 * padding - size) // stride + 1 for side in (height, width))
        case Maxpool(size=size, stride=stride, padding=padding):
            height, width = ((side + padding - size) // stride + 1 for side in (height, width))
        case Upsample(stride=stride):
            height, width = height * stride, width * stride
        case Route(sources=sources):
            joined = [shapes[source] for source in sources]
            channels, height, width = sum(shape[0] for shape in joined), *joined[0][1:]
            if any(shape[1:] != (height, width) for shape in joined):
                wrong = f"joins layers of different sizes {joined}"
        case Shortcut(source=source) if shapes[source] != (channels, height, width):
            wrong = f"adds {shapes[source]} to {(channels, height, width)}"
        case YoloHead(anchors_px=anchors, classes=classes) if channels != len(anchors) * (classes + 5):
            wrong = f"of {len(anchors)} anchors and {classes} classes does not fit {channels} channels"
    if min(channels, height, width) < 1:
        wrong = "leaves an image of no size"
    if wrong:
        raise WeightsError(f"{section.where}: [{section.name}] {wrong}")
    return channels, height, width
