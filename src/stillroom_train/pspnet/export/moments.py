"""Second moments of a network's activations on pictures."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from stillroom.errors import DatasetError
from stillroom.geometry.arrays import F32, F64
from stillroom.semantics.onnx.onnx_session import on_one_thread
from stillroom_train.pspnet.export.network_file import written
from stillroom_train.pspnet.networks.steps import IMAGE, Architecture

_PIXELS = 400
"""Most pixels of a value that are sampled in each picture; neighbours are correlated."""


def second_moments(
    network: Architecture, weights: Mapping[str, F32], values: Sequence[str], pictures: Iterable[F32]
) -> dict[str, F64]:
    """Return the mean of x xᵀ over pixels of pictures for each value, x its channels and a last one that is 1.

    Args:
        network: The steps.
        weights: By name.
        values: Names of the values that are looked at.
        pictures: Inputs of the network (1, 3, H, W).

    Returns:
        By name, (C + 1, C + 1).

    Raises:
        DatasetError: There are no pictures.
    """
    graph, names = written(network, weights, half=False)
    told = [names[value] for value in values]
    channels = {step.to: step.channels[1] for step in network.convolutions}
    model = graph.model(IMAGE, {names[value]: channels[value] for value in values}, {})
    session = on_one_thread(model.SerializeToString())
    sums = {value: np.zeros((channels[value] + 1, channels[value] + 1)) for value in values}
    lot = np.random.default_rng(0)
    count = 0
    for picture in pictures:
        count += 1
        for value, said in zip(values, session.run(told, {IMAGE: picture}), strict=True):
            pixels = said[0].reshape(channels[value], -1)
            some = lot.choice(pixels.shape[1], min(_PIXELS, pixels.shape[1]), replace=False)
            seen = np.vstack([pixels[:, some], np.ones((1, len(some)))]).astype(np.float64)
            sums[value] += seen @ seen.T / len(some)
    if count == 0:
        raise DatasetError("no pictures to see on which channels can be pruned; name a folder with --pictures")
    return {value: total / count for value, total in sums.items()}
