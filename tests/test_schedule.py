"""The schedule that runs work at once."""

import threading

import pytest

from stillroom.errors import FrameError
from stillroom.schedule import InOrder, Worker


def test_work_runs_at_once_on_the_callers_thread() -> None:
    ran: list[object] = []
    schedule = InOrder()
    pending = schedule.submit(Worker.MAPPING, lambda a, b: ran.append((a, b, threading.get_ident())), 1, b=2)
    assert ran == [(1, 2, threading.get_ident())]
    assert pending.result() is None
    assert len(ran) == 1, "asking for the answer does not run the work again"
    schedule.close()


def test_answers_come_back_in_any_order() -> None:
    schedule = InOrder()
    answers = [schedule.submit(Worker.MAPPING, pow, k, 2) for k in range(5)]
    assert [answer.result() for answer in reversed(answers)] == [16, 9, 4, 1, 0]


def test_what_the_work_raises_reaches_the_caller() -> None:
    def fail() -> None:
        raise FrameError("frame 3: no depth")

    with pytest.raises(FrameError, match="frame 3"):
        InOrder().submit(Worker.MAPPING, fail).result()


def test_keywords_of_the_work_may_be_called_anything() -> None:
    assert InOrder().submit(Worker.MAPPING, dict, work=1, self=2, worker=3).result() == {
        "work": 1,
        "self": 2,
        "worker": 3,
    }
