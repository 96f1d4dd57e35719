"""Several sieves in one: what any of them finds dynamic is dynamic. Also the sieves that reject nothing."""

from collections.abc import Sequence
from dataclasses import dataclass

from stillroom.data.frame import Frame
from stillroom.data.map import Map
from stillroom.data.motion import Motion
from stillroom.data.question import Question
from stillroom.data.semantics import Semantics
from stillroom.dynamics.asking import Asking
from stillroom.geometry.arrays import F64
from stillroom.protocols import KeypointSieve, MatchSieve, Parts, Pending

# The sieves of a system that assumes a static world.


@dataclass(frozen=True)
class KeepAllKeypointsConfig:
    """Every keypoint is tracked."""

    def build(self, parts: Parts | None = None) -> KeypointSieve:
        """Return the sieve."""
        return KeepAllKeypoints()


class KeepAllKeypoints:
    """Sieve 1 that keeps every keypoint."""

    def __call__(self, frame: Frame, semantics: Pending[Semantics]) -> Frame:
        """Return the frame as it is."""
        return frame


@dataclass(frozen=True)
class KeepAllConfig:
    """Nothing moves: plain ORB-SLAM2."""

    def build(self, parts: Parts | None = None) -> "KeepAllMatches":
        """Return the sieve."""
        return KeepAllMatches()


class KeepAllMatches:
    """Sieve 2 that keeps every match."""

    def judge(self, question: Question) -> Motion:
        """Return that nothing moves."""
        return question.nothing_moves()


class Chain:
    """Calls all its sieves; those whose result would leave too few matches are ignored."""

    def __init__(self, sieves: Sequence[MatchSieve], world: Map) -> None:
        """Take the sieves, at least one, the most trusted first, and the map; each has its own life cycle."""
        self._asked = tuple(Asking(sieve, world) for sieve in sieves)
        self._united: tuple[Motion, Motion, Motion] | None = None

    def remember(self, frame: Frame, T_cam_world: F64, keyframe: int) -> None:
        """Pass the frame to all of them."""
        for asked in self._asked:
            asked.remember(frame, T_cam_world, keyframe)

    def corrected(self, T_new_old: F64) -> None:
        """Do nothing: each of them follows the corrections of the map itself."""

    def judge(self, question: Question) -> Motion:
        """Return the union of what any of them finds dynamic."""
        together, *others = [asked.judge(question) for asked in self._asked]
        for verdict in others:
            both = self._union(together, verdict)
            if question.leaves_enough(both):
                together = both
        return together

    def _union(self, first: Motion, second: Motion) -> Motion:
        """Return the union of two answers; the same one for those of the last time: stages of a frame often repeat."""
        if self._united is None or self._united[0] is not first or self._united[1] is not second:
            self._united = first, second, first.united_with(second)
        return self._united[2]
