"""What delivers the images of a run: a sequence that was recorded, or a camera that takes them now."""

import math
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from stillroom.data.image import Image
from stillroom.datasets.recording import unpaired_s
from stillroom.errors import FrameError
from stillroom.protocols import CameraStream, Dataset, Origin

FIRST_PICTURE = 30
"""The image of a camera that is drawn first; each further one comes after twice as many, as no one knows the end."""


@dataclass(frozen=True)
class Arrival:
    """An image that is there, or can be read.

    Attributes:
        number: Its number in its sequence, or among those that a camera has taken; `Image.index`.
        time_s: When it was taken [s]; NaN where a camera's image cannot be used and nobody knows.
        load: Returns it; raises FrameError where it cannot be used.
    """

    number: int
    time_s: float
    load: Callable[[], Image] = field(repr=False)


class Intake(Protocol):
    """Delivers the images of a run, once."""

    @property
    def origin(self) -> Origin:
        """Where they come from, with its name, its calibration and its ground truth."""

    @property
    def n_images(self) -> int | None:
        """How many come; None where nobody knows."""

    @property
    def is_reversed(self) -> bool:
        """Whether a recording is played backwards."""

    @property
    def comes_in_time(self) -> bool:
        """Whether images come at their own times, as from a camera."""

    def started(self) -> AbstractContextManager[object]:
        """Return a context in which images come: a camera is started, and stopped after it."""

    def arrivals(self) -> Iterator[Arrival]:
        """Yield the images as they come; that of a recording is read when its `load` is called.

        Raises:
            CameraError: The camera is gone.
        """

    def n_unpaired(self, n_given: int) -> int:
        """Return how many images were left out for want of depth, of the stretch of the first `n_given` images."""

    def spread(self, n: int) -> tuple[int, ...]:
        """Return the numbers of up to `n` images from all over the run."""


@dataclass(frozen=True)
class Recorded:
    """The images of a data set, in order."""

    origin: Dataset

    @property
    def n_images(self) -> int:
        """Number of images."""
        return len(self.origin)

    @property
    def is_reversed(self) -> bool:
        """Whether they are played backwards."""
        return self.origin.is_reversed

    @property
    def comes_in_time(self) -> bool:
        """Return that they do not: all are there."""
        return False

    def started(self) -> AbstractContextManager[object]:
        """Return a context that does nothing: a recording is there."""
        return nullcontext()

    def arrivals(self) -> Iterator[Arrival]:
        """Yield the images, none read yet."""
        dataset = self.origin
        for place in range(len(dataset)):
            number, time_s = int(dataset.numbers[place]), float(dataset.timestamps_s[place])
            yield Arrival(number, time_s, lambda place=place: dataset.load(place))  # type: ignore[misc]

    def n_unpaired(self, n_given: int) -> int:
        """Return how many images were left out for want of depth; of a run that was stopped, up to its last image."""
        lost_s = unpaired_s(self.origin)
        if n_given < len(self.origin):
            lost_s = lost_s[lost_s < self.origin.timestamps_s[n_given]]
        return len(lost_s)

    def spread(self, n: int) -> tuple[int, ...]:
        """Return the middles of equal parts: not the first image, which has no earlier ones, nor the last."""
        numbers = self.origin.numbers
        places = (np.arange(n) + 0.5) * len(numbers) / n
        return tuple(int(number) for number in numbers[np.unique(places.astype(np.int64))])


@dataclass(frozen=True)
class Streamed:
    """The images of a camera, as it takes them; a run needs it entered (see `started`)."""

    origin: CameraStream
    n_images: None = None
    is_reversed: bool = False

    @property
    def comes_in_time(self) -> bool:
        """Whether they do."""
        return self.origin.comes_in_time

    def started(self) -> AbstractContextManager[object]:
        """Return the camera, which starts when it is entered.

        Raises:
            CameraError: On entering: there is none, or it does not start.
        """
        return self.origin

    def arrivals(self) -> Iterator[Arrival]:
        """Wait for one image after the other.

        Raises:
            CameraError: The camera is gone.
        """
        number = -1
        while True:
            try:
                image = self.origin.next()
            except FrameError as error:
                number += 1
                yield Arrival(number, math.nan, _unusable(error))
                continue
            if image is None:
                return
            number = max(number, image.index)
            yield Arrival(image.index, image.timestamp_s, lambda image=image: image)  # type: ignore[misc]

    def n_unpaired(self, n_given: int) -> int:
        """Return 0: a camera gives no image without its depth."""
        return 0

    def spread(self, n: int) -> tuple[int, ...]:
        """Return numbers that double, as nobody knows how many images come."""
        return tuple(FIRST_PICTURE * 2**k for k in range(n))


def intake_of(source: Dataset | Intake) -> Intake:
    """Return what delivers the images of a data set; an intake is returned as it is."""
    return source if isinstance(source, Recorded | Streamed) else Recorded(source)  # type: ignore[arg-type]


def _unusable(error: FrameError) -> Callable[[], Image]:
    def load() -> Image:
        raise error

    return load
