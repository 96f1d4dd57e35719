"""The simplest sieve: whatever is potentially dynamic is dynamic."""

from dataclasses import dataclass

from stillroom.data.motion import Motion
from stillroom.data.question import Question
from stillroom.protocols import Parts


@dataclass(frozen=True)
class WholeBoxesConfig:
    """All of a box or mask is rejected."""

    def build(self, parts: Parts | None = None) -> "WholeBoxes":
        """Return the sieve."""
        return WholeBoxes()


class WholeBoxes:
    """Sieve 2 that rejects everything potentially dynamic."""

    def judge(self, question: Question) -> Motion:
        """Classify everything potentially dynamic as dynamic."""
        return question.all_that_may_moves()
