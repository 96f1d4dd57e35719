"""The stage clock by clocks that the test turns, the file it writes, and the unit."""

import csv
import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from stillroom.evaluation.timing import FRAME, PROCESS_STATUS, StageClock, peak_memory_mb, unit_ms
from stillroom.geometry.arrays import U8


class Hands:
    """Two clocks that the test turns itself: one on the wall, and one for the CPU time of each thread [ns]."""

    def __init__(self) -> None:
        self._lock, self._wall_ns, self._own = threading.Lock(), 0, threading.local()

    def clock(self) -> StageClock:
        return StageClock(wall_ns=lambda: self._wall_ns, cpu_ns=self.cpu_ns)

    def cpu_ns(self) -> int:
        return getattr(self._own, "cpu_ns", 0)

    def sleep(self, ms: int) -> None:
        with self._lock:
            self._wall_ns += ms * 1_000_000

    def burn(self, ms: int) -> str:
        """Work on this thread; `sleep` passes without the CPU."""
        self._own.cpu_ns = self.cpu_ns() + ms * 1_000_000
        self.sleep(ms)
        return "done"


def test_wall_and_cpu_time_are_told_apart() -> None:
    hands = Hands()
    clock = hands.clock()
    for _ in range(3):
        with clock.stage("sleeping"):
            hands.sleep(10)
        assert clock.timed("working", hands.burn)(ms=5) == "done"
        clock.next_frame()
    times = {t.stage: t for t in clock.summary()}
    assert (times["sleeping"].wall_median_ms, times["sleeping"].cpu_median_ms) == (10, 0)
    assert (times["working"].wall_median_ms, times["working"].cpu_median_ms) == (5, 5)
    assert [t.stage for t in clock.summary()] == ["working", "sleeping"]


def test_the_clocks_of_a_real_system_are_the_wall_and_the_thread() -> None:
    clock = StageClock()
    assert (clock._wall_ns, clock._cpu_ns) == (time.perf_counter_ns, time.thread_time_ns)


def test_calls_in_a_frame_add_up_and_rare_stages_count_with_their_share() -> None:
    hands = Hands()
    clock = hands.clock()
    for index in range(4):
        with clock.stage(FRAME):
            clock.timed("often", hands.burn)(2)
            clock.timed("often", hands.burn)(2)
            if index == 3:
                clock.timed("rare", hands.burn)(8)
        clock.next_frame()
    times = {t.stage: t for t in clock.summary()}
    assert clock.n_frames == 4
    assert (times["rare"].n_frames, times["often"].n_frames) == (1, 4)
    assert (times["often"].cpu_median_ms, times["rare"].cpu_median_ms) == (4, 8)
    assert (times["rare"].cpu_mean_ms, times["rare"].wall_mean_ms) == (2, 2)
    assert (times[FRAME].cpu_median_ms, times[FRAME].cpu_mean_ms) == (4, 6)
    assert times[FRAME].cpu_p95_ms == pytest.approx(np.percentile([4, 4, 4, 12], 95))
    assert times[FRAME].wall_p95_ms == pytest.approx(np.percentile([4, 4, 4, 12], 95))


def test_a_stage_that_fails_is_timed_and_its_error_passes() -> None:
    hands = Hands()
    clock = hands.clock()

    def fail() -> None:
        hands.burn(3)
        raise KeyError

    with pytest.raises(KeyError):
        clock.timed("failing", fail)()
    clock.next_frame()
    assert [(t.stage, t.cpu_mean_ms) for t in clock.summary()] == [("failing", 3)]


