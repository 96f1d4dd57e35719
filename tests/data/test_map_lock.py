"""The map's lock: tracking goes first, and the world's coordinates change between frames only."""

import threading
from collections.abc import Callable

import pytest

from stillroom.data.map.map_lock import MapLock

PATIENCE_S = 60.0


def begin(work: Callable[[], None]) -> threading.Thread:
    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    return thread


def waits(thread: threading.Thread) -> bool:
    thread.join(0.2)
    return thread.is_alive()


def ends(thread: threading.Thread) -> None:
    thread.join(PATIENCE_S)
    assert not thread.is_alive(), "it hangs"


def hold(lock: MapLock, seen: list[str], name: str) -> None:
    with lock:
        seen.append(name)


def test_one_thread_holds_it_at_a_time_and_may_take_it_again() -> None:
    lock, seen = MapLock(), []
    with lock, lock:
        other = begin(lambda: hold(lock, seen, "mapping"))
        assert waits(other)
        seen.append("tracking")
    ends(other)
    assert seen == ["tracking", "mapping"]


def test_tracking_is_let_in_before_who_waited_longer() -> None:
    lock, seen, tracked = MapLock(), [], threading.Event()

    def track() -> None:
        with lock.frame():
            seen.append("tracking")
            tracked.set()

    with lock:
        mapping = [begin(lambda: hold(lock, seen, "mapping")) for _ in range(3)]
        assert all(map(waits, mapping))
        tracking = begin(track)
        assert waits(tracking)
    for thread in (tracking, *mapping):
        ends(thread)
    assert seen == ["tracking", "mapping", "mapping", "mapping"]


def test_while_tracking_awaits_a_worker_mapping_may_go_on_but_corrections_may_not() -> None:
    lock, seen = MapLock(), []

    def correct() -> None:
        with lock.between_frames():
            seen.append("corrected")

    with lock.frame():
        with lock.let_go():
            ends(begin(lambda: hold(lock, seen, "mapping")))
            correction = begin(correct)
            assert waits(correction)
        assert waits(correction)
        seen.append("tracked")
    ends(correction)
    assert seen == ["mapping", "tracked", "corrected"]


def test_letting_go_of_what_one_does_not_hold_does_nothing() -> None:
    lock = MapLock()
    with lock.let_go():
        ends(begin(lambda: hold(lock, [], "mapping")))
    with lock.frame(), lock, lock.let_go():
        ends(begin(lambda: hold(lock, [], "mapping")))


def test_who_tracks_may_correct_the_map_within_the_frame() -> None:
    """In order, loops are closed on the thread that tracks."""
    lock = MapLock()
    with lock.frame(), lock.between_frames():
        pass
    with lock.between_frames(), lock:
        pass


def test_an_exception_releases_it() -> None:
    lock = MapLock()
    for context in (lambda: lock, lock.frame, lock.between_frames):
        with pytest.raises(KeyError), context():
            raise KeyError
    ends(begin(lambda: hold(lock, [], "mapping")))
