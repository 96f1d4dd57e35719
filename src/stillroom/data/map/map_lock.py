"""The lock of a map that tracking, mapping and observers share."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import TracebackType


class MapLock:
    """One lock for the map: tracking goes first, and corrections of the whole map come between its frames.

    ``with lock:`` holds it, as mapping does for each of its steps, and whoever reads arrays. It is reentrant. Long
    computations on copies, such as bundle adjustment, are done without it.
    """

    def __init__(self) -> None:
        """Start free."""
        self._changed = threading.Condition(threading.Lock())
        self._holder: int | None = None
        self._depth = 0
        self._tracking: int | None = None  # the thread that is within a frame, holding the lock or not
        self._n_urgent = 0

    def __enter__(self) -> "MapLock":
        """Wait for the lock; the thread that tracks is let in first."""
        self._acquire(urgent=self._tracking == threading.get_ident())
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Release it."""
        self._release()

    @contextmanager
    def frame(self) -> Iterator[None]:
        """Hold the lock to track a frame. The world's coordinates stay the same until the end of the block."""
        self._acquire(urgent=True)
        self._tracking = threading.get_ident()
        try:
            yield
        finally:
            self._tracking = None
            self._release()

    @contextmanager
    def let_go(self) -> Iterator[None]:
        """Release the lock within the block, where this thread holds it: it waits for others meanwhile."""
        depth = self._depth if self._holder == threading.get_ident() else 0
        if depth == 0:
            yield
            return
        with self._changed:
            self._holder, self._depth = None, 0
            self._changed.notify_all()
        try:
            yield
        finally:
            self._acquire(urgent=True)
            self._depth = depth

    @contextmanager
    def between_frames(self) -> Iterator[None]:
        """Hold the lock while no frame is being tracked, to change the world's coordinates."""
        self._acquire(urgent=False, between=True)
        try:
            yield
        finally:
            self._release()

    def _acquire(self, urgent: bool, between: bool = False) -> None:
        me = threading.get_ident()
        if self._holder == me:  # which no other thread can make true or false
            self._depth += 1
            return
        with self._changed:
            self._n_urgent += urgent
            try:
                while self._is_kept_from(me, urgent, between):
                    self._changed.wait()
            finally:
                self._n_urgent -= urgent
            self._holder, self._depth = me, 1

    def _is_kept_from(self, me: int, urgent: bool, between: bool) -> bool:
        if self._holder is not None or (self._n_urgent > 0 and not urgent):
            return True
        return between and self._tracking not in (None, me)

    def _release(self) -> None:
        if self._depth > 1:  # only the holder changes it
            self._depth -= 1
            return
        with self._changed:
            self._holder, self._depth = None, 0
            self._changed.notify_all()
