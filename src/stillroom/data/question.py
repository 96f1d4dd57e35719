"""What a match sieve is asked."""

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, TypeVar

import numpy as np

from stillroom.data.frame import Frame
from stillroom.data.map import Map
from stillroom.data.matches import Matches
from stillroom.data.motion import Motion, Stage
from stillroom.data.semantics import Semantics
from stillroom.geometry.arrays import F64, Bool

MIN_MATCHES = 40
"""So many matches must stay under a verdict: tracking needs 30 that agree with the pose."""

TRACKABLE = 20
"""With fewer matches than this tracking does not go on, whatever a sieve says of them."""

T_co = TypeVar("T_co", covariant=True)


class Pending(Protocol[T_co]):
    """An answer that may still be in the making."""

    def result(self) -> T_co:
        """Wait for the answer and return it; raise what the work raised."""


@dataclass(frozen=True)
class Question:
    """What moves in this image?

    Attributes:
        stage: When in tracking the question is put; thresholds may differ.
        frame: The present frame, after sieve 1.
        matches: Its pairs with map points at this stage.
        semantics: What may move; `known` waits for it.
        T_cam_world: The best guess of the present pose (4, 4) at this stage.
        world: The map.
    """

    stage: Stage
    frame: Frame
    matches: Matches
    semantics: Pending[Semantics]
    T_cam_world: F64
    world: Map

    @property
    def known(self) -> Semantics:
        """What may move; waits until the segmenter has answered."""
        return self.semantics.result()

    @cached_property
    def may_move(self) -> Bool:
        """Whether each keypoint (N,) lies on something that may move."""
        return self.known.movable_at(self.frame.keypoints.raw_px)

    def nothing_moves(self) -> Motion:
        """Return the verdict that nothing moves."""
        return Motion.none(len(self.frame), self.frame.image.height, self.frame.image.width)

    def all_that_may_moves(self) -> Motion:
        """Return the verdict that everything moves that may."""
        return Motion(~self.may_move, self.known.movable)

    def leaves_enough(self, motion: Motion) -> bool:
        """Return whether `MIN_MATCHES` stay under a verdict, or all matches where there were fewer before.

        With fewer than `TRACKABLE` matches any verdict leaves enough: tracking does not go on either way.
        """
        stay = int(np.count_nonzero(motion.is_static[self.matches.keypoint]))
        return stay >= min(MIN_MATCHES, len(self.matches)) or len(self.matches) < TRACKABLE

    def enough_of(self, motion: Motion) -> Motion:
        """Return a verdict; where it leaves too little, that of the semantics alone; where that does, none moves."""
        if self.leaves_enough(motion):
            return motion
        masked = self.all_that_may_moves()
        return masked if self.leaves_enough(masked) else self.nothing_moves()