def test_other_threads_are_timed_by_their_own_cpu_clock() -> None:
    hands = Hands()
    clock = hands.clock()
    hands.burn(100)
    workers = [threading.Thread(target=clock.timed("mapping", hands.burn), args=(4,)) for _ in range(4)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    clock.next_frame()
    assert clock.summary()[0].cpu_mean_ms == 16


def test_what_comes_after_the_last_frame_counts_as_its_own() -> None:
    hands = Hands()
    clock = hands.clock()
    clock.timed("resting", hands.burn)(2)
    clock.conclude()  # no frame yet: nothing to count it for
    for _ in range(2):
        clock.timed("working", hands.burn)(2)
        clock.next_frame()
    clock.timed("working", hands.burn)(4)
    clock.timed("resting", hands.burn)(4)
    clock.conclude()
    clock.conclude()
    times = {t.stage: t for t in clock.summary()}
    assert clock.n_frames == 2
    assert times["working"].cpu_mean_ms == 4
    assert (times["resting"].n_frames, times["resting"].cpu_mean_ms) == (1, 2)


def test_nothing_timed_gives_an_empty_summary() -> None:
    assert StageClock().summary() == []


def test_the_file_has_a_line_for_each_frame(tmp_path: Path) -> None:
    hands = Hands()
    clock = hands.clock()
    for index in (200, 201):
        clock.timed("orb", hands.burn)(1)
        if index == 201:
            with clock.stage("bundle"):
                hands.burn(2)
                hands.sleep(1)
        clock.next_frame(index)
    clock.write_csv(tmp_path / "timing.csv")
    with (tmp_path / "timing.csv").open() as file:
        first, second = csv.DictReader(file)
    assert (first["frame"], second["frame"]) == ("200", "201")
    assert list(first) == ["frame", "orb_wall_ms", "orb_cpu_ms", "bundle_wall_ms", "bundle_cpu_ms"]
    assert first["bundle_wall_ms"] == first["bundle_cpu_ms"] == ""
    assert (float(second["bundle_wall_ms"]), float(second["bundle_cpu_ms"])) == (3, 2)
    assert float(first["orb_cpu_ms"]) == 1


def test_the_unit_is_what_orb_costs_and_threads_are_left_as_they_were(monkeypatch: pytest.MonkeyPatch) -> None:
    real, seen, hands = cv2.ORB.create, [], Hands()

    class Orb:
        """OpenCV's, at 7 ms an image, after 50 ms for the first one."""

        def __init__(self, n_features: int) -> None:
            assert n_features == 1000
            self._orb = real(n_features)

        def detectAndCompute(self, image: U8, mask: None) -> object:
            hands.burn(7 if seen else 50)
            seen.append((cv2.getNumThreads(), len(self._orb.detectAndCompute(image, mask)[0])))
            return seen

    monkeypatch.setattr(cv2.ORB, "create", Orb)
    images = [np.random.default_rng(i).integers(0, 255, (480, 640), dtype=np.uint8) for i in range(4)]
    before = cv2.getNumThreads()
    cv2.setNumThreads(2)
    try:
        assert unit_ms(images, hands.cpu_ns) == pytest.approx(7)
        assert cv2.getNumThreads() == 2
    finally:
        cv2.setNumThreads(before)
    assert len(seen) == 1 + len(images)
    assert all(n_threads == 1 and n_keypoints > 900 for n_threads, n_keypoints in seen)


def test_peak_memory_covers_what_was_held() -> None:
    held = np.ones(20_000_000)  # 160 MB
    assert held.nbytes / 1e6 < peak_memory_mb() < 50_000


@pytest.mark.skipif(not PROCESS_STATUS.exists(), reason="only Linux tells a program's own peak from its parent's")
def test_peak_memory_is_the_programs_own_whoever_started_it() -> None:
    held = np.ones(600_000_000, dtype=np.uint8)
    asks = "from stillroom.evaluation.timing import peak_memory_mb; print(peak_memory_mb())"
    # With something to do before it begins, a child is a copy of this process first.
    child = subprocess.run([sys.executable, "-c", asks], check=True, capture_output=True, preexec_fn=os.getpid)
    assert peak_memory_mb() > held.nbytes / 1e6
    assert float(child.stdout) < 0.7 * held.nbytes / 1e6
