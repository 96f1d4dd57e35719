"""The input of a match sieve."""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
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
"""Number of matches that a sieve must leave: tracking needs 30 inliers of the pose."""

TRACKABLE = 20
"""With fewer matches than this a stage of tracking fails, whatever a sieve says."""

T_co = TypeVar("T_co", covariant=True)


class Pending(Protocol[T_co]):
    """A result that may still be computed on another thread."""

    def result(self) -> T_co:
        """Wait for the result and return it; raise the exception of the computation."""

    def done(self) -> bool:
        """Return whether the result is available."""


@dataclass(frozen=True)
class Perceived:
    """What is potentially dynamic in an image, in two steps: what the segmenter finds, and later the clusters.

    Attributes:
        found: What the segmenter finds.
        clustered: The same with the clusters of the depth cloud.
        waiting: Makes a context for the time that a caller waits in.
    """

    found: Pending[Semantics]
    clustered: Pending[Semantics]
    waiting: Callable[[], AbstractContextManager[None]] = nullcontext

    def result(self) -> Semantics:
        """Wait for both and return them."""
        return self._awaited(self.clustered)

    def first(self) -> Semantics:
        """Wait for what the segmenter finds and return it, without clusters."""
        return self._awaited(self.found)

    def done(self) -> bool:
        """Return whether both are available."""
        return self.clustered.done()

    def _awaited(self, pending: Pending[Semantics]) -> Semantics:
        if pending.done():
            return pending.result()
        with self.waiting():
            return pending.result()


@dataclass(frozen=True)
class Question:
    """The input of a match sieve: what is dynamic in this image?

    Attributes:
        stage: The tracking stage; thresholds may differ.
        frame: The present frame, after sieve 1.
        matches: Its pairs with map points at this stage.
        semantics: What is potentially dynamic; `found` and `known` wait for it.
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
        """What is potentially dynamic, with clusters; waits for segmenter and clusterer."""
        return self.semantics.result()

    @property
    def found(self) -> Semantics:
        """The same without clusters, which may not be there yet; waits for the segmenter alone."""
        return self.semantics.first() if isinstance(self.semantics, Perceived) else self.semantics.result()

    @cached_property
    def may_move(self) -> Bool:
        """Whether each keypoint (N,) lies on something potentially dynamic."""
        return self.found.movable_at(self.frame.keypoints.raw_px)

    def nothing_moves(self) -> Motion:
        """Return a motion in which nothing is dynamic."""
        return Motion.none(len(self.frame), self.frame.image.height, self.frame.image.width)

    def all_that_may_moves(self) -> Motion:
        """Return a motion in which everything potentially dynamic is dynamic."""
        return Motion(~self.may_move, self.found.movable)

    def leaves_enough(self, motion: Motion) -> bool:
        """Return whether a motion leaves `MIN_MATCHES` matches, or all matches where there were fewer before.

        With fewer than `TRACKABLE` matches any motion leaves enough: the stage fails either way.
        """
        stay = int(np.count_nonzero(motion.is_static[self.matches.keypoint]))
        return stay >= min(MIN_MATCHES, len(self.matches)) or len(self.matches) < TRACKABLE

    def enough_of(self, motion: Motion) -> Motion:
        """Return the motion; if it leaves too few matches, that of the semantics alone; if that does too, none."""
        if self.leaves_enough(motion):
            return motion
        masked = self.all_that_may_moves()
        return masked if self.leaves_enough(masked) else self.nothing_moves()
