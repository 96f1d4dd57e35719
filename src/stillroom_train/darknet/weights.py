"""Read darknet's binary file of weights, batch normalisation folded in."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stillroom.errors import WeightsError
from stillroom.geometry.arrays import F32, F64
from stillroom_train.darknet.cfg import read_bytes
from stillroom_train.darknet.network import Convolution, Network

BATCH_NORM_EPSILON = 1e-5
FETCH_AGAIN = "fetch it again from where it came"


@dataclass(frozen=True)
class ConvolutionWeights:
    """One convolution's numbers, batch normalisation folded in.

    Attributes:
        kernel: (filters, channels / groups, size, size) float32.
        bias: (filters,) float32.
    """

    kernel: F32
    bias: F32


def read_weights(path: Path, network: Network) -> list[ConvolutionWeights]:
    """Read the numbers of each convolution, in order, and fold batch normalisation into them.

    The file: major, minor, revision (int32), pictures seen (int64 from version 0.2 on, int32 before), then float32.
    For each convolution: biases; with batch normalisation scales, means and variances; kernels.

    Raises:
        WeightsError: The file is missing, or its length does not fit the network.
    """
    numbers = _read_numbers(path)
    convolutions = [layer for layer in network.layers if isinstance(layer, Convolution)]
    needed = sum(_count(layer) for layer in convolutions)
    if len(numbers) != needed:
        problem = "truncated" if len(numbers) < needed else "too long"
        raise WeightsError(f"{path}: {problem}: {len(numbers)} numbers where its cfg needs {needed}; {FETCH_AGAIN}")
    weights: list[ConvolutionWeights] = []
    at = 0
    for layer in convolutions:
        folded = _fold(layer, numbers[at : at + _count(layer)])
        if not (np.all(np.isfinite(folded.kernel)) and np.all(np.isfinite(folded.bias))):
            raise WeightsError(f"{path}: convolution {len(weights)} has numbers that are not finite; {FETCH_AGAIN}")
        weights.append(folded)
        at += _count(layer)
    return weights


def _read_numbers(path: Path) -> F32:
    content = read_bytes(path)
    if len(content) < 16:
        raise WeightsError(f"{path}: truncated: {len(content)} bytes; {FETCH_AGAIN}")
    major, minor = (int(number) for number in np.frombuffer(content, dtype="<i4", count=2))
    header = 20 if major * 10 + minor >= 2 else 16
    body = content[header:]
    return np.frombuffer(body[: len(body) // 4 * 4], dtype="<f4").astype(np.float32)


def _count(layer: Convolution) -> int:
    vectors = 4 if layer.batch_normalize else 1
    return layer.filters * (vectors + layer.channels // layer.groups * layer.size**2)


def _fold(layer: Convolution, numbers: F32) -> ConvolutionWeights:
    n = layer.filters
    vectors = 4 if layer.batch_normalize else 1
    kernel = numbers[vectors * n :].reshape(n, layer.channels // layer.groups, layer.size, layer.size)
    bias: F64 = numbers[:n].astype(np.float64)
    if not layer.batch_normalize:
        return ConvolutionWeights(kernel, bias.astype(np.float32))
    scale, mean, variance = numbers[n : 4 * n].astype(np.float64).reshape(3, n)
    with np.errstate(invalid="ignore"):  # a negative variance is reported by the caller
        gain = scale / np.sqrt(variance + BATCH_NORM_EPSILON)
    folded = kernel * gain[:, None, None, None]
    return ConvolutionWeights(folded.astype(np.float32), (bias - mean * gain).astype(np.float32))
