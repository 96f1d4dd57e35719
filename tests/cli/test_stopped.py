"""A run that is asked to end, by whichever signal and in whichever stage, keeps what is done by then."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from stillroom.data.trajectory import read_tum
from stillroom.storage.check import check_map

if not hasattr(signal, "SIGHUP"):
    pytest.skip("this system sends no SIGHUP, and no SIGTERM to another process", allow_module_level=True)

N = 6
RUN = f"""
import importlib, os, signal, sys, threading

delay_s = float(os.environ.get("DELAY_S", "0"))

def at(module, name, number, n=1):
    '''Let the process be asked to end when something is called for the n-th time.'''
    module, _, holder = module.partition(":")
    where = importlib.import_module(module)
    where = getattr(where, holder) if holder else where
    honest, left = getattr(where, name), [n]

    def asked(*given, **named):
        left[0] -= 1
        if left[0] == 0 and delay_s > 0.0:
            threading.Timer(delay_s, os.kill, (os.getpid(), number)).start()
        elif left[0] == 0:
            os.kill(os.getpid(), number)
        return honest(*given, **named)

    setattr(where, name, asked)

place, number, n = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
if place:
    at(*place.split(" "), number, n)
from stillroom.cli.main import main
main(["run", os.environ["ROOM"], "--frames", ":{N}", "--method", "orb-slam2", "--out", "out", *sys.argv[4:]])
"""
HEARD = "import signal; signal.signal(signal.SIGHUP, signal.SIG_DFL)\n" + RUN
"""The same whatever the tests were started with: under nohup, children ignore SIGHUP."""
STAGES = {
    "loading": ("stillroom.datasets.open open_dataset", 1, None),
    "warm-up": ("stillroom.cli.warmup ensure_warm", 1, None),
    "tracking": ("stillroom.session.slam:Slam process", 3, 3),
    "finishing": ("stillroom.system:System close", 1, N),
    "writing": ("stillroom.pipeline.results write_metrics", 1, N),
    "drawing": ("stillroom.pipeline.plots plot_error", 1, N),
}
QUICK = ("--pictures", "0", "--no-report")
"""Where it is not about them."""
CODES = {"SIGINT": 130, "SIGTERM": 143, "SIGHUP": 129}


@pytest.fixture(autouse=True)
def room(_recorded: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Images on disk: a process of its own would build a room first, for longer than it takes to track them."""
    monkeypatch.setenv("ROOM", str(_recorded))


def run(
    folder: Path, place: str, number: int, n: int, *more: str, delay_s: float = 0.0
) -> subprocess.CompletedProcess[str]:
    words, environment = [sys.executable, "-c", HEARD, place, str(number), str(n), *more], {"DELAY_S": str(delay_s)}
    return subprocess.run(
        words, cwd=folder, capture_output=True, text=True, timeout=300, check=False, env=os.environ | environment
    )


def assert_kept(folder: Path, n: int) -> None:
    assert len(read_tum(folder / "trajectory.tum")) == n
    assert len(read_tum(folder / "trajectory_online.tum")) == n
    assert json.loads((folder / "metrics.json").read_text(encoding="utf-8"))["n_given"] == n
    assert [path.name for path in folder.iterdir() if path.name.startswith(".")] == []


@pytest.mark.parametrize("stage", STAGES)
def test_sigterm_in_any_stage_keeps_what_is_done(stage: str, tmp_path: Path) -> None:
    place, n, n_done = STAGES[stage]
    more = {"writing": ("--pictures", "0"), "drawing": ("--pictures", "1")}.get(stage, QUICK)
    done = run(tmp_path, place, signal.SIGTERM, n, *more)
    assert done.returncode == 143, done.stderr
    assert "Traceback" not in done.stderr
    if n_done is None:
        assert list((tmp_path / "out").glob("*")) == []
    else:
        assert "[see troubleshooting: interrupted]" in done.stderr
        assert_kept(tmp_path / "out", n_done)
    if stage == "drawing":
        assert (tmp_path / "out" / "pictures" / "error.png").exists()


MOMENTS = [*range(2), *(pytest.param(moment, marks=pytest.mark.slow) for moment in range(2, 20))]


@pytest.mark.parametrize("moment", MOMENTS)
def test_a_live_run_that_is_asked_to_end_at_any_moment(moment: int, tmp_path: Path) -> None:
    """While workers are busy: one message, whole files, no hang."""
    rng, (place, _, _) = np.random.default_rng(moment), STAGES["tracking"]
    number = (signal.SIGINT, signal.SIGTERM)[moment % 2]
    n, delay_s = int(rng.integers(1, N)), float(rng.uniform(0.0, 0.05))
    live = (*QUICK, "--schedule", "live", "--speed", "0", "--map", "a.stillmap")
    done = run(tmp_path, place, number, n, *live, delay_s=delay_s)
    assert done.returncode == 128 + number, done.stderr
    assert "Traceback" not in done.stderr
    assert done.stderr.count("[see troubleshooting: interrupted]") == 1
    figures = json.loads((tmp_path / "out" / "metrics.json").read_text(encoding="utf-8"))
    assert len(read_tum(tmp_path / "out" / "trajectory.tum")) == figures["n_given"] > 0
    assert check_map(tmp_path / "a.stillmap") == []


@pytest.mark.parametrize("name", ["SIGINT", "SIGHUP"])
def test_every_signal_has_its_exit_code(name: str, tmp_path: Path) -> None:
    place, n, n_done = STAGES["tracking"]
    done = run(tmp_path, place, getattr(signal, name), n, *QUICK, "--map", "room.stillmap")
    assert done.returncode == CODES[name], done.stderr
    assert n_done is not None
    assert_kept(tmp_path / "out", n_done)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out", "room.stillmap"]


def test_under_nohup_a_closed_console_is_not_heard(tmp_path: Path) -> None:
    place, n, _ = STAGES["tracking"]
    code = f"import signal; signal.signal(signal.SIGHUP, signal.SIG_IGN)\n{RUN}"
    words = [sys.executable, "-c", code, place, str(int(signal.SIGHUP)), str(n), *QUICK]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    assert_kept(tmp_path / "out", N)


def test_a_console_that_is_closed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The terminal goes away in the middle: SIGHUP comes, and nothing can be written to it any more."""
    monkeypatch.setenv("ROOM", "synthetic:empty")
    ours, theirs = os.openpty()
    words = [sys.executable, "-c", HEARD.replace(f":{N}", ":200"), "", "0", "0", *QUICK]
    with subprocess.Popen(words, cwd=tmp_path, preexec_fn=lambda: os.login_tty(theirs)) as process:
        os.close(theirs)
        shown = b""
        while b"frames/s" not in shown:
            shown += os.read(ours, 4096)
        os.close(ours)
        code = process.wait(timeout=300)
    assert code == 129, shown
    n = json.loads((tmp_path / "out" / "metrics.json").read_text(encoding="utf-8"))["n_given"]
    assert 0 < n < 200
    assert_kept(tmp_path / "out", n)


def test_a_reader_of_the_output_who_leaves_ends_nothing(tmp_path: Path) -> None:
    """As in `stillroom run … 2>&1 | head -1`."""
    end_of_reader, end_of_run = os.pipe()
    os.close(end_of_reader)
    words = [sys.executable, "-c", RUN, "", "0", "0", "--pictures", "0"]
    code = subprocess.run(
        words, cwd=tmp_path, stdout=end_of_run, stderr=end_of_run, timeout=300, check=False
    ).returncode
    os.close(end_of_run)
    assert code == 0
    assert_kept(tmp_path / "out", N)
