"""The live schedule: workers with bounded queues, and how it ends."""

import os
import sys
import threading

import pytest
from in_time import PATIENCE_S, soon

from stillroom.errors import ConfigError, MapError
from stillroom.schedule import QUEUE, Event, InOrder, LiveSchedule, Worker, schedule_of


def workers() -> list[str]:
    return [thread.name for thread in threading.enumerate() if thread.name.startswith("stillroom-")]


def fail() -> None:
    raise MapError("the disk is full")


def test_work_of_one_worker_keeps_its_order_and_runs_on_its_thread() -> None:
    schedule, seen = LiveSchedule(), []
    for k in range(10):
        schedule.submit(Worker.MAPPING, lambda k=k: seen.append((k, threading.current_thread().name)))
    soon(schedule.close)
    assert [k for k, _ in seen] == list(range(10))
    assert {name for _, name in seen} == {"stillroom-mapping_0"}
    assert schedule.loads[Worker.MAPPING].n_done == 10
    assert workers() == []


def test_workers_wait_for_each_others_results() -> None:
    schedule = LiveSchedule()
    first = schedule.submit(Worker.SEMANTICS, lambda: 20)
    second = schedule.submit(Worker.CLUSTERS, lambda: first.result() + 1)
    assert soon(second.result) == 21
    assert second.done()
    soon(schedule.close)


def test_a_full_queue_makes_the_caller_wait_and_nothing_is_lost() -> None:
    schedule, gate, seen = LiveSchedule(), threading.Event(), []
    schedule.submit(Worker.DENSE, gate.wait)
    n = QUEUE[Worker.DENSE]
    for k in range(n - 1):
        schedule.submit(Worker.DENSE, seen.append, k)
    assert not schedule.keeps_up(Worker.DENSE)
    late = threading.Thread(target=lambda: schedule.submit(Worker.DENSE, seen.append, n), daemon=True)
    late.start()
    late.join(0.2)
    assert late.is_alive(), "a full queue takes nothing more"
    gate.set()
    late.join(PATIENCE_S)
    soon(schedule.close)
    assert seen == [*range(n - 1), n]
    assert schedule.loads[Worker.DENSE].longest == n


def test_work_that_may_be_left_out_is_counted_where_the_worker_is_late() -> None:
    schedule, gate, seen = LiveSchedule(), threading.Event(), []
    schedule.submit(Worker.DENSE, gate.wait)
    for k in range(QUEUE[Worker.DENSE]):
        schedule.offer(Worker.DENSE, seen.append, k)
    gate.set()
    soon(schedule.close)
    n_taken = QUEUE[Worker.DENSE] // 4
    assert seen == list(range(n_taken))
    assert schedule.loads[Worker.DENSE].n_left_out == QUEUE[Worker.DENSE] - n_taken


@pytest.mark.parametrize("where", ["submit", "offer", "close"])
def test_an_exception_that_nobody_awaits_reaches_the_caller_once(where: str) -> None:
    schedule, seen, gate = LiveSchedule(), [], threading.Event()
    schedule.submit(Worker.MAPPING, lambda: gate.wait() and fail())
    dropped = schedule.submit(Worker.MAPPING, seen.append, "after")
    gate.set()
    dropped._future.exception(PATIENCE_S)
    calls = {
        "submit": lambda: schedule.submit(Worker.DENSE, seen.append, 1),
        "offer": lambda: schedule.offer(Worker.DENSE, seen.append, 1),
        "close": schedule.close,
    }
    with pytest.raises(MapError, match="disk is full"):
        soon(calls[where])
    soon(schedule.close)  # it was told once
    assert seen == [], "what was pending is dropped: the map may be half changed"
    assert workers() == []


def test_an_exception_that_is_awaited_is_raised_there_and_not_again() -> None:
    schedule = LiveSchedule()
    answer = schedule.submit(Worker.SEMANTICS, fail)
    with pytest.raises(MapError):
        soon(answer.result)
    soon(schedule.close)
    assert workers() == []


def test_who_awaits_work_that_was_dropped_hears_why() -> None:
    schedule, gate = LiveSchedule(), threading.Event()
    schedule.submit(Worker.MAPPING, lambda: gate.wait() and fail())
    dropped = schedule.submit(Worker.MAPPING, lambda: 1)
    gate.set()
    with pytest.raises(MapError, match="disk is full"):
        soon(dropped.result)
    soon(schedule.close)


