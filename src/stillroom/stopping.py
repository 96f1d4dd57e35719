"""The signals that ask the process to end: Ctrl-C, a request to terminate, a console that is closed.

A supervisor sends SIGTERM, a terminal that is closed SIGHUP (SIGBREAK on Windows). All of them mean what Ctrl-C means:
stop, and keep what there is. What a shell reports is 128 and the signal's number: 130, 143, 129.
"""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

INTERRUPTED = 128 + int(signal.SIGINT)
"""Exit code after Ctrl-C."""

ENDING = tuple(
    getattr(signal, name) for name in ("SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, name)
)  # what of these the system has
"""The signals that ask for the end and are not Ctrl-C."""

Handler = Callable[[int, FrameType | None], None]

_last = int(signal.SIGINT)


class TerminatedError(KeyboardInterrupt):
    """The process was asked to end while nothing was going on that could be brought to an end of its own."""


def note(number: int) -> None:
    """Remember which signal asked last."""
    global _last
    _last = number


def exit_code() -> int:
    """Return the exit code of a command that was asked to stop: 128 and the number of the signal that asked last."""
    return 128 + _last


def install(handler: Handler, numbers: tuple[int, ...]) -> dict[int, Any]:
    """Let a handler hear signals; what the process was started to ignore, as under `nohup`, stays ignored.

    Returns:
        What heard each signal before; nothing on another thread than the main one, where no signal can be heard.
    """
    if threading.current_thread() is not threading.main_thread():
        return {}
    before = {number: signal.getsignal(number) for number in numbers}
    heard = {
        number: known
        for number, known in before.items()
        if known is not None and (known is not signal.SIG_IGN or number == signal.SIGINT)
    }
    for number in heard:
        signal.signal(number, handler)
    return heard


def put_back(before: dict[int, Any]) -> None:
    """Give signals back to whoever heard them."""
    for number, known in before.items():
        signal.signal(number, known)


@contextmanager
def as_ctrl_c() -> Iterator[None]:
    """Let every signal of `ENDING` interrupt the block as Ctrl-C does.

    Raises:
        TerminatedError: From wherever the block is when the signal comes.
    """
    note(int(signal.SIGINT))

    def interrupt(number: int, frame: FrameType | None) -> None:
        note(number)
        raise TerminatedError

    before = install(interrupt, ENDING)
    try:
        yield
    finally:
        put_back(before)
