"""Keypoints on what is potentially dynamic are dropped before tracking: DynaSLAM's and PSPNet-SLAM's a-priori mask."""

from dataclasses import dataclass

import numpy as np

from stillroom.bounds import bounded, check
from stillroom.compiled import njit
from stillroom.data.frame import Frame
from stillroom.data.semantics import Semantics
from stillroom.geometry.arrays import F32, U8, Bool
from stillroom.geometry.pixels import Shape, element
from stillroom.protocols import KeypointSieve, Parts, Pending


@dataclass(frozen=True)
class MaskedKeypointsConfig:
    """Which keypoints lie on what is potentially dynamic.

    Attributes:
        border_px: Keypoints this near to the mask are dropped too [px]: a corner of the silhouette is no surface point
            (docs/reference.md#dynaslam). Segmenters dilate their masks themselves; this is in addition.
        min_keypoints: The sieve is off where fewer keypoints than this would stay: such a frame is lost either way
            unless the mask is wrong.
    """

    border_px: int = bounded(2, least=0, pixels=1)
    min_keypoints: int = bounded(20, least=0)

    def build(self, parts: Parts | None = None) -> KeypointSieve:
        """Return the sieve."""
        check(self)
        return MaskedKeypoints(self)


class MaskedKeypoints:
    """Sieve 1 that drops keypoints on the mask, or in the boxes where there is no mask, and on its border."""

    def __init__(self, config: MaskedKeypointsConfig) -> None:
        """Keep the configuration."""
        self.config = config

    def __call__(self, frame: Frame, semantics: Pending[Semantics]) -> Frame:
        """Return the frame; static are those that were so before and lie on nothing potentially dynamic."""
        known = semantics.result()
        if not known.has_any:
            return frame
        is_static = frame.is_static.copy()
        drop_near(known.movable, frame.keypoints.raw_px, element(self.config.border_px, Shape.ELLIPSE), is_static)
        if np.count_nonzero(is_static) < self.config.min_keypoints:
            return frame
        return frame.with_static(is_static)


@njit(nogil=True, cache=True)
def drop_near(mask: Bool, raw_px: F32, border: U8, is_static: Bool) -> None:
    """Set `is_static` (N,) to false at points (N, 2) [px] whose border (2 · reach + 1, …) touches a mask (H, W).

    A point's pixel is the nearest one, and outside of the image that of its edge. The mask is not dilated: only its
    pixels about the points are read.
    """
    height, width = mask.shape
    reach = len(border) // 2
    for i in range(len(raw_px)):
        column = min(max(int(np.rint(raw_px[i, 0])), 0), width - 1)
        row = min(max(int(np.rint(raw_px[i, 1])), 0), height - 1)
        for v in range(max(0, row - reach), min(height, row + reach + 1)):
            for u in range(max(0, column - reach), min(width, column + reach + 1)):
                if mask[v, u] and border[v - row + reach, u - column + reach] != 0:
                    is_static[i] = False
