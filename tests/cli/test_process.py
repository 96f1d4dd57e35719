"""The command as a process of its own: how fast it answers, how it ends, and Ctrl-C."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from stillroom.cli.arguments import MAX_GAP_S
from stillroom.data.association import TUM_MAX_GAP_S
from stillroom.data.trajectory import read_tum

STILLROOM = [sys.executable, "-m", "stillroom.cli.main"]
without_ctrl_c = pytest.mark.skipif(sys.platform == "win32", reason="Windows sends no SIGINT to another process")
LIGHT = """
import sys
from stillroom.cli.main import COMMANDS, application
for words in ((), ("run",), ("evaluate",), ("methods",), ("show-config",), ("train-vocabulary",), ("train", "pspnet"),
              ("export", "pspnet"), ("export", "yolo")):
    application(*words)
heavy = {"numpy", "cv2", "numba", "scipy", "matplotlib", "bokeh", "onnx", "onnxruntime", "torch"}
print(*sorted(heavy & set(sys.modules)))
"""


def start(*arguments: str, folder: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [*STILLROOM, *arguments], cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def test_parsers_import_nothing_heavy() -> None:
    done = subprocess.run([sys.executable, "-c", LIGHT], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


def test_help_comes_at_once(tmp_path: Path) -> None:
    before_s = sum(os.times()[2:4])
    process = start("--help", folder=tmp_path)
    out, _ = process.communicate(timeout=60)
    assert process.returncode == 0
    assert "evaluate" in out
    assert sum(os.times()[2:4]) - before_s < 2.0  # CPU time: the machine may have other things to do


def test_an_error_is_one_line_on_stderr(tmp_path: Path) -> None:
    process = start("run", "nowhere/room", folder=tmp_path)
    out, err = process.communicate(timeout=120)
    assert process.returncode == 1
    assert out == ""
    assert err == "error: nowhere/room: no such folder or archive\n"


def test_one_thread_for_blas(tmp_path: Path) -> None:
    code = "import os; from stillroom.cli.main import main\ntry: main(['--version'])\nexcept SystemExit: pass\n"
    code += "print(os.environ['OPENBLAS_NUM_THREADS'], os.environ['OMP_NUM_THREADS'])"
    environment = {key: value for key, value in os.environ.items() if not key.endswith("_NUM_THREADS")}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.split()[-2:] == ["1", "1"]


@without_ctrl_c
def test_ctrl_c_keeps_everything_so_far(tmp_path: Path) -> None:
    arguments = ("run", "synthetic:walking", "--method", "orb-slam2", "--pictures", "2", "--out", "out")
    process = start(*arguments, folder=tmp_path)
    assert process.stderr is not None
    for line in process.stderr:
        if "frames/s" in line:
            break
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=120)
    assert process.returncode == 130, err
    assert "stopping after this frame" in err
    assert "Traceback" not in err
    folder = tmp_path / "out"
    metrics = json.loads((folder / "metrics.json").read_text(encoding="utf-8"))
    n = metrics["n_given"]
    assert 27 <= n < 270
    assert metrics["run"]["interrupted"] is True
    assert len(read_tum(folder / "trajectory.tum")) == len(read_tum(folder / "trajectory_online.tum")) == n
    assert (folder / "pictures" / "error.png").exists()
    assert f"stopped after {n} images" in out
    assert "results: out" in out


@without_ctrl_c
def test_ctrl_c_twice_stops_at_once_and_still_writes(tmp_path: Path) -> None:
    arguments = ("run", "synthetic:walking", "--method", "orb-slam2", "--pictures", "0", "--out", "out")
    process = start(*arguments, folder=tmp_path)
    assert process.stderr is not None
    for line in process.stderr:
        if "frames/s" in line:
            break
    process.send_signal(signal.SIGINT)
    time.sleep(0.001)
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=120)
    assert process.returncode == 130
    assert len(read_tum(tmp_path / "out" / "trajectory.tum")) >= 26


@pytest.mark.slow
def test_the_whole_bonn_stretch(bonn: Path, tmp_path: Path) -> None:
    """The main job of the product, as its user does it."""
    for arguments in (("run", str(bonn), "--method", "oc-slam"), ("evaluate", "results/latest")):
        subprocess.run([*STILLROOM, *arguments], cwd=tmp_path, check=True, capture_output=True)
    metrics = json.loads((tmp_path / "results" / "latest" / "metrics.json").read_text(encoding="utf-8"))
    assert metrics["as_given"]["ate_se3_m"]["rmse"] <= 0.025
    assert metrics["as_given"]["n_compared"] == 559
    assert metrics["coverage"] >= 0.99
    assert metrics["run"]["peak_memory_mb"] <= 1000


def test_the_default_of_max_gap_is_that_of_the_pairing() -> None:
    assert MAX_GAP_S == TUM_MAX_GAP_S
