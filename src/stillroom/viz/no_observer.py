"""The null object of observers."""

from stillroom.data.result import FrameResult, Tracked
from stillroom.data.semantics import Semantics


class NoObserver:
    """Does nothing, so that no caller has to check whether there is an observer."""

    def on_frame(self, tracked: Tracked, semantics: Semantics, result: FrameResult) -> None:
        """Do nothing."""
