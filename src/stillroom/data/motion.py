"""The result of a match sieve: what is dynamic in an image."""

from dataclasses import dataclass, field
from enum import Enum, auto

import numpy as np

from stillroom.geometry.arrays import F32, Bool


class Stage(Enum):
    """The tracking stage in which a match sieve is called. Thresholds differ by stage (OC-SLAM 2.2)."""

    LOW_COST = auto()
    """DynaSLAM's and PSPNet-SLAM's low-cost tracking, before the other stages."""
    MOTION_MODEL = auto()
    """Matches with the last frame under the constant-velocity guess."""
    REFERENCE_KEYFRAME = auto()
    """Matches with the reference keyframe, when the motion model failed."""
    LOCAL_MAP = auto()
    """Matches with the local map, under a pose that is already good."""
    RELOCALIZATION = auto()
    """Both papers switch rejection off here."""


@dataclass(frozen=True)
class Motion:
    """The classification of a whole image into static and dynamic, not only of the matches.

    An RGB-D keyframe makes map points of unmatched keypoints too, so classifying the matches alone would put the people
    back into the map.

    Attributes:
        is_static: Which keypoints of the frame are static (N,).
        moving: Dynamic pixels (H, W).
        p_static: Probability that each keypoint is static (N,) float32, 0 to 1, for those classified as static: it
            weighs their matches when the pose is found, and their observations in bundle adjustment. None where the
            sieve gives a binary result; all then weigh the same.
    """

    is_static: Bool
    moving: Bool = field(repr=False)
    p_static: F32 | None = field(default=None, repr=False)

    def united_with(self, other: "Motion") -> "Motion":
        """Return the union: dynamic is what either of them classifies so; probabilities multiply."""
        known = [p for p in (self.p_static, other.p_static) if p is not None]
        both = None if not known else known[0] if len(known) == 1 else known[0] * known[1]
        return Motion(self.is_static & other.is_static, self.moving | other.moving, both)

    @staticmethod
    def none(n_keypoints: int, height: int, width: int) -> "Motion":
        """Return a motion in which nothing is dynamic."""
        return Motion(np.ones(n_keypoints, dtype=np.bool_), np.zeros((height, width), dtype=np.bool_))
