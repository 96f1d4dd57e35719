"""The clock against work of known length, the file it writes, and the unit."""

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


def burn(cpu_ms: float) -> str:
    end = time.thread_time() + cpu_ms / 1000
    while time.thread_time() < end:
        pass
    return "done"


def test_wall_and_cpu_time_are_told_apart() -> None:
    clock = StageClock()
    for _ in range(3):
        with clock.stage("sleeping"):
            time.sleep(0.01)
        assert clock.timed("working", burn)(cpu_ms=5) == "done"
        clock.next_frame()
    times = {t.stage: t for t in clock.summary()}
    assert times["sleeping"].wall_median_ms >= 10
    assert times["sleeping"].cpu_median_ms < 5
    assert times["working"].cpu_median_ms >= 5
    assert [t.stage for t in clock.summary()] == ["working", "sleeping"]


def test_calls_in_a_frame_add_up_and_rare_stages_count_with_their_share() -> None:
    clock = StageClock()
    for index in range(4):
        with clock.stage(FRAME):
            clock.timed("often", burn)(2)
            clock.timed("often", burn)(2)
            if index == 3:
                clock.timed("rare", burn)(8)
        clock.next_frame()
    times = {t.stage: t for t in clock.summary()}
    assert clock.n_frames == 4
    assert times["often"].cpu_median_ms >= 4
    assert (times["rare"].n_frames, times["often"].n_frames) == (1, 4)
    assert times["rare"].cpu_median_ms >= 8
    assert times["rare"].cpu_mean_ms == pytest.approx(times["rare"].cpu_median_ms / 4)
    assert times["rare"].wall_mean_ms == pytest.approx(times["rare"].wall_median_ms / 4)
    assert times[FRAME].cpu_mean_ms >= times["often"].cpu_mean_ms + times["rare"].cpu_mean_ms
    assert times[FRAME].cpu_p95_ms > times[FRAME].cpu_median_ms + 4


def test_a_stage_that_fails_is_timed_and_its_error_passes() -> None:
    clock = StageClock()
    with pytest.raises(KeyError):
        clock.timed("failing", dict[str, int]().__getitem__)("absent")
    clock.next_frame()
    assert clock.summary()[0].stage == "failing"


def test_other_threads_are_timed_by_their_own_cpu_clock() -> None:
    clock = StageClock()
    workers = [threading.Thread(target=clock.timed("mapping", burn), args=(4,)) for _ in range(4)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    clock.next_frame()
    assert 16 <= clock.summary()[0].cpu_mean_ms < 40


def test_what_comes_after_the_last_frame_counts_as_its_own() -> None:
    clock = StageClock()
    clock.timed("resting", burn)(2)
    clock.conclude()  # no frame yet: nothing to count it for
    for _ in range(2):
        clock.timed("working", burn)(2)
        clock.next_frame()
    clock.timed("working", burn)(4)
    clock.timed("resting", burn)(4)
    clock.conclude()
    clock.conclude()
    times = {t.stage: t for t in clock.summary()}
    assert clock.n_frames == 2
    assert 4 <= times["working"].cpu_mean_ms < 6
    assert times["resting"].n_frames == 1
    assert 2 <= times["resting"].cpu_mean_ms < 3.5


def test_nothing_timed_gives_an_empty_summary() -> None:
    assert StageClock().summary() == []


def test_the_file_has_a_line_for_each_frame(tmp_path: Path) -> None:
    clock = StageClock()
    for index in (200, 201):
        clock.timed("orb", burn)(1)
        if index == 201:
            clock.timed("bundle", burn)(2)
        clock.next_frame(index)
    clock.write_csv(tmp_path / "timing.csv")
    with (tmp_path / "timing.csv").open() as file:
        first, second = csv.DictReader(file)
    assert (first["frame"], second["frame"]) == ("200", "201")
    assert list(first) == ["frame", "orb_wall_ms", "orb_cpu_ms", "bundle_wall_ms", "bundle_cpu_ms"]
    assert first["bundle_wall_ms"] == first["bundle_cpu_ms"] == ""
    assert float(second["bundle_cpu_ms"]) >= 2
    assert float(first["orb_cpu_ms"]) >= 1


def test_the_unit_is_what_orb_costs_and_threads_are_left_as_they_were() -> None:
    images = [np.random.default_rng(i).integers(0, 255, (480, 640), dtype=np.uint8) for i in range(4)]
    before = cv2.getNumThreads()
    cv2.setNumThreads(2)
    try:
        unit = unit_ms(images)
        assert cv2.getNumThreads() == 2
    finally:
        cv2.setNumThreads(before)
    orb, costs = cv2.ORB.create(1000), []
    for image in images:
        start = time.thread_time()
        orb.detectAndCompute(image, None)
        costs.append(1000 * (time.thread_time() - start))
    assert 0.4 < unit / np.mean(costs) < 2.5


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
