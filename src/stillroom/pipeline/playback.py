"""When the images of a run are delivered: one after the other, or at their own times as a camera does."""

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from itertools import islice
from types import TracebackType
from typing import Protocol

from stillroom.data.image import Image
from stillroom.errors import FrameError
from stillroom.evaluation.timing import StageClock
from stillroom.pipeline.intake import Arrival, Intake

LOADING = "loading"
SLOTS = 2
"""How many images a camera keeps until they are taken; one more takes the place of the oldest."""
MOST_BEGUN = 3
"""How many images are begun before they are taken: all workers have enough to do then."""
READ_AHEAD = 4
"""How many images are read before they are taken, where none is ever dropped."""
POLL_S = 0.1


@dataclass(frozen=True)
class Delivered:
    """An image as it is delivered.

    Attributes:
        arrival: The image's number and time.
        image: The image, or what is wrong with it.
        due_s: When it was due, by `time.perf_counter` [s].
    """

    arrival: Arrival
    image: Image | FrameError
    due_s: float


class Playback(Protocol):
    """Delivers images; a context, which is left after the last one.

    Attributes:
        dropped: Images that were due while tracking was late.
    """

    dropped: list[Arrival]

    def __enter__(self) -> "Playback":
        """Begin to deliver."""

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Leave no thread."""

    def images(self, stopped: Callable[[], bool]) -> Iterator[Delivered]:
        """Yield images until the last one, or until `stopped` returns true.

        Raises:
            CameraError: The camera is gone.
        """

    def following(self) -> list[Image]:
        """Return the images that will be delivered next, as far as they are there already."""


class InTurn:
    """Reads one image when the one before it is done."""

    def __init__(self, intake: Intake, clock: StageClock) -> None:
        """Take the images, and the clock that times the reading."""
        self._intake, self._clock = intake, clock
        self.dropped: list[Arrival] = []

    def __enter__(self) -> "InTurn":
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Do nothing."""

    def images(self, stopped: Callable[[], bool]) -> Iterator[Delivered]:
        """Yield the images; see `Playback.images`."""
        for arrival in self._intake.arrivals():
            if stopped():
                return
            with self._clock.stage(LOADING):
                image = _read(arrival)
            yield Delivered(arrival, image, time.perf_counter())

    def following(self) -> list[Image]:
        """Return none: they are not read yet."""
        return []


class Paced:
    """Reads images on a thread of its own, and delivers them at their own times or as fast as they are taken.

    The first image is waited for until it is tracked, as networks and kernels are loaded then: a camera is started
    when everything is ready. From there the clock runs. Of the images that are due while tracking is late the newest
    `SLOTS` are kept, or the one whose work was begun and the newest.
    """

    def __init__(
        self, intake: Intake, clock: StageClock, speed: float, catch_up: Callable[[], None] = lambda: None
    ) -> None:
        """Take the images.

        Args:
            intake: Delivers them. One whose images come at their own times is not paced again.
            clock: Times the reading.
            speed: How many seconds of a recording are played in one; 0 delivers an image as soon as it is asked for
                and mapping keeps up, and drops none.
            catch_up: Waits until mapping keeps up. Where no image is due, none is tracked in a map that lags behind:
                keyframes are left out then, and poses are less exact.
        """
        self._intake, self._clock, self._speed, self._catch_up = intake, clock, speed, catch_up
        self._changed = threading.Condition()
        self._ready: deque[Delivered] = deque()
        self._started_s: float | None = None
        self._is_left = False
        self._n_begun = 0
        self._executor = ThreadPoolExecutor(1, thread_name_prefix="stillroom-images")
        self._reader: Future[None] = Future()
        self.dropped: list[Arrival] = []

    def __enter__(self) -> "Paced":
        """Begin to read."""
        self._reader = self._executor.submit(self._deliver_all)
        self._reader.add_done_callback(self._tell)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Stop reading; a camera that sends nothing is given up when it says so itself."""
        with self._changed:
            self._is_left = True
            self._changed.notify_all()
        self._executor.shutdown()

    def images(self, stopped: Callable[[], bool]) -> Iterator[Delivered]:
        """Yield the images; see `Playback.images`."""
        is_first = True
        while True:
            with self._changed:
                if not is_first and self._started_s is None:
                    self._started_s = time.perf_counter()
                    self._changed.notify_all()
                while not self._ready and not self._reader.done() and not stopped():
                    self._changed.wait(POLL_S)
                if stopped():
                    return
                if not self._ready:
                    self._reader.result()  # raises what went wrong
                    return
                delivered = self._ready.popleft()
                self._n_begun = max(0, self._n_begun - 1)
                self._changed.notify_all()
            is_first = False
            if self._speed == 0:
                self._catch_up()
            yield delivered

    def following(self) -> list[Image]:
        """Return the images that will be delivered next, as far as they are there already; they are not dropped."""
        with self._changed:
            # At their own times the last slot is left to the newest image.
            n = SLOTS - 1 if self._speed > 0 else MOST_BEGUN
            coming = [delivered.image for delivered in islice(self._ready, n)]
            begun: list[Image] = []
            for image in coming:
                if isinstance(image, FrameError):
                    break
                begun.append(image)
            self._n_begun = len(begun)
        return begun

    def _tell(self, reader: "Future[None]") -> None:
        with self._changed:
            self._changed.notify_all()

    def _deliver_all(self) -> None:
        first: Arrival | None = None
        for arrival in self._intake.arrivals():
            with self._clock.stage(LOADING):
                image = _read(arrival)
            first = first or arrival
            due_s = self._wait_until_due(arrival, first)
            with self._changed:
                if self._is_left:
                    return
                if self._speed > 0 and len(self._ready) >= SLOTS:
                    self.dropped.append(self._ready[self._n_begun].arrival)
                    del self._ready[self._n_begun]
                self._ready.append(Delivered(arrival, image, due_s))
                self._changed.notify_all()

    def _wait_until_due(self, arrival: Arrival, first: Arrival) -> float:
        """Wait for the moment at which an image is to be delivered, and return it."""
        with self._changed:
            if self._speed == 0:
                self._changed.wait_for(lambda: len(self._ready) < READ_AHEAD or self._is_left)
                return time.perf_counter()
            if self._intake.comes_in_time or arrival is first:
                return time.perf_counter()
            self._changed.wait_for(lambda: self._started_s is not None or self._is_left)
            since_s = (arrival.time_s - first.time_s) / self._speed
            due_s = (self._started_s or 0.0) + (since_s if since_s == since_s else 0.0)
            while not self._is_left and (left_s := due_s - time.perf_counter()) > 0:
                self._changed.wait(left_s)
            return due_s


def _read(arrival: Arrival) -> Image | FrameError:
    try:
        return arrival.load()
    except FrameError as error:
        return error
