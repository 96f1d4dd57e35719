"""Several sieves in one socket: what any of them finds to move, moves."""

from collections.abc import Sequence

from stillroom.data.motion import Motion
from stillroom.data.question import Question
from stillroom.dynamics.asking import Asking
from stillroom.protocols import MatchSieve


class Chain:
    """Puts each question to all its sieves; those with which too little would be left go unheard."""

    def __init__(self, sieves: Sequence[MatchSieve]) -> None:
        """Take the sieves, at least one, the most trusted first; each is led through a life of its own."""
        self._asked = tuple(Asking(sieve) for sieve in sieves)

    def judge(self, question: Question) -> Motion:
        """Judge that what moves by any account moves."""
        together, *others = [asked.judge(question) for asked in self._asked]
        for verdict in others:
            both = Motion(together.is_static & verdict.is_static, together.moving | verdict.moving)
            if question.leaves_enough(both):
                together = both
        return together
