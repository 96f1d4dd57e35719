"""Who is told how a run gets on, and what the log says of it."""

import logging
from typing import Protocol

from stillroom.data.image import RgbdImage
from stillroom.data.result import FrameResult, TrackingState
from stillroom.errors import FrameError

log = logging.getLogger(__name__)

MAX_UNREADABLE = 10
BLACK_BELOW = 8


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


class Remarks:
    """Puts into the log what is odd about a run: one line when it begins, not one for every frame that it lasts."""

    def __init__(self) -> None:
        self._n_unreadable = 0
        self._odd: dict[str, bool] = {}

    def unreadable(self, number: int, error: FrameError) -> None:
        """Remark that an image cannot be read."""
        self._n_unreadable += 1
        if self._n_unreadable <= MAX_UNREADABLE:
            log.warning("image %d is left out: %s", number, error)
        if self._n_unreadable == MAX_UNREADABLE:
            log.warning("further images that cannot be read are left out without a word")

    def frame(self, image: RgbdImage, result: FrameResult) -> None:
        """Remark what is odd about an image, and where tracking is lost and found."""
        is_black = int(image.rgb.max()) < BLACK_BELOW
        self._begins("black", is_black, "image %d is black", image.index)
        no_depth = not is_black and not image.depth_m.any()
        self._begins("no depth", no_depth, "image %d has no depth anywhere", image.index)
        # A black image says by itself why there is no pose.
        was_lost = self._odd.get("lost", False)
        is_lost = result.state is TrackingState.LOST and (was_lost or not is_black)
        self._begins("lost", is_lost, "tracking is lost at image %d", image.index)
        if was_lost and not is_lost:
            log.warning("tracking goes on at image %d", image.index)

    def _begins(self, what: str, is_so: bool, message: str, number: int) -> None:
        if is_so and not self._odd.get(what, False):
            log.warning(message, number)
        self._odd[what] = is_so
