"""The observer of runs that nobody watches."""

from stillroom.data.result import FrameResult, Tracked
from stillroom.data.semantics import Semantics


class NoObserver:
    """Looks at nothing: stands where an observer may stand, so that no caller asks whether there is one."""

    def on_frame(self, tracked: Tracked, semantics: Semantics, result: FrameResult) -> None:
        """Do nothing."""
