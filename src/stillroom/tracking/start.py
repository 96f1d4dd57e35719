"""How a map begins: with one frame whose depth is measured, or, in `monocular`, with two."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from stillroom.data.frame import Frame
from stillroom.data.map import Map, submaps
from stillroom.data.matches import Matches
from stillroom.data.motion import Stage
from stillroom.data.question import Question
from stillroom.data.result import Tracked, TrackingState
from stillroom.data.semantics import Semantics
from stillroom.protocols import MatchSieve, Pending


@dataclass(frozen=True)
class Beginnings:
    """How often a map was not begun, and why.

    Attributes:
        refusals: How often two images did not make one, by reason.
        n_dropped: How many maps were dropped because tracking was lost soon after they began.
    """

    refusals: Mapping[str, int] = field(default_factory=dict)
    n_dropped: int = 0


@dataclass(frozen=True)
class Lost:
    """Where, and for how long, tracking has been lost.

    Attributes:
        submap: The sub-map in which it was lost.
        since_s: Time of the first image that was not tracked [s].
        n_in_vain: Images since then that have enough keypoints, and in which no place was recognised.
    """

    submap: int
    since_s: float
    n_in_vain: int = 0


class Start(Protocol):
    """Begins maps and sub-maps."""

    @property
    def beginnings(self) -> Beginnings:
        """How that went so far."""

    def start(self, frame: Frame, semantics: Pending[Semantics], world: Map) -> Tracked:
        """Return the frame as one that begins a map, or a sub-map where there is one; without a pose if it does not."""

    def may_begin(self, frame: Frame) -> bool:
        """Return whether a frame has enough keypoints to begin a sub-map with."""

    def starts_again(self, lost: Lost, world: Map) -> bool:
        """Drop the sub-map in which tracking was lost, if it is too young to be trusted; return whether it was."""


class DepthStart:
    """Begins a map with the first frame of enough keypoints with depth (ORB-SLAM2: StereoInitialization)."""

    def __init__(self, min_keypoints: int, sieve: MatchSieve) -> None:
        """Store the sieve that is asked what moves."""
        self.min_keypoints, self.sieve = min_keypoints, sieve

    @property
    def beginnings(self) -> Beginnings:
        """Nothing: a single frame is not refused, but waited for."""
        return Beginnings()

    def start(self, frame: Frame, semantics: Pending[Semantics], world: Map) -> Tracked:
        """Return the frame as one that begins a map, or a sub-map where there is one, if it has enough keypoints."""
        nothing = np.full(len(frame), -1, dtype=np.int32)
        T_world_cam = submaps.origin(world.n_submaps)
        motion = self.sieve.judge(Question(Stage.LOCAL_MAP, frame, Matches.of(nothing), semantics, T_world_cam, world))
        started = Tracked(frame, TrackingState.OK, T_world_cam, nothing, motion)
        usable = started.is_static & (frame.keypoints.depth_m > 0)
        if usable.sum() < self.min_keypoints:
            return replace(started, state=TrackingState.NOT_INITIALIZED, T_world_cam=None)
        return started

    def may_begin(self, frame: Frame) -> bool:
        """Return whether enough keypoints have a depth."""
        return int((frame.is_static & (frame.keypoints.depth_m > 0)).sum()) >= self.min_keypoints

    def starts_again(self, lost: Lost, world: Map) -> bool:
        """Return False: measured depth is trusted from the first frame on."""
        return False
