"""Work that must not hang: a test of it fails instead."""

import threading
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")
PATIENCE_S = 120.0
"""Longer than any of this takes."""


def soon(work: Callable[[], T]) -> T:
    """Return what a function returns on another thread, or raise what it raises; fail where it hangs."""
    found: list[T] = []
    raised: list[BaseException] = []

    def try_it() -> None:
        try:
            found.append(work())
        except BaseException as error:  # noqa: BLE001 - raised below
            raised.append(error)

    thread = threading.Thread(target=try_it, daemon=True)
    thread.start()
    thread.join(PATIENCE_S)
    assert not thread.is_alive(), "it hangs"
    if raised:
        raise raised[0]
    return found[0]
