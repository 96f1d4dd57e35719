"""Who is told how a run gets on."""

from typing import Protocol

from stillroom.data.result import FrameResult


class Progress(Protocol):
    """Is told of each frame, such as by a progress bar."""

    def start(self, n_frames: int) -> None:
        """Take note that so many frames will come."""

    def frame(self, result: FrameResult | None) -> None:
        """Take note of a frame; None is one that could not be read."""

    def finish(self) -> None:
        """Take note that no frame will come any more."""


class Silent:
    """Tells nobody."""

    def start(self, n_frames: int) -> None:
        """Do nothing."""

    def frame(self, result: FrameResult | None) -> None:
        """Do nothing."""

    def finish(self) -> None:
        """Do nothing."""


SILENT = Silent()
