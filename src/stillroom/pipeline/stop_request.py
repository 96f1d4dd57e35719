"""Ctrl-C in the middle of a run."""

import logging
import signal
import threading
from types import FrameType, TracebackType
from typing import Any

log = logging.getLogger(__name__)


class StopRequest:
    """Turns the first Ctrl-C of a block into a flag; the second interrupts at once; while held, none does.

    A frame that is begun is finished, so that map and trajectory are whole when they are written. Signals reach the
    main thread only: on another one this does nothing.
    """

    def __init__(self) -> None:
        self.asked = False
        self._is_held = False
        self._previous: Any = None
        self._tellers: list[threading.Thread] = []

    def __enter__(self) -> "StopRequest":
        """Listen."""
        if threading.current_thread() is threading.main_thread():
            self._previous = signal.signal(signal.SIGINT, self._on_signal)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Give the signal back to whoever had it."""
        if self._previous is not None:
            signal.signal(signal.SIGINT, self._previous)
        for teller in self._tellers:
            teller.join()

    def hold(self) -> None:
        """From now on let no Ctrl-C interrupt: what was tracked is being written."""
        self._is_held = True

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        if self._is_held:
            self.asked = True
            self._tell("the results are being written, which takes a moment")
            return
        if self.asked:
            self.hold()  # Or a third one could come before the results are begun.
            raise KeyboardInterrupt
        self.asked = True
        self._tell("stopping after this frame; Ctrl-C again stops at once")

    def _tell(self, text: str) -> None:
        """Warn from another thread.

        A signal may come in the middle of a line that this thread is writing to where the warning goes, and a writer
        must not be called again from within itself.
        """
        teller = threading.Thread(target=log.warning, args=(text,))
        self._tellers.append(teller)
        teller.start()
