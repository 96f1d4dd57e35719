"""When submitted work runs: at once, or on worker threads. The threads of the papers are one possible schedule."""

import os
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from dataclasses import dataclass
from enum import Enum, StrEnum
from typing import Generic, ParamSpec, TypeVar

from stillroom.errors import ConfigError

P = ParamSpec("P")
T = TypeVar("T")


class ScheduleName(StrEnum):
    """The two schedules."""

    IN_ORDER = "in-order"
    LIVE = "live"


class Worker(Enum):
    """Who does a piece of work; under the live schedule each is a thread with a queue of its own."""

    FEATURES = "features"
    SEMANTICS = "semantics"
    NETWORK = "network"
    """A network that is too slow for every image: its results are awaited by nobody, and come when they come."""
    CLUSTERS = "clusters"
    MAPPING = "mapping"
    DENSE = "dense"
    VIEWER = "viewer"


@dataclass(frozen=True)
class Done(Generic[T]):
    """A result that is already available."""

    value: T

    def result(self) -> T:
        """Return the result."""
        return self.value

    def done(self) -> bool:
        """Return that it is available."""
        return True


# In order.


class InOrder:
    """Run work at once, on the caller's thread: the same input gives the same trajectory, byte for byte."""

    def submit(self, worker: Worker, work: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Done[T]:
        """Run the work now and return its result."""
        return Done(work(*args, **kwargs))

    def offer(self, worker: Worker, work: Callable[P, object], /, *args: P.args, **kwargs: P.kwargs) -> None:
        """Run the work now."""
        work(*args, **kwargs)

    def keeps_up(self, worker: Worker) -> bool:
        """Return that it does: nothing is ever left to do."""
        return True

    def close(self) -> None:
        """Do nothing: all work is done when `submit` returns."""


# Live.

QUEUE = {
    Worker.FEATURES: 4,
    Worker.SEMANTICS: 4,
    Worker.NETWORK: 1,
    Worker.CLUSTERS: 4,
    Worker.MAPPING: 40,
    Worker.DENSE: 12,
    Worker.VIEWER: 4,
}
"""How many pieces of work may be pending with each worker; a caller that submits more has to wait."""
NICENESS = {Worker.DENSE: 10}
"""By how much a worker stands back, where there are fewer cores than workers: nobody waits for the dense map."""


@dataclass
class Load:
    """What a worker did.

    Attributes:
        n_done: Pieces of work that it did.
        n_left_out: Pieces of work that were offered to it and left out, because it had not kept up.
        busy_s, cpu_s: Wall time and CPU time that they took [s].
        longest: The most pieces of work that were pending with it at a time.
    """

    n_done: int = 0
    n_left_out: int = 0
    busy_s: float = 0.0
    cpu_s: float = 0.0
    longest: int = 0


@dataclass(frozen=True)
class Event:
    """Something that happened on the live schedule.

    Attributes:
        worker: Whose work it concerns.
        what: "begins" or "ends", of a piece of work; "awaited" and "answered", where a caller had to wait for one.
        work: Name of the function.
    """

    worker: Worker
    what: str
    work: str


class _Answer(Generic[T]):
    """The result of work on another thread."""

    def __init__(self, future: Future[T], worker: Worker, work: str, schedule: "LiveSchedule") -> None:
        self._future, self._worker, self._work, self._schedule = future, worker, work, schedule

    def result(self) -> T:
        """Wait for the result and return it; raise the exception of the work."""
        if self._future.done():
            return self._schedule.told(self._future)
        with self._schedule.awaiting(self._worker, self._work):
            return self._schedule.told(self._future)

    def done(self) -> bool:
        """Return whether it is available."""
        return self._future.done()


class _Awaiting:
    """Notes that a caller waits for a worker."""

    def __init__(self, schedule: "LiveSchedule", event: Event) -> None:
        self._schedule, self._event = schedule, event

    def __enter__(self) -> None:
        self._schedule.wait_begins(self._event)

    def __exit__(self, *_: object) -> None:
        self._schedule.wait_ends(self._event)


class LiveSchedule:
    """Every worker on a thread of its own, with a bounded queue; work of one worker keeps its order.

    An exception of work whose result nobody asks for reaches the caller at the next `submit`, `offer` or `close`; what
    is pending then is dropped, and so is work that submits more. Closed, it runs work at once.

    Attributes:
        loads: What each worker did, of those that had any work.
    """

    def __init__(self, listen: Callable[[Event], None] | None = None) -> None:
        """Start without threads.

        Args:
            listen: Called with every event, on the thread on which it happens.
        """
        self.loads: dict[Worker, Load] = {}
        self._listen = listen
        self._changed = threading.Condition()
        self._executors: dict[Worker, ThreadPoolExecutor] = {}
        self._pending: dict[Worker, int] = {}
        self._failure: BaseException | None = None
        self._is_heard = False
        self._is_closed = False
        self._n_waiting_for_clusters = 0
        self._here = threading.local()

    def submit(
        self, worker: Worker, work: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs
    ) -> "_Answer[T] | Done[T]":
        """Let a worker do a piece of work; wait while its queue is full.

        Raises:
            BaseException: What a worker raised that was not told yet.
        """
        self._raise_failure()
        if self._is_closed:
            return Done(work(*args, **kwargs))
        # Mapping is submitted within a frame, for the end of which a correction of the map may be waiting: waiting here
        # for mapping could be waiting for ever. `keeps_up`, which is asked before, bounds its queue.
        if worker is not Worker.MAPPING:
            with self._changed:
                self._changed.wait_for(
                    lambda: self._pending.get(worker, 0) < QUEUE[worker] or self._failure is not None
                )
        return self._start(worker, work, *args, **kwargs)

    def offer(self, worker: Worker, work: Callable[P, object], /, *args: P.args, **kwargs: P.kwargs) -> None:
        """Let a worker do a piece of work while it has little to do; what is left out is counted.

        Raises:
            BaseException: As `submit`.
        """
        self._raise_failure()
        if self._has_little(worker):
            self._start(worker, work, *args, **kwargs)
        else:
            self._load(worker).n_left_out += 1

    def keeps_up(self, worker: Worker) -> bool:
        """Return whether the worker's queue is no more than half full."""
        return self._pending.get(worker, 0) <= QUEUE[worker] // 2

    def catch_up(self, *workers: Worker) -> None:
        """Wait until workers have little to do, or one has failed."""
        with self._changed:
            self._changed.wait_for(lambda: self._failure is not None or all(map(self._has_little, workers)))

    def close(self) -> None:
        """Let the workers finish what they have, and end their threads.

        Raises:
            BaseException: As `submit`.
        """
        for executor in self._executors.values():
            executor.shutdown(wait=True)
        self._executors.clear()
        self._is_closed = True
        self._raise_failure()

    def awaiting(self, worker: Worker, work: str) -> _Awaiting:
        """Return a context in which a caller waits for a worker."""
        return _Awaiting(self, Event(worker, "awaited", work))

    def wait_begins(self, event: Event) -> None:
        """Note that a caller waits: where it is for clusters, no dense mapping begins meanwhile."""
        self._say(event)
        with self._changed:
            self._n_waiting_for_clusters += event.worker is Worker.CLUSTERS

    def wait_ends(self, event: Event) -> None:
        """Note that it has waited."""
        with self._changed:
            self._n_waiting_for_clusters -= event.worker is Worker.CLUSTERS
            self._changed.notify_all()
        self._say(Event(event.worker, "answered", event.work))

    def told(self, future: Future[T]) -> T:
        """Return the result of a future; raise its exception, or that for which it was dropped, which is then told."""
        try:
            return future.result()
        except CancelledError:
            if self._failure is None or self._is_worker:
                raise
            self._is_heard = True
            raise self._failure from None
        except BaseException as error:
            self._is_heard |= error is self._failure and not self._is_worker
            raise

    def _start(self, worker: Worker, work: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> _Answer[T]:
        name = getattr(work, "__name__", type(work).__name__)
        with self._changed:
            self._pending[worker] = self._pending.get(worker, 0) + 1
            load = self._load(worker)
            load.longest = max(load.longest, self._pending[worker])
        future = self._executor(worker).submit(self._do, worker, name, lambda: work(*args, **kwargs))
        return _Answer(future, worker, name, self)

    def _do(self, worker: Worker, name: str, work: Callable[[], T]) -> T:
        """Do a piece of work on the worker's thread."""
        load = self._load(worker)
        self._here.is_worker = True
        try:
            if worker is Worker.DENSE:
                with self._changed:
                    self._changed.wait_for(lambda: self._n_waiting_for_clusters == 0)
            if self._failure is not None:
                raise CancelledError
            self._say(Event(worker, "begins", name))
            wall_s, cpu_s = time.perf_counter(), time.thread_time()
            try:
                return work()
            finally:
                load.busy_s += time.perf_counter() - wall_s
                load.cpu_s += time.thread_time() - cpu_s
                load.n_done += 1
                self._say(Event(worker, "ends", name))
        except BaseException as error:
            if self._failure is None:
                self._failure = error
            raise
        finally:
            with self._changed:
                self._pending[worker] -= 1
                self._changed.notify_all()

    def _has_little(self, worker: Worker) -> bool:
        """Return whether the worker's queue is no more than a quarter full."""
        return self._pending.get(worker, 0) <= QUEUE[worker] // 4

    def _executor(self, worker: Worker) -> ThreadPoolExecutor:
        if worker not in self._executors:
            name = f"stillroom-{worker.value}"
            self._executors[worker] = ThreadPoolExecutor(1, name, _stand_back, (NICENESS.get(worker, 0),))
        return self._executors[worker]

    def _load(self, worker: Worker) -> Load:
        return self.loads.setdefault(worker, Load())

    @property
    def _is_worker(self) -> bool:
        """Whether the calling thread is a worker's: what one hears of a failure is not told to the caller."""
        return getattr(self._here, "is_worker", False)

    def _raise_failure(self) -> None:
        if self._failure is None:
            return
        if self._is_worker:
            raise CancelledError
        if not self._is_heard:
            self._is_heard = True
            raise self._failure

    def _say(self, event: Event) -> None:
        if self._listen is not None:
            self._listen(event)


def _stand_back(niceness: int) -> None:
    """Give the calling thread a lower priority, where a thread of a process can have its own."""
    if sys.platform == "linux" and niceness > 0:
        own = threading.get_native_id()
        os.setpriority(os.PRIO_PROCESS, own, min(os.getpriority(os.PRIO_PROCESS, own) + niceness, 19))


def schedule_of(name: str) -> InOrder | LiveSchedule:
    """Return a new schedule by its name.

    Raises:
        ConfigError: There is none of that name.
    """
    try:
        return LiveSchedule() if ScheduleName(name) is ScheduleName.LIVE else InOrder()
    except ValueError:
        raise ConfigError(f"schedule is '{name}'; it must be one of {', '.join(ScheduleName)}") from None
