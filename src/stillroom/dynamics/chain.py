"""Several sieves in one socket: what any of them finds to move, moves."""

from collections.abc import Sequence

from stillroom.data.frame import Frame
from stillroom.data.map import Map
from stillroom.data.matches import Matches
from stillroom.data.motion import Motion, Stage
from stillroom.data.semantics import Semantics
from stillroom.dynamics.enough import leaves_enough
from stillroom.geometry.arrays import F64
from stillroom.protocols import MatchSieve, Pending


class Chain:
    """Puts each question to all its sieves; those with which too little would be left go unheard."""

    def __init__(self, sieves: Sequence[MatchSieve], min_matches: int) -> None:
        """Take the sieves, the most trusted first.

        Args:
            sieves: At least one; each is off by itself where it alone would leave too little.
            min_matches: How many matches must stay, where there are as many.
        """
        self._sieves, self._min_matches = tuple(sieves), min_matches

    def judge(
        self,
        stage: Stage,
        frame: Frame,
        matches: Matches,
        semantics: Pending[Semantics],
        T_cam_world: F64,
        world: Map,
    ) -> Motion:
        """Judge that what moves by any account moves."""
        verdicts = [sieve.judge(stage, frame, matches, semantics, T_cam_world, world) for sieve in self._sieves]
        together = verdicts[0]
        for verdict in verdicts[1:]:
            both = Motion(together.is_static & verdict.is_static, together.moving | verdict.moving)
            if leaves_enough(both, matches, self._min_matches):
                together = both
        return together
