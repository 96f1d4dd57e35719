"""From verdicts on clusters to the pixels that move."""

import numpy as np
from numba import njit

from stillroom.data.cloud.clusters import UNKNOWN, Clusters
from stillroom.geometry.arrays import F64, I16, U8, Bool
from stillroom.geometry.growing import Shape, grown

STAYS, MOVES, MOVES_IN_BOX = 0, 1, 2
"""What is said of all pixels of a cluster, as bits."""


class MovingPixels:
    """Marks the pixels that move; the same verdicts on the same clusters are marked once."""

    def __init__(self, margin_px: int) -> None:
        """Start with nothing marked.

        Args:
            margin_px: What lies so close to something moving, and on no plane or other cluster, moves too.
        """
        self._margin_px = margin_px
        self._last: tuple[Clusters, U8, Bool] | None = None

    def of(self, clusters: Clusters, belief: F64, in_boxes: Bool) -> Bool:
        """Return the pixels (H, W) that move; not to be written to.

        Those of moving clusters and of what stands in the boxes; of other clusters, what lies in a box and is not
        believed static; and what is unknown beside all these.

        Args:
            clusters: The clusters.
            belief: Their log-odds of moving (K,).
            in_boxes: Pixels in boxes (H, W).
        """
        said = np.full(len(clusters), STAYS, dtype=np.uint8)
        said[belief == 0] = MOVES_IN_BOX
        said[(belief > 0) | (clusters.box >= 0)] = MOVES
        return self.marked(clusters, said, in_boxes)

    def marked(self, clusters: Clusters, said_of: U8, in_boxes: Bool) -> Bool:
        """Return the pixels (H, W) of clusters of which that is said (K,); arguments and result otherwise as `of`."""
        said = np.append(np.zeros(2, dtype=np.uint8), said_of)  # labels −2 and −1 read the first two
        last = self._last
        if last is not None and last[0] is clusters and np.array_equal(last[1], said):
            return last[2]
        moving = self._mark(clusters, said, in_boxes)
        self._last = (clusters, said, moving)
        return moving

    def _mark(self, clusters: Clusters, said: U8, in_boxes: Bool) -> Bool:
        labels = np.ascontiguousarray(clusters.labels)
        moving = np.zeros(labels.shape, dtype=np.uint8)
        if said.any():
            look_up(labels.ravel(), said, in_boxes.ravel(), moving.ravel())
            near = grown(moving.view(np.bool_), self._margin_px, Shape.SQUARE).view(np.uint8)
            add_unknown(labels.ravel(), near.ravel(), moving.ravel())
        return moving.view(np.bool_)


@njit(nogil=True, cache=True)
def look_up(labels: I16, said: U8, in_boxes: Bool, moving: U8) -> None:
    """Set `moving` (P,) to 1 where what is said of the pixel's label (P,) says so, else to 0."""
    for i in range(len(labels)):
        word = said[labels[i] + 2]
        moving[i] = (word & MOVES) | ((word >> 1) & np.uint8(in_boxes[i]))


@njit(nogil=True, cache=True)
def add_unknown(labels: I16, near: U8, moving: U8) -> None:
    """Set `moving` (P,) to 1 where the pixel's label (P,) is unknown and something near moves."""
    for i in range(len(labels)):
        moving[i] |= near[i] & np.uint8(labels[i] == UNKNOWN)
