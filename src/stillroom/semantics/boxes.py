"""Boxes as arrays: overlap, and the best of many that overlap."""

import numpy as np

from stillroom.geometry.arrays import I64, Floats


def overlap(first: Floats, second: Floats) -> Floats:
    """Return intersection over union of each of A boxes with each of B, (A, B); boxes are x_min y_min x_max y_max."""
    corner_min = np.maximum(first[:, None, :2], second[None, :, :2])
    corner_max = np.minimum(first[:, None, 2:], second[None, :, 2:])
    common = np.prod(np.maximum(corner_max - corner_min, 0.0), axis=2)
    area_first = np.prod(np.maximum(first[:, 2:] - first[:, :2], 0.0), axis=1)
    area_second = np.prod(np.maximum(second[:, 2:] - second[:, :2], 0.0), axis=1)
    union = area_first[:, None] + area_second[None, :] - common
    return np.asarray(common / np.maximum(union, 1e-9))


def suppress(boxes: Floats, scores: Floats, labels: I64, max_iou: float) -> I64:
    """Keep the best of the boxes of one class that overlap each other by more than `max_iou`.

    Args:
        boxes: Edges (N, 4).
        scores: The higher the better (N,).
        labels: Class (N,); boxes of different classes do not suppress each other.
        max_iou: Highest overlap that two kept boxes of one class may have.

    Returns:
        Indices of the kept boxes, best first; equal scores keep their order.
    """
    order = np.argsort(-scores, kind="stable")
    clash = (overlap(boxes[order], boxes[order]) > max_iou) & (labels[order][:, None] == labels[order][None, :])
    kept = np.ones(len(order), dtype=np.bool_)
    for i in range(len(order)):
        if kept[i]:
            kept[i + 1 :] &= ~clash[i, i + 1 :]
    return np.asarray(order[kept], dtype=np.int64)
