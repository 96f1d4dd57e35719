"""Read boxes from darknet's yolo heads."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from stillroom.geometry.arrays import F64
from stillroom.semantics.darknet.network import Network
from stillroom.semantics.onnx.layouts import Asked, Shape, Told, may_be

LARGEST_EXPONENT = 20.0  # of a box whose numbers make no sense


class DarknetHeads:
    """The layout `darknet`: for each head (1, A (5 + C), h, w) of raw numbers, A its anchors."""

    def __init__(self, network: Network, asked: Asked) -> None:
        """Take the heads of a network, which may have been cut to fewer classes than its cfg names.

        Args:
            network: What the cfg says.
            asked: What the network is asked; boxes are in shares of its input by themselves.
        """
        self._asked = asked
        self._width = 5 + asked.n_classes
        pairs = zip(network.heads, network.head_shapes, strict=True)
        self._shapes = [(1, len(head.anchors_px) * self._width, *shape[1:]) for head, shape in pairs]
        self._cells = _cells_of(network)
        self._columns = [5 + number for number in asked.classes]

    @property
    def expected(self) -> str:
        """The outputs' shapes in words."""
        return ", ".join(str(shape) for shape in self._shapes)

    def fits(self, shapes: Sequence[Shape]) -> bool:
        """Return whether each head has an output."""
        pairs = zip(shapes, self._shapes, strict=False)
        return len(shapes) == len(self._shapes) and all(may_be(shape, *wanted) for shape, wanted in pairs)

    def read(self, outputs: Sequence[Any]) -> Told:
        """Return the boxes; one that is likely of two classes is told twice."""
        width, least = self._width, self._asked.confidence
        rows = [
            raw.reshape(-1, width, raw.shape[2] * raw.shape[3]).transpose(0, 2, 1).reshape(-1, width) for raw in outputs
        ]
        raw_rows = np.concatenate(rows)
        # Objectness bounds confidence from above, and few cells pass.
        limit = np.log(least / max(1.0 - least, 1e-12))
        likely = np.flatnonzero(raw_rows[:, 4] >= limit)
        values = raw_rows[likely].astype(np.float64)
        confidence = _sigmoid(values[:, 4:5]) * _sigmoid(values[:, self._columns])
        which, label = np.nonzero(confidence >= least)
        values, cells = values[which], self._cells[likely[which]]
        center = cells[:, 0] + _sigmoid(values[:, :2]) * cells[:, 1]
        half = 0.5 * np.exp(np.minimum(values[:, 2:4], LARGEST_EXPONENT)) * cells[:, 2]
        return Told(np.concatenate([center - half, center + half], axis=1), confidence[which, label], label)


def _cells_of(network: Network) -> F64:
    """Return of each box that a network may tell its cell's corner and span and its anchor's size, (N, 3, 2) in [0, 1].

    Heads, anchors, rows, columns: the order in which `read` reads them.
    """
    tables = []
    _, height_px, width_px = network.input_shape
    for head, (_, rows, columns) in zip(network.heads, network.head_shapes, strict=True):
        table = np.zeros((len(head.anchors_px), rows, columns, 3, 2))
        row, column = np.indices((rows, columns))
        table[..., 0, :] = np.stack([column, row], axis=2) - 0.5 * (head.scale_xy - 1.0)
        table[..., 1, :] = head.scale_xy
        table[..., :2, :] /= (columns, rows)
        table[..., 2, :] = np.array(head.anchors_px)[:, None, None] / (width_px, height_px)
        tables.append(table.reshape(-1, 3, 2))
    return np.concatenate(tables)


def _sigmoid(x: F64) -> F64:
    return np.asarray(0.5 * (1.0 + np.tanh(0.5 * x)))
