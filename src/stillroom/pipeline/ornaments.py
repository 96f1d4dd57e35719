"""Pictures and plots, which are looked at and nothing more: one that fails must not end a run."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager

import cv2

from stillroom.data.result import FrameResult, Tracked
from stillroom.data.semantics import Semantics
from stillroom.errors import StillroomError
from stillroom.protocols import RunObserver

log = logging.getLogger(__name__)
FAILURES = (
    StillroomError,
    ArithmeticError,
    ImportError,
    LookupError,
    MemoryError,
    OSError,
    RuntimeError,
    TypeError,
    ValueError,
    cv2.error,
)
"""What drawing may end with: a disk without room, a plotting library that does not import, a plot of odd numbers."""


@contextmanager
def ending_nothing(what: str) -> Iterator[None]:
    """Let a block that makes something to look at fail: that is one warning, which says what."""
    try:
        yield
    except FAILURES as error:
        log.warning("%s: %s [see troubleshooting: pictures]", what, str(error) or type(error).__name__)


class Ornaments:
    """Counts the pictures that could not be made, and warns of the first.

    Attributes:
        n_failed: How many there are.
        n_not_shown: Frames that a viewer did not show, as it had failed.
    """

    def __init__(self) -> None:
        self.n_failed = 0
        self.n_not_shown = 0

    @contextmanager
    def drawing(self) -> Iterator[None]:
        """Let a block that makes one picture fail."""
        try:
            yield
        except FAILURES as error:
            if self.n_failed == 0:
                log.warning(
                    "a picture is left out: %s; further ones without a word [see troubleshooting: pictures]",
                    str(error) or type(error).__name__,
                )
            self.n_failed += 1


class Ornamental:
    """An observer that makes pictures, and whose failures do not reach the run."""

    def __init__(self, inner: RunObserver, ornaments: Ornaments) -> None:
        """Stand between a run and an observer."""
        self._inner, self._ornaments = inner, ornaments

    def on_frame(self, tracked: Tracked, semantics: Semantics, result: FrameResult) -> None:
        """Let it look at a frame."""
        with self._ornaments.drawing():
            self._inner.on_frame(tracked, semantics, result)
