"""A sieve's verdict: what does move in an image."""

from dataclasses import dataclass, field
from enum import Enum, auto

import numpy as np

from stillroom.geometry.arrays import F32, Bool


class Stage(Enum):
    """When a match sieve is asked. Thresholds differ by stage (OC-SLAM 2.2)."""

    LOW_COST = auto()
    """DynaSLAM's and PSPNet-SLAM's quick pose before tracking proper."""
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
    """A verdict about the whole image, not only about the matches.

    An RGB-D keyframe makes map points of unmatched keypoints too, so a verdict on matches alone would put the
    people back into the map.

    Attributes:
        is_static: Verdict on each keypoint of the frame (N,).
        moving: Pixels that move (H, W).
        p_static: Probability that each keypoint is static (N,) float32, 0 to 1, for those that pass as static: it
            weighs their matches when the pose is found, and their observations in bundle adjustment. None where the
            sieve knows yes and no only; all then weigh the same.
    """

    is_static: Bool
    moving: Bool = field(repr=False)
    p_static: F32 | None = field(default=None, repr=False)

    def united_with(self, other: "Motion") -> "Motion":
        """Return the verdict that what moves by either account moves; probabilities multiply."""
        known = [p for p in (self.p_static, other.p_static) if p is not None]
        both = None if not known else known[0] if len(known) == 1 else known[0] * known[1]
        return Motion(self.is_static & other.is_static, self.moving | other.moving, both)

    @staticmethod
    def none(n_keypoints: int, height: int, width: int) -> "Motion":
        """Return the verdict that nothing moves."""
        return Motion(np.ones(n_keypoints, dtype=np.bool_), np.zeros((height, width), dtype=np.bool_))
