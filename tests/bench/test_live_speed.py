"""The figures of a live run: its unit, its pace, and the words for several of them."""

import threading
from dataclasses import replace

import numpy as np
import pytest

from stillroom.bench.live_speed import UNITS_A_PERIOD, InMemory, LiveSpeed, UnitMeanwhile, live_speed, sentences
from stillroom.datasets.open import open_dataset
from stillroom.presets.registry import configure

ROOM = "synthetic:empty,frames=12"


@pytest.fixture(scope="module")
def images() -> InMemory:
    return InMemory(open_dataset(ROOM))


@pytest.mark.parametrize("paced", [False, True])
def test_a_run_has_the_unit_of_its_own_time_and_leaves_no_thread(images: InMemory, paced: bool) -> None:
    before = set(threading.enumerate())
    run = live_speed(images, "orb-slam2", configure("orb-slam2", seed=3), paced)
    assert set(threading.enumerate()) <= before
    assert (run.method, run.seed, run.n_frames) == ("orb-slam2", 3, 12)
    assert run.n_tracked + run.n_dropped == 12
    assert run.units == run.wall_ms / run.unit_ms > 0.0
    if paced:
        assert 0.0 < run.rate_hz <= 30.0
        assert all(delay > 0.0 for delay in run.delay_ms)
    else:
        assert run.rate_hz == 0.0
        assert run.n_dropped == 0


def test_the_unit_is_measured_until_the_end() -> None:
    rng = np.random.default_rng(0)
    with UnitMeanwhile([rng.integers(0, 256, (120, 160), dtype=np.uint8)]) as unit:
        pass
    assert unit.mean_ms > 0.0
    assert "stillroom-unit" not in {thread.name for thread in threading.enumerate()}


def test_several_runs_are_told_in_units_of_their_own_time() -> None:
    first = LiveSpeed("oc-slam", 0, 30.0, 5.0, 100, 2, 98, 34.0, (20.0, 40.0), 0.014, 10, 98, {"clusters": 0.5})
    other = replace(first, seed=1, rate_hz=1000.0 / (UNITS_A_PERIOD * 8.0), unit_ms=8.0, n_dropped=4, ate_m=0.016)
    text, busy = sentences([first, other])
    assert "at a camera's rate, 26.6 to 30.0 Hz, median of 2 runs: 34.0 ms a frame" in text
    assert "3.0 % dropped, at most 4.0 %" in text
    assert "due to pose 3.25 units, 95th percentile 6.50" in text
    assert "ATE 0.0150 m, at worst 0.0160 m" in text
    assert busy.startswith("workers busy: clusters 50 %")
    assert "as fast as it goes" in sentences([replace(first, rate_hz=0.0)])[0]
