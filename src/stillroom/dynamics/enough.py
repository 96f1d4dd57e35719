"""A verdict must leave tracking enough to go on with."""

import numpy as np

from stillroom.data.frame import Frame
from stillroom.data.matches import Matches
from stillroom.data.motion import Motion
from stillroom.data.semantics import Semantics

TRACKABLE = 20
"""With fewer matches than this tracking does not go on, whatever is said of them."""


def leaves_enough(motion: Motion, matches: Matches, min_matches: int) -> bool:
    """Tell whether enough matches stay: so many, or all of them where there were fewer before."""
    stay = int(np.count_nonzero(motion.is_static[matches.keypoint]))
    return stay >= min(min_matches, len(matches)) or len(matches) < TRACKABLE


def or_less(motion: Motion, frame: Frame, known: Semantics, matches: Matches, min_matches: int) -> Motion:
    """Return a verdict; where it leaves too little, that of the semantics alone; where that does, that nothing moves.

    Args:
        motion: The verdict.
        frame: What it is about.
        known: What may move in it.
        matches: Of which enough must stay.
        min_matches: How many.
    """
    if leaves_enough(motion, matches, min_matches):
        return motion
    masked = Motion(~known.movable_at(frame.keypoints.raw_px), known.movable)
    if leaves_enough(masked, matches, min_matches):
        return masked
    return Motion.none(len(frame), frame.image.height, frame.image.width)