def test_a_failure_that_a_worker_meets_first_reaches_the_caller_all_the_same() -> None:
    """As when mapping wants the dense map refreshed, whose worker has failed."""
    schedule, gate, met = LiveSchedule(), threading.Event(), []

    def wants_more() -> None:
        gate.wait()
        try:
            schedule.submit(Worker.DENSE, met.append, "done")
        except BaseException as error:
            met.append(type(error).__name__)
            raise

    mapping = schedule.submit(Worker.MAPPING, wants_more)
    dense = schedule.submit(Worker.DENSE, fail)
    dense._future.exception(PATIENCE_S)
    gate.set()
    mapping._future.exception(PATIENCE_S)
    assert met == ["CancelledError"]
    with pytest.raises(MapError, match="disk is full"):
        schedule.submit(Worker.SEMANTICS, met.append, "next image")
    soon(schedule.close)


def test_no_dense_mapping_begins_while_clusters_are_awaited() -> None:
    """OC-SLAM 2.5: the dense mapping thread is idle until tracking has its clusters."""
    events: list[Event] = []
    schedule, gate = LiveSchedule(events.append), threading.Event()
    clusters = schedule.submit(Worker.CLUSTERS, gate.wait)
    waiting = threading.Thread(target=clusters.result, daemon=True)
    waiting.start()
    while Event(Worker.CLUSTERS, "awaited", "wait") not in events:
        pass
    dense = schedule.submit(Worker.DENSE, lambda: "fused")
    with pytest.raises(TimeoutError):
        dense._future.result(0.2)
    gate.set()
    waiting.join(PATIENCE_S)
    assert soon(dense.result) == "fused"
    soon(schedule.close)
    whats = [(event.worker, event.what) for event in events]
    assert whats.index((Worker.CLUSTERS, "ends")) < whats.index((Worker.DENSE, "begins"))


def test_who_lets_a_worker_catch_up_waits_until_a_quarter_of_its_queue_is_left() -> None:
    schedule, gates = LiveSchedule(), [threading.Event() for _ in range(QUEUE[Worker.MAPPING] // 4 + 1)]
    for gate in gates:
        schedule.submit(Worker.MAPPING, gate.wait, PATIENCE_S)
    caught_up = threading.Event()

    def wait() -> None:
        schedule.catch_up(Worker.MAPPING, Worker.DENSE)
        caught_up.set()

    waiting = threading.Thread(target=wait)
    waiting.start()
    assert not caught_up.wait(0.2)
    gates[0].set()
    assert caught_up.wait(PATIENCE_S)
    for gate in gates:
        gate.set()
    waiting.join()
    schedule.close()


def test_nobody_waits_for_a_worker_to_catch_up_once_another_has_failed() -> None:
    schedule, begin, hold = LiveSchedule(), threading.Event(), threading.Event()
    for _ in range(QUEUE[Worker.MAPPING] // 2):
        schedule.submit(Worker.MAPPING, hold.wait, PATIENCE_S)
    schedule.submit(Worker.CLUSTERS, lambda: begin.wait(PATIENCE_S) and fail())
    begin.set()
    schedule.catch_up(Worker.MAPPING)
    assert schedule.loads[Worker.MAPPING].n_done == 0, "it waited for mapping all the same"
    hold.set()
    with pytest.raises(MapError, match="disk"):
        schedule.close()


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere a thread has its process's priority")
def test_the_worker_that_nobody_waits_for_has_a_lower_priority() -> None:
    def own() -> int:
        return os.getpriority(os.PRIO_PROCESS, threading.get_native_id())

    schedule, here = LiveSchedule(), own()
    found = {worker: schedule.submit(worker, own).result() for worker in Worker}
    schedule.close()
    assert {worker for worker, value in found.items() if value > here} == {Worker.DENSE}
    assert own() == here


def test_once_closed_work_runs_at_once() -> None:
    schedule = LiveSchedule()
    schedule.submit(Worker.DENSE, threading.get_ident)
    soon(schedule.close)
    assert schedule.submit(Worker.DENSE, threading.get_ident).result() == threading.get_ident()
    assert workers() == []


def test_schedules_by_name() -> None:
    assert isinstance(schedule_of("in-order"), InOrder)
    assert isinstance(schedule_of("live"), LiveSchedule)
    with pytest.raises(ConfigError, match="schedule is 'lief'; it must be one of in-order, live"):
        schedule_of("lief")
