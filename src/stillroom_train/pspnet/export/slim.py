"""Exact simplifications of a network: convolutions that can be removed without changing its output."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from stillroom.geometry.arrays import F32, Bool
from stillroom_train.pspnet.networks.steps import RELU6, Architecture, Conv, Enlarge, Pyramid, Step

Slimmed = tuple[Architecture, dict[str, F32]]


def slim(network: Architecture, weights: Mapping[str, F32]) -> Slimmed:
    """Return a network with the same output, and its weights."""
    return _project_late(*_without_idle_channels(network, dict(weights)))


def _project_late(network: Architecture, weights: dict[str, F32]) -> Slimmed:
    """Remove the projection before the pyramid.

    It is linear, and means of a projection are projections of means: the pyramid takes its means before it and projects
    those few, and the 1×1 convolutions that read it take it into themselves.
    """
    projection = _projection_before_the_pyramid(network)
    if projection is None:
        return network, weights
    steps: list[Step] = []
    replaced = dict(weights)
    size_of = ""
    for step in network.steps:
        match step:
            case Conv() if step is projection:
                continue
            case Conv() if step.source == projection.to:
                replaced |= _merged(projection, step, weights)
                channels = (projection.channels[0], step.channels[1])
                steps.append(replace(step, source=projection.source, channels=channels))
                size_of = step.to
            case Pyramid() if step.source == projection.to:
                wide = f"{step.to}/wide"
                steps += [
                    replace(step, source=projection.source, to=wide),
                    replace(projection, source=wide, to=step.to),
                ]
            case Enlarge() if step.like == projection.to:
                steps.append(replace(step, like=size_of))
            case _:
                steps.append(step)
    return replace(network, steps=tuple(steps)), replaced


def _projection_before_the_pyramid(network: Architecture) -> Conv | None:
    """Return the linear 1×1 convolution that a pyramid and other 1×1 convolutions read, if there is one."""
    pooled = {step.source for step in network.steps if isinstance(step, Pyramid)}
    for conv in network.convolutions:
        is_linear = conv.kernel == 1 and conv.stride == 1 and not (conv.activation or conv.plus or conv.norm)
        readers = [step for step in network.steps if _reads(step, conv.to)]
        fits = all(isinstance(step, Pyramid) or _is_pointwise(step) for step in readers)
        if conv.to in pooled and is_linear and conv.bias and fits and any(_is_pointwise(step) for step in readers):
            return conv
    return None


def _reads(step: Step, value: str) -> bool:
    """Return whether a step reads a value, other than for its size."""
    if isinstance(step, Conv) and step.plus == value:
        return True
    return value in (getattr(step, "sources", ()) or (getattr(step, "source", ""),))


def _is_pointwise(step: Step) -> bool:
    return isinstance(step, Conv) and step.kernel == 1 and step.groups == 1 and step.bias and not step.norm


def _merged(first: Conv, second: Conv, weights: Mapping[str, F32]) -> dict[str, F32]:
    """Return the weights of two 1×1 convolutions in one, under the second's name."""
    matrix = weights[f"{second.name}.weight"][:, :, 0, 0].astype(np.float64)
    before = weights[f"{first.name}.weight"][:, :, 0, 0].astype(np.float64)
    bias = matrix @ weights[f"{first.name}.bias"] + weights[f"{second.name}.bias"]
    return {
        f"{second.name}.weight": (matrix @ before)[:, :, None, None].astype(np.float32),
        f"{second.name}.bias": bias.astype(np.float32),
    }


def _without_idle_channels(network: Architecture, weights: dict[str, F32]) -> Slimmed:
    """Leave out channels of the first convolution that are 0 for any image, as a trained MobileNetV2 has some.

    The depthwise convolution after it makes a constant of them, which goes into the bias of the 1×1 convolution that
    comes next.
    """
    stem, depthwise, pointwise = list(network.convolutions)[:3]
    if not (stem.activation == depthwise.activation == RELU6 and depthwise.groups == stem.channels[1]):
        return network, weights
    lives = _can_exceed_zero(network, weights, stem)
    constant = np.clip(weights[f"{depthwise.name}.bias"][~lives], 0.0, 6.0)
    mixes = weights[f"{pointwise.name}.weight"]
    changed = {
        f"{conv.name}.{part}": weights[f"{conv.name}.{part}"][lives]
        for conv in (stem, depthwise)
        for part in ("weight", "bias")
    }
    changed[f"{pointwise.name}.weight"] = mixes[:, lives]
    changed[f"{pointwise.name}.bias"] = weights[f"{pointwise.name}.bias"] + mixes[:, ~lives, 0, 0] @ constant
    left = int(lives.sum())
    narrow = {
        stem: replace(stem, channels=(stem.channels[0], left)),
        depthwise: replace(depthwise, channels=(left, left), groups=left),
        pointwise: replace(pointwise, channels=(left, pointwise.channels[1])),
    }
    steps = tuple(narrow.get(step, step) if isinstance(step, Conv) else step for step in network.steps)
    return replace(network, steps=steps), weights | changed


def _can_exceed_zero(network: Architecture, weights: Mapping[str, F32], stem: Conv) -> Bool:
    """Return which channels of the first convolution any colours can make larger than 0 (channels,)."""
    mean, std = np.array(network.mean), np.array(network.std)
    darkest, brightest = (-mean / std)[:, None, None], ((255.0 - mean) / std)[:, None, None]
    weight = weights[f"{stem.name}.weight"].astype(np.float64)
    # Beyond the image there are zeros, which may be more than any colour makes.
    most = np.maximum(np.maximum(weight * darkest, weight * brightest), 0.0).sum(axis=(1, 2, 3))
    return np.asarray(most + weights[f"{stem.name}.bias"] > 0.0)
