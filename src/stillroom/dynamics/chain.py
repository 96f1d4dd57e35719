"""Several sieves in one socket: what any of them finds to move, moves."""

from collections.abc import Sequence

from stillroom.data.frame import Frame
from stillroom.data.map import Map
from stillroom.data.motion import Motion
from stillroom.data.question import Question
from stillroom.dynamics.asking import Asking
from stillroom.geometry.arrays import F64
from stillroom.protocols import MatchSieve


class Chain:
    """Puts each question to all its sieves; those with which too little would be left go unheard."""

    def __init__(self, sieves: Sequence[MatchSieve], world: Map) -> None:
        """Take the sieves, at least one, the most trusted first, and the map; each is led through a life of its own."""
        self._asked = tuple(Asking(sieve, world) for sieve in sieves)

    def remember(self, frame: Frame, T_cam_world: F64, keyframe: int) -> None:
        """Hand the frame on to all of them."""
        for asked in self._asked:
            asked.remember(frame, T_cam_world, keyframe)

    def corrected(self, T_new_old: F64) -> None:
        """Do nothing: each of them is led on its own, and follows the map by itself."""

    def judge(self, question: Question) -> Motion:
        """Judge that what moves by any account moves."""
        together, *others = [asked.judge(question) for asked in self._asked]
        for verdict in others:
            both = together.united_with(verdict)
            if question.leaves_enough(both):
                together = both
        return together
