"""Ctrl-C, once, twice, and while the results are being written."""

import importlib
import io
import logging
import signal
import threading
import time
from pathlib import Path

import pytest

from stillroom.config import SlamConfig
from stillroom.data.trajectory import read_tum
from stillroom.datasets.selection import select
from stillroom.pipeline import RunOptions, results, run
from stillroom.pipeline.stop_request import StopRequest
from stillroom.protocols import Dataset


def press() -> None:
    signal.raise_signal(signal.SIGINT)


def test_the_first_asks_the_second_interrupts_and_a_third_comes_too_late() -> None:
    before = signal.getsignal(signal.SIGINT)
    with StopRequest() as stop:
        assert not stop.asked
        press()
        assert stop.asked
        with pytest.raises(KeyboardInterrupt):
            press()
        press()
    assert signal.getsignal(signal.SIGINT) is before


def test_while_held_none_interrupts(caplog: pytest.LogCaptureFixture) -> None:
    with StopRequest() as stop:
        stop.hold()
        with caplog.at_level(logging.WARNING):
            press()
            press()
        assert stop.asked
    assert "being written" in caplog.text


class Pressed(io.RawIOBase):
    """Something to write to, on which Ctrl-C is pressed in the middle of the first line."""

    def __init__(self) -> None:
        self.written = b""

    def writable(self) -> bool:
        return True

    def write(self, part: bytes) -> int:
        if not self.written:
            self.written = b"|"
            press()
            time.sleep(0.01)
        self.written += bytes(part)
        return len(part)


def test_in_the_middle_of_a_line_it_is_told_after_the_line() -> None:
    """Writers of Python refuse to be called from within themselves, which would end the run."""
    raw = Pressed()
    stderr = io.TextIOWrapper(io.BufferedWriter(raw), write_through=True)
    handler = logging.StreamHandler(stderr)
    logger = logging.getLogger("stillroom")
    logger.addHandler(handler)
    try:
        with StopRequest() as stop:
            print("27/270  54.3 frames/s", file=stderr, flush=True)
            assert stop.asked
    finally:
        logger.removeHandler(handler)
    lines = raw.written.decode().lstrip("|").split("\n")
    assert lines[0] == "27/270  54.3 frames/s"
    assert any("stopping after this frame" in line for line in lines[1:])


def test_on_another_thread_it_does_nothing() -> None:
    before = signal.getsignal(signal.SIGINT)

    def use() -> None:
        with StopRequest() as stop:
            assert not stop.asked
            assert signal.getsignal(signal.SIGINT) is before

    thread = threading.Thread(target=use)
    thread.start()
    thread.join()


@pytest.mark.parametrize("place", ["write_results", "evaluate_trajectory", "draw_plots"])
def test_ctrl_c_at_the_end_costs_nothing(
    place: str, room: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Somebody who presses it twice, or too late, has all the same what was tracked."""
    where = results if place == "write_results" else importlib.import_module("stillroom.pipeline.run")
    honest = getattr(where, place)

    def pressed(*given: object, **named: object) -> object:
        press()
        press()
        return honest(*given, **named)

    monkeypatch.setattr(where, place, pressed)
    outcome = run(select(room, ":4"), SlamConfig(), RunOptions(folder=tmp_path, pictures=1))
    assert outcome.interrupted
    assert len(read_tum(tmp_path / "trajectory.tum")) == 4
    assert (tmp_path / "metrics.json").exists()
    assert (tmp_path / "pictures" / "error.png").exists()
