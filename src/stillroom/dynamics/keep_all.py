"""The sieves of a system that believes the world to be static."""

from dataclasses import dataclass

from stillroom.data.frame import Frame
from stillroom.data.motion import Motion
from stillroom.data.question import Question
from stillroom.data.semantics import Semantics
from stillroom.protocols import KeypointSieve, Parts, Pending


@dataclass(frozen=True)
class KeepAllKeypointsConfig:
    """Every keypoint is tracked."""

    def build(self, parts: Parts | None = None) -> KeypointSieve:
        """Return the sieve."""
        return KeepAllKeypoints()


class KeepAllKeypoints:
    """Sieve 1 that lets every keypoint pass."""

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
    """Sieve 2 that lets every match pass."""

    def judge(self, question: Question) -> Motion:
        """Return that nothing moves."""
        return question.nothing_moves()
