"""When images are delivered: one after the other, or at their own times."""

import threading
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import pytest

from stillroom.data.image import RgbdImage
from stillroom.datasets.selection import select
from stillroom.errors import CameraError, FrameError
from stillroom.evaluation.timing import StageClock
from stillroom.pipeline.intake import Arrival, Recorded
from stillroom.pipeline.playback import SLOTS, InTurn, Paced
from stillroom.protocols import Dataset

FAST = 1e6
"""So fast that every image is due at once."""


@dataclass(frozen=True)
class Watched(Recorded):
    """Says when all images are there."""

    all_read: threading.Event = field(default_factory=threading.Event)

    def arrivals(self) -> Iterator[Arrival]:
        yield from super().arrivals()
        self.all_read.set()


def go_on() -> bool:
    return False


def test_one_after_the_other_none_is_dropped(room: Dataset) -> None:
    with Paced(Recorded(select(room, ":12")), StageClock(), 0.0) as playback:
        numbers = [delivered.arrival.number for delivered in playback.images(go_on)]
    assert numbers == list(range(12))
    assert playback.dropped == []


@pytest.mark.parametrize(("speed", "n_waits"), [(0.0, 12), (FAST, 0)])
def test_only_where_nothing_is_due_does_an_image_wait_for_mapping(room: Dataset, speed: float, n_waits: int) -> None:
    waits: list[int] = []
    with Paced(Recorded(select(room, ":12")), StageClock(), speed, lambda: waits.append(len(waits))) as playback:
        list(playback.images(go_on))
    assert len(waits) == n_waits


def test_what_is_due_while_tracking_is_late_is_dropped_but_for_the_newest(room: Dataset) -> None:
    intake = Watched(select(room, ":12"))
    with Paced(intake, StageClock(), FAST) as playback:
        images = playback.images(go_on)
        first = next(images)
        second = next(images)  # the clock starts here
        assert intake.all_read.wait(60.0)
        rest = list(images)
    assert first.arrival.number == 0
    dropped = [arrival.number for arrival in playback.dropped]
    delivered = [first.arrival.number, second.arrival.number, *(each.arrival.number for each in rest)]
    assert sorted(dropped + delivered) == list(range(12))
    assert delivered[-SLOTS:] == [10, 11]
    assert len(dropped) >= 12 - 2 - 2 * SLOTS


def test_images_are_due_at_their_own_times_after_the_first_is_tracked(room: Dataset) -> None:
    sequence = select(room, ":6")
    with Paced(Recorded(sequence), StageClock(), 1.0) as playback:
        delivered = list(playback.images(go_on))
    due_s = [each.due_s for each in delivered][1:]
    times_s = [each.arrival.time_s for each in delivered][1:]
    np.testing.assert_allclose(np.diff(due_s), np.diff(times_s), atol=1e-6)


def test_the_following_image_is_known_where_it_is_there(room: Dataset) -> None:
    intake = Watched(select(room, ":3"))
    with Paced(intake, StageClock(), 0.0) as playback:
        images = playback.images(go_on)
        assert intake.all_read.wait(60.0)
        for number in range(3):
            current, following = next(images).image, playback.following()
            assert isinstance(current, RgbdImage)
            assert current.index == number
            assert [image.index for image in following] == list(range(number + 1, 3))
        assert next(images, None) is None


def test_an_image_that_cannot_be_read_is_delivered_as_its_error(room: Dataset) -> None:
    class Broken(Recorded):
        def arrivals(self) -> Iterator[Arrival]:
            for arrival in super().arrivals():
                yield arrival if arrival.number != 1 else Arrival(1, arrival.time_s, torn)

    def torn() -> RgbdImage:
        raise FrameError("torn")

    for playback in (
        Paced(Broken(select(room, ":3")), StageClock(), 0.0),
        InTurn(Broken(select(room, ":3")), StageClock()),
    ):
        with playback:
            kinds = [type(delivered.image) for delivered in playback.images(go_on)]
        assert kinds == [RgbdImage, FrameError, RgbdImage]


@pytest.mark.parametrize("speed", [0.0, 1.0])
def test_a_camera_that_is_gone_says_so_after_what_it_sent(room: Dataset, speed: float) -> None:
    class Pulled(Recorded):
        comes_in_time = True

        def arrivals(self) -> Iterator[Arrival]:
            for arrival in super().arrivals():
                if arrival.number == 2:
                    raise CameraError("gone")
                yield arrival

    with Paced(Pulled(select(room, ":5")), StageClock(), speed) as playback:
        images = playback.images(go_on)
        assert [next(images).arrival.number for _ in range(2)] == [0, 1]
        with pytest.raises(CameraError, match="gone"):
            next(images)


def test_stopping_ends_the_wait_for_a_camera_that_sends_nothing(room: Dataset) -> None:
    silent = threading.Event()

    class Silent(Recorded):
        comes_in_time = True

        def arrivals(self) -> Iterator[Arrival]:
            yield next(super().arrivals())
            silent.wait(60.0)

    asked = threading.Event()
    with Paced(Silent(room), StageClock(), 1.0) as playback:
        for _ in playback.images(asked.is_set):
            threading.Timer(0.05, asked.set).start()
        silent.set()  # the camera gives up
    assert not any(thread.name.startswith("stillroom-images") for thread in threading.enumerate())
