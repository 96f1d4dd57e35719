"""From verdicts on clusters to the pixels that move."""

import cv2
import numpy as np
from numba import njit

from stillroom.data.cloud.clusters import UNKNOWN, Clusters
from stillroom.geometry.arrays import F64, I16, U8, Bool

STAYS, MOVES, MOVES_IN_BOX = 0, 1, 2
"""What is said of all pixels of a cluster."""


def moving_pixels(clusters: Clusters, belief: F64, in_boxes: Bool, margin_px: int) -> Bool:
    """Return the pixels (H, W) that move.

    Those of moving clusters and of what stands in the boxes; of other clusters, what lies in a box and is not believed
    static; and what is unknown beside all these.

    Args:
        clusters: The clusters.
        belief: Their log-odds of moving (K,).
        in_boxes: Pixels in boxes (H, W).
        margin_px: How far beside.
    """
    said = np.full(len(clusters) + 2, STAYS, dtype=np.uint8)  # labels −1 and −2 read the last two
    said[:-2][belief == 0] = MOVES_IN_BOX
    said[:-2][(belief > 0) | (clusters.box >= 0)] = MOVES
    if not said.any():
        return np.zeros(clusters.labels.shape, dtype=np.bool_)
    moving = np.empty(clusters.labels.shape, dtype=np.uint8)
    look_up(clusters.labels, said, in_boxes, moving)
    side = 2 * margin_px + 1
    near = np.asarray(cv2.dilate(moving, np.ones((side, side), dtype=np.uint8)), dtype=np.uint8)
    add_unknown(clusters.labels, near, moving)
    return moving.view(np.bool_)


@njit(nogil=True, cache=True)
def look_up(labels: I16, said: U8, in_boxes: Bool, moving: U8) -> None:
    """Set `moving` (H, W) to 1 where what is said of the label there says so, else to 0."""
    n = len(said)
    for row in range(labels.shape[0]):
        for column in range(labels.shape[1]):
            label = labels[row, column]
            word = said[label if label >= 0 else n + label]
            moving[row, column] = word == MOVES or (word == MOVES_IN_BOX and in_boxes[row, column])


@njit(nogil=True, cache=True)
def add_unknown(labels: I16, near: U8, moving: U8) -> None:
    """Set `moving` (H, W) to 1 where the label is unknown and something near moves."""
    for row in range(labels.shape[0]):
        for column in range(labels.shape[1]):
            if labels[row, column] == UNKNOWN and near[row, column]:
                moving[row, column] = 1
