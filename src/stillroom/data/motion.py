"""A sieve's verdict: what does move in an image."""

from dataclasses import dataclass, field
from enum import Enum, auto

import numpy as np

from stillroom.geometry.arrays import Bool


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
    """

    is_static: Bool
    moving: Bool = field(repr=False)

    @staticmethod
    def none(n_keypoints: int, height: int, width: int) -> "Motion":
        """Return the verdict that nothing moves."""
        return Motion(np.ones(n_keypoints, dtype=np.bool_), np.zeros((height, width), dtype=np.bool_))
