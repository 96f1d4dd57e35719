"""Being asked to stop in the middle of a run."""

import logging
import signal
import threading
from types import FrameType, TracebackType
from typing import Any

from stillroom import stopping

log = logging.getLogger(__name__)
ROW = "[see troubleshooting: interrupted]"


class StopRequest:
    """Turns the signals that ask a block to end into a flag; a second Ctrl-C interrupts at once; while held, none does.

    A frame that is begun is finished, so that map and trajectory are whole when they are written. Only Ctrl-C is
    pressed by somebody who can grow impatient: a terminal that is closed sends its signal more than once. Signals reach
    the main thread only: on another one this does nothing.

    Attributes:
        asked: Whether anybody asked.
    """

    def __init__(self) -> None:
        self.asked = False
        self._is_held = False
        self._previous: dict[int, Any] = {}
        self._tellers: list[threading.Thread] = []

    def __enter__(self) -> "StopRequest":
        """Listen."""
        self._previous = stopping.install(self._on_signal, (signal.SIGINT, *stopping.ENDING))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Give the signals back to whoever had them."""
        stopping.put_back(self._previous)
        for teller in self._tellers:
            teller.join()

    def hold(self) -> None:
        """From now on let no signal interrupt: what was tracked is being written."""
        self._is_held = True

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        stopping.note(number)
        if self._is_held:
            self.asked = True
            self._tell(f"the results are being written, which takes a moment {ROW}")
            return
        if self.asked and number == signal.SIGINT:
            self.hold()  # Or a third one could come before the results are begun.
            raise KeyboardInterrupt
        if not self.asked:
            self.asked = True
            self._tell(f"stopping after this frame; Ctrl-C again stops at once {ROW}")

    def _tell(self, text: str) -> None:
        """Warn from another thread.

        A signal may come in the middle of a line that this thread is writing to where the warning goes, and a writer
        must not be called again from within itself.
        """
        teller = threading.Thread(target=log.warning, args=(text,))
        self._tellers.append(teller)
        teller.start()
