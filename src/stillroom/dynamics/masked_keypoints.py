"""Keypoints on what is potentially dynamic are dropped before tracking: DynaSLAM's and PSPNet-SLAM's a-priori mask."""

from dataclasses import dataclass, replace

import numpy as np

from stillroom.bounds import bounded, check
from stillroom.data.frame import Frame
from stillroom.data.semantics import Semantics
from stillroom.geometry.pixels import Shape, grown
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
        is_static = frame.is_static & ~self._grown(known).movable_at(frame.keypoints.raw_px)
        if np.count_nonzero(is_static) < self.config.min_keypoints:
            return frame
        return frame.with_static(is_static)

    def _grown(self, known: Semantics) -> Semantics:
        if self.config.border_px == 0:
            return known
        # Only the mask is used; the instances are not dilated with it, and would no longer agree with it.
        return replace(known, mask=grown(known.movable, self.config.border_px, Shape.ELLIPSE), instances=())
