"""The plain answer: whatever may move is taken to move."""

from dataclasses import dataclass

from stillroom.data.motion import Motion
from stillroom.data.question import Question
from stillroom.protocols import Parts


@dataclass(frozen=True)
class WholeBoxesConfig:
    """All of a box or mask is thrown away."""

    def build(self, parts: Parts | None = None) -> "WholeBoxes":
        """Return the sieve."""
        return WholeBoxes()


class WholeBoxes:
    """Sieve 2 that throws away everything movable."""

    def judge(self, question: Question) -> Motion:
        """Return that everything moves that may."""
        return question.all_that_may_moves()
