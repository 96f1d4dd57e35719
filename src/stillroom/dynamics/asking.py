"""The life cycle of every match sieve, in one place. A sieve implements only `judge`, and its memory.

This module does what all of them need: no sieve is called while relocalizing, where both papers switch rejection off;
memories are corrected with the map; a result that leaves too few matches is ignored; and a tracked frame is passed to
sieves with a memory. `ImageMemory` caches what was computed for the present image.
"""

from dataclasses import replace
from typing import Generic, TypeVar

import numpy as np

from stillroom.data.frame import Frame
from stillroom.data.image import Image
from stillroom.data.map import Map
from stillroom.data.map.jumps import JumpFollower
from stillroom.data.motion import Motion, Stage
from stillroom.data.question import MIN_MATCHES, Question
from stillroom.data.result import Tracked
from stillroom.data.semantics import Semantics
from stillroom.geometry import se3
from stillroom.geometry.arrays import F64
from stillroom.protocols import KeyframeSieve, MatchSieve, RememberingSieve

T = TypeVar("T")


class Asking:
    """Calls a sieve for tracking, and manages its life cycle."""

    def __init__(self, sieve: MatchSieve, world: Map) -> None:
        """Take a new sieve, and the map whose corrections it follows."""
        self.sieve, self._world = sieve, world
        self._memory = sieve if isinstance(sieve, RememberingSieve) else None
        self._at_keyframes = sieve if isinstance(sieve, KeyframeSieve) else None
        self._jumps = JumpFollower()

    def judge(self, question: Question) -> Motion:
        """Return the sieve's result, or a weaker one that leaves enough matches to track with."""
        if question.stage is Stage.RELOCALIZATION:
            return question.nothing_moves()
        self._correct()
        return question.enough_of(self.sieve.judge(question))

    def seen(self, tracked: Tracked, found: Semantics) -> Tracked:
        """Return a frame that becomes a keyframe, classified again by what a network finds in it.

        Args:
            tracked: The frame.
            found: What is potentially dynamic in it: dynamic, unless the sieve is a `KeyframeSieve` and says otherwise.
        """
        if self._at_keyframes is not None:
            motion = self._at_keyframes.take_up(tracked, found)
        else:
            is_masked = found.movable_at(tracked.frame.keypoints.raw_px)
            motion = tracked.motion.united_with(Motion(~is_masked, found.movable))
        point_ids = np.where(motion.is_static, tracked.point_ids, np.int32(-1))
        if np.count_nonzero(point_ids >= 0) < min(MIN_MATCHES, tracked.n_inliers):
            return tracked  # as everywhere, what leaves too few matches is ignored
        return replace(tracked, motion=motion, point_ids=point_ids)

    def remember(self, frame: Frame, T_cam_world: F64, keyframe: int) -> None:
        """Pass a tracked frame to a sieve with a memory.

        Args:
            frame: The frame.
            T_cam_world: Its refined pose (4, 4), in the map as it is now.
            keyframe: Its id in the map where it became a keyframe; else −1.
        """
        self._correct()
        if self._memory is not None:
            self._memory.remember(frame, T_cam_world, keyframe)

    def _correct(self) -> None:
        T_new_old = self._jumps.missed(self._world)
        if T_new_old is not None and self._memory is not None:
            self._memory.corrected(T_new_old)


class ImageMemory(Generic[T]):
    """A cache of what was computed for the present image, and at which pose.

    Tracking calls a sieve at several stages of an image. What depends on the image alone is computed once; what depends
    on the pose too is computed again where the pose has changed by more than its resolution.
    """

    def __init__(self, reach_m: float = 0.0, reach_rad: float = 0.0) -> None:
        """Start empty.

        Args:
            reach_m, reach_rad: Poses so close to each other count as the same.
        """
        self._reach = reach_m, reach_rad
        self._kept: tuple[Image, F64, T] | None = None

    def of(self, image: Image) -> T | None:
        """Return what was computed for an image, at any pose; None if nothing."""
        return self._kept[2] if self._kept is not None and self._kept[0] is image else None

    def near(self, image: Image, T_cam_world: F64) -> T | None:
        """Return what was computed for an image at nearly this pose (4, 4); None if nothing."""
        if self._kept is None or self._kept[0] is not image:
            return None
        return self._kept[2] if se3.are_near(self._kept[1], T_cam_world, *self._reach) else None

    def keep(self, image: Image, T_cam_world: F64, worked_out: T) -> T:
        """Keep what was computed for an image at a pose (4, 4), replacing older entries; return it."""
        self._kept = image, T_cam_world.copy(), worked_out
        return worked_out

    def forget(self) -> None:
        """Forget what depends on a pose of the map as it was."""
        self._kept = None
