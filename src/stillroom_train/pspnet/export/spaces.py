"""Channels that can only be pruned together: their producers, their consumers, and the work of each."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

from stillroom_train.pspnet.networks.steps import (
    AUXILIARY,
    IMAGE,
    LOGITS,
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

DEPTHWISE = 4.0
"""A multiplication of a depthwise convolution takes as long as four others: it is memory-bound (onnxruntime, AVX2)."""


@dataclass(frozen=True)
class Space:
    """Channels of one or several values between convolutions that mix channels.

    Attributes:
        value: Name of the value that is read.
        channels: How many there are.
        makers: Names of the convolutions that make them.
        depthwise: Names of the convolutions that keep them apart.
        readers: Names of the 1×1 convolutions that read the value, or means of it.
        work: Multiplications that one channel costs, per pixel of the image.
    """

    value: str
    channels: int
    makers: tuple[str, ...]
    depthwise: tuple[str, ...]
    readers: tuple[str, ...]
    work: float


def spaces(network: Architecture) -> list[Space]:
    """Return the spaces of which channels can be left out: all 1×1 convolutions that leave one read one value of it."""
    root = _roots(network)
    work = work_of(network)
    found = []
    for name in dict.fromkeys(root[conv.to] for conv in network.convolutions):
        inside = {value for value, of in root.items() if of == name}
        if inside & {IMAGE, LOGITS, AUXILIARY} or _is_put_beside(network, inside):
            continue
        space = _space(network, inside, work)
        if space is not None:
            found.append(space)
    # Weights of which several spaces are made (the projection of each level of a pyramid) belong to none alone.
    made = Counter(name for space in found for name in space.makers)
    return [space for space in found if all(made[name] == 1 for name in space.makers)]


def work_of(network: Architecture) -> dict[str, float]:
    """Return how much work each convolution is, by the name of the value that it makes [multiplications per pixel]."""
    area = {IMAGE: 1.0}
    work = {}
    for step in network.steps:
        match step:
            case Conv():
                area[step.to] = area[step.source] / step.stride**2
                each = DEPTHWISE if step.groups > 1 else step.channels[0]
                work[step.to] = area[step.to] * step.kernel**2 * each * step.channels[1]
            case Enlarge():
                area[step.to] = area[step.like]
            case Pyramid():
                area[step.to] = 0.0
            case Add() | Concat():
                area[step.to] = area[step.sources[0]]
            case MaxPool():
                area[step.to] = area[step.source] / 4.0
            case Drop():
                area[step.to] = area[step.source]
    return work


def _space(network: Architecture, inside: set[str], work: dict[str, float]) -> Space | None:
    pooled_from = {step.to: step.source for step in network.steps if isinstance(step, Pyramid)}
    makers = [conv for conv in network.convolutions if conv.to in inside and conv.groups == 1]
    depthwise = [conv for conv in network.convolutions if conv.to in inside and conv.groups > 1]
    readers = [conv for conv in network.convolutions if conv.source in inside and conv.groups == 1]
    read = {pooled_from.get(conv.source, conv.source) for conv in readers}
    fit = all(conv.kernel == 1 and conv.bias and not conv.norm for conv in readers)
    if len(read) != 1 or not fit or any(conv.norm for conv in makers + depthwise):
        return None
    channels = makers[0].channels[1]
    total = sum(work[conv.to] for conv in makers + depthwise + readers)
    return Space(read.pop(), channels, _names(makers), _names(depthwise), _names(readers), total / channels)


def _names(convolutions: list[Conv]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(conv.name for conv in convolutions))


def _roots(network: Architecture) -> dict[str, str]:
    """Return for each value the name of one value whose channels are the same ones."""
    parent: dict[str, str] = {IMAGE: IMAGE}

    def root(value: str) -> str:
        while parent.setdefault(value, value) != value:
            value = parent[value]
        return value

    for step in network.steps:
        for value in _kept_apart(step):
            parent[root(value)] = root(step.to)
        root(step.to)
    return {value: root(value) for value in parent}


def _kept_apart(step: Step) -> Iterator[str]:
    """Yield the values whose channels a step keeps apart."""
    match step:
        case Conv():
            if step.groups > 1:
                yield step.source
            if step.plus:
                yield step.plus
        case Add():
            yield from step.sources
        case Pyramid() | Enlarge() | MaxPool() | Drop():
            yield step.source
        case Concat():
            return


def _is_put_beside(network: Architecture, inside: set[str]) -> bool:
    return any(inside & {*step.sources, step.to} for step in network.steps if isinstance(step, Concat))
