"""Keypoints on what may move are dropped before tracking: the a-priori mask of DynaSLAM and PSPNet-SLAM."""

from dataclasses import dataclass, replace

import numpy as np

from stillroom.bounds import bounded, check
from stillroom.data.frame import Frame
from stillroom.data.semantics import Semantics
from stillroom.geometry.pixels import Shape, grown
from stillroom.protocols import KeypointSieve, Parts, Pending


@dataclass(frozen=True)
class MaskedKeypointsConfig:
    """Which keypoints lie on what may move.

    Attributes:
        border_px: Keypoints this near to the mask are dropped too [px]: a corner of the silhouette belongs to nobody
            (docs/reference.md#dynaslam). Segmenters grow their masks themselves; this comes on top.
        min_keypoints: The sieve is off where fewer keypoints than this would stay: such a frame is lost either way
            unless the mask is wrong.
    """

    border_px: int = bounded(2, least=0)
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
        """Return the frame; static is what was so before and does not lie on anything movable."""
        known = semantics.result()
        if not known.has_any:
            return frame
        is_static = frame.is_static & ~self._grown(known).movable_at(frame.keypoints.raw_px)
        if np.count_nonzero(is_static) < self.config.min_keypoints:
            return frame
        return frame.with_static(is_static)

    def _grown(self, known: Semantics) -> Semantics:
        if self.config.border_px == 0:
            return known
        # Only the mask is asked; the instances are not grown with it, and would no longer agree with it.
        return replace(known, mask=grown(known.movable, self.config.border_px, Shape.ELLIPSE), instances=())
