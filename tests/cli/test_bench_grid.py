"""`stillroom bench grid`: the same table through joblib, through Dask, and after it was stopped or killed half-way."""

import csv
import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import grid_workers
import pytest
from grid_workers import DIES_ALWAYS, DIES_ONCE, planned, row_of, tries
from typer.testing import CliRunner, Result

from stillroom.bench.grid import workers
from stillroom.bench.grid.axes import Grid
from stillroom.bench.grid.rows import Cost, RowFile, read_rows
from stillroom.bench.grid.work import can_bound_memory
from stillroom.bench.grid.workers import DIED, finished
from stillroom.bench.trial import attempt
from stillroom.cli.bench import app
from stillroom.errors import NO_MEMORY, ConfigError, MissingExtraError, StillroomError
from stillroom.pipeline import Source
from stillroom.presets.registry import configure

LOOKS = 600
"""A tenth of a second apart, for something that takes a second or two."""


@dataclass(frozen=True)
class Size:
    """A grid to run: the small one is enough to tell that tables are equal."""

    sequences: str
    methods: str
    seeds: str
    frames: str
    settings: tuple[str, ...] = ()

    @property
    def options(self) -> list[str]:
        axes = ("--sequences", self.sequences, "--methods", self.methods, "--seeds", self.seeds)
        return [*axes, "--frames", self.frames, *self.settings]


ABSENT = "no-such-sequence"
BONN = "rgbd_bonn_crowd_first560"
TRUTH = ("--set", "semantics.kind=truth")
SMALL = Size(f"synthetic:walking,{ABSENT}", "orb-slam2,oc-slam", "0:2", "100:112", TRUTH)
FULL = Size(f"synthetic:walking,synthetic:empty,{BONN}", "orb-slam2,oc-slam,pspnet-slam", "0:3", "40:80")


def bench(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["grid", *map(str, arguments)])


def table(folder: Path) -> bytes:
    """Return the table of a grid without what its runs cost."""
    with (folder / "rows.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.reader(file))
    n = sum(not name.startswith("cost_") for name in rows[0])
    return "\n".join(str(row[:n]) for row in rows).encode()


def lines(folder: Path) -> list[str]:
    return (folder / "rows.jsonl").read_text(encoding="utf-8").splitlines()


@pytest.fixture(scope="module", params=["small", pytest.param("full", marks=pytest.mark.slow)])
def size(request: pytest.FixtureRequest) -> Size:
    if request.param == "small":
        return SMALL
    request.getfixturevalue("bonn")
    return FULL


@pytest.fixture(scope="module")
def whole(size: Size, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Result]:
    """The grid, run through joblib by two workers without a break."""
    folder = tmp_path_factory.mktemp("grid") / "whole"
    result = bench(*size.options, "--out", folder, "--jobs", 2)
    assert result.exit_code == 0, result.output
    return folder, result


STOPPED = """
import os, sys
from pathlib import Path
from stillroom.bench.grid.rows import RowFile
from stillroom.cli.main import main

left, number, torn = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3].encode()
append = RowFile.append

def counted(self, row):
    # After so many rows, begin another one and end as the signal has it.
    global left
    append(self, row)
    left -= 1
    if left == 0:
        for task in Path("/proc/self/task").glob("*/children"):
            print(task.read_text(), flush=True)
        if torn:
            os.write(self._file, torn)
        os.kill(os.getpid(), number)

RowFile.append = counted
main(["bench", "grid", *sys.argv[4:]])
"""


def stopped(after: int, number: int, torn: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    """Run a grid in a process of its own that gets a signal after some rows."""
    words = [sys.executable, "-c", STOPPED, str(after), str(int(number)), torn, *map(str, arguments)]
    return subprocess.run(words, capture_output=True, text=True, timeout=1800, check=False)


def is_running(process: int) -> bool:
    """Return whether a process is there; one that nobody has asked what became of it is not."""
    try:
        return Path(f"/proc/{process}/stat").read_text(encoding="ascii").rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_a_grid_has_a_row_for_each_run_with_the_figures_of_that_run(size: Size, whole: tuple[Path, Result]) -> None:
    folder, result = whole
    with (folder / "rows.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(lines(folder)) == len({row["digest"] for row in rows})
    expected = [(s, m) for s in size.sequences.split(",") for m in size.methods.split(",")]
    assert list(dict.fromkeys((row["sequence"], row["method"]) for row in rows)) == expected
    row = next(row for row in rows if row["method"] == "oc-slam" and row["seed"] == "1")
    dataset = Source(row["sequence"], frames=size.frames).open()
    alone = attempt(dataset, configure("oc-slam", None, size.settings[1:]), 1)
    assert float(row["ate_m"]) == alone.ate_m
    assert (int(row["n_given"]), int(row["n_tracked"])) == (alone.n_given, alone.n_tracked)
    assert int(row["n_keyframes"]) == alone.n_keyframes
    for row in rows:
        assert (row["error"] == "") == (row["sequence"] != ABSENT)
        assert row["cost_attempts"] == "1"
        if row["error"]:
            assert f"{ABSENT}: no such folder or archive" in row["error"]
            assert row["ate_m"] == row["n_given"] == ""
        else:
            assert float(row["cost_cpu_ms_a_frame"]) > 0.5
    if size is SMALL:
        shown = next(line for line in result.stdout.splitlines() if line.strip().startswith("oc-slam"))
        of_it = [float(row["ate_m"]) for row in rows if row["method"] == "oc-slam" and row["ate_m"]]
        cells = [f"{value:.4f}" for value in (sum(of_it) / 2, min(of_it), max(of_it))]
        assert shown.split()[1:5] == ["2", *cells]
        assert "4 of 8 runs failed:" in result.stdout


def test_a_file_gives_the_grid_that_options_give(size: Size, whole: tuple[Path, Result], tmp_path: Path) -> None:
    """Nothing is left to do: the digests of the runs are the same."""
    folder, _ = whole
    before = (folder / "rows.jsonl").read_bytes()
    first, _, end = size.seeds.partition(":")
    values = {
        "sequences": size.sequences.split(","),
        "methods": size.methods.split(","),
        "seeds": list(range(int(first), int(end))),
        "frames": size.frames,
        "set": size.settings[1:],
    }
    text = "".join(f"{name} = {json.dumps(value)}\n" for name, value in values.items())
    (tmp_path / "my.toml").write_text(text, encoding="utf-8")
    result = bench(tmp_path / "my.toml", "--dry-run", "--out", folder)
    n = len(lines(folder))
    assert f"{n} runs, {n} done, 0 to do" in result.stdout
    again = bench(folder / "grid.toml")
    assert again.exit_code == 0
    assert f"{n} of {n} runs are done; 0 are left" in again.stderr
    assert (folder / "rows.jsonl").read_bytes() == before


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="the system does not tell of children in /proc")
def test_a_grid_that_is_killed_goes_on_and_gives_the_same_table(
    size: Size, whole: tuple[Path, Result], tmp_path: Path
) -> None:
    folder = tmp_path / "killed"
    done = stopped(3, signal.SIGKILL, '{"sequence": "synth', *size.options, "--out", folder, "--jobs", 2)
    assert done.returncode == -signal.SIGKILL, done.stderr
    assert not (folder / "rows.csv").exists()
    kept = lines(folder)[:3]
    left_behind = [int(word) for word in done.stdout.split()]
    assert len(left_behind) >= 2
    for _ in range(LOOKS):
        if not any(map(is_running, left_behind)):
            break
        time.sleep(0.1)
    assert not any(map(is_running, left_behind))
    result = bench(folder / "grid.toml")
    assert result.exit_code == 0, result.output
    assert "its last line was not written to its end and is dropped" in result.stderr
    n = len(lines(whole[0]))
    assert f"3 of {n} runs are done; {n - 3} are left" in result.stderr
    assert lines(folder)[:3] == kept
    assert len(lines(folder)) == n
    assert table(folder) == table(whole[0])
    assert sorted(path.name for path in folder.iterdir()) == ["grid.toml", "rows.csv", "rows.jsonl"]


@pytest.mark.skipif(sys.platform == "win32", reason="Windows sends no SIGINT to one process")
def test_ctrl_c_leaves_what_is_done_and_says_how_to_go_on(
    size: Size, whole: tuple[Path, Result], tmp_path: Path
) -> None:
    folder = tmp_path / "stopped"
    done = stopped(2, signal.SIGINT, "", *size.options, "--out", folder, "--jobs", 1)
    assert done.returncode == 130, done.stderr
    assert "Traceback" not in done.stderr
    assert f"'stillroom bench grid {folder / 'grid.toml'}' goes on" in done.stderr
    assert len(lines(folder)) == 2
    assert table(folder).splitlines() == table(whole[0]).splitlines()[:3]
    assert "ATE median" in done.stdout
    assert bench(folder / "grid.toml").exit_code == 0
    assert table(folder) == table(whole[0])


# A cluster.


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    """HOST:PORT of a local cluster of two workers, each a process with one thread."""
    distributed = pytest.importorskip("distributed", reason="the extra 'cluster' is not installed")
    dask = pytest.importorskip("dask", reason="the extra 'cluster' is not installed")
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster,
    ):
        yield cluster.scheduler_address.removeprefix("tcp://")


def test_a_cluster_gives_the_same_table(size: Size, whole: tuple[Path, Result], scheduler: str, tmp_path: Path) -> None:
    result = bench(*size.options, "--out", tmp_path, "--backend", f"dask://{scheduler}")
    assert result.exit_code == 0, result.output
    assert table(tmp_path) == table(whole[0])


def test_a_cluster_s_worker_that_dies_is_retried_once_then_is_a_row(
    scheduler: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(workers, "perform", grid_workers.perform)
    runs = [planned(seed, sequence=str(tmp_path)) for seed in (0, DIES_ALWAYS, DIES_ONCE, 4)]
    rows = [list(finished([run], Grid(backend=f"dask://{scheduler}"), tmp_path)) for run in runs]
    assert tries(tmp_path) == [0, DIES_ALWAYS, DIES_ALWAYS, DIES_ONCE, DIES_ONCE, 4]
    twice = Cost(attempts=2)
    assert rows[:2] == [[row_of(runs[0])], [row_of(runs[1], DIED, twice)]]
    assert rows[2:] == [[row_of(runs[2], cost=twice)], [row_of(runs[3])]]


def test_a_scheduler_that_does_not_answer_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed", reason="the extra 'cluster' is not installed")
    monkeypatch.setattr(workers, "CONNECT_WITHIN_S", 1.0)
    caught = bench(*SMALL.options, "--out", tmp_path, "--backend", "dask://127.0.0.1:9").exception
    assert isinstance(caught, StillroomError)
    assert str(caught).startswith("dask://127.0.0.1:9: no scheduler answers there")
    assert "\n" not in str(caught)


def test_without_dask_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    caught = bench(*SMALL.options, "--out", tmp_path, "--backend", "dask://here:8786").exception
    assert isinstance(caught, MissingExtraError)
    assert "pip install 'stillroom[cluster]'" in str(caught)


# What is left, and what went wrong.


def test_a_dry_run_reckons_from_the_rows_that_there_are(tmp_path: Path) -> None:
    options = [*SMALL.options, "--out", tmp_path, "--jobs", 2, "--dry-run"]
    assert bench(*options).stdout.splitlines() == [
        "8 runs, 0 done, 8 to do",
        "time unknown for orb-slam2, oc-slam: no run is finished, or a sequence cannot be opened here",
        "memory unknown",
    ]
    assert list(tmp_path.iterdir()) == []
    one = row_of(planned(5, n_frames=10), cost=Cost(seconds=30.0, peak_memory_mb=400.0))
    with RowFile(tmp_path / "rows.jsonl") as file:
        file.append(one)
    # Two runs of 12 frames at 3 s a frame, by two workers.
    assert bench(*options, "--sequences", "synthetic:walking").stdout.splitlines() == [
        "4 runs, 0 done, 4 to do",
        "time unknown for oc-slam: no run is finished, or a sequence cannot be opened here",
        "the others: about 36 s with 2 workers",
        "memory: up to 400 MB a worker, 800 MB with 2 workers",
    ]


def test_runs_that_failed_are_made_again_where_that_is_asked_for(tmp_path: Path) -> None:
    options = ["--sequences", ABSENT, "--methods", "orb-slam2", "--out", tmp_path]
    for more, n in (((), 1), ((), 1), (("--retry",), 2)):
        assert bench(*options, *more).exit_code == 0
        assert len(lines(tmp_path)) == n
        assert len(table(tmp_path).splitlines()) == 2


@pytest.mark.skipif(not can_bound_memory(), reason="only Linux bounds the memory of a process")
def test_a_run_that_wants_more_memory_than_its_worker_may_hold_is_a_row(tmp_path: Path) -> None:
    options = ["--sequences", "synthetic:walking", "--methods", "orb-slam2", "--frames", "0:12", "--out", tmp_path]
    assert bench(*options, "--jobs", 1, "--memory-gb", 0.01).exit_code == 0
    (row,) = read_rows(tmp_path / "rows.jsonl")[0]
    assert row.error == NO_MEMORY
    assert row.cost.attempts == 1
    assert bench(*options, "--jobs", 1, "--memory-gb", 4.0, "--retry").exit_code == 0
    assert read_rows(tmp_path / "rows.jsonl")[0][-1].n_given == 12


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--methods", "oc-slam"), "no sequence"),
        (("--sequences", "a", "--seeds", "0-3"), "write it like 0,1,2 or 0:3"),
        (("--sequences", "a", "--methods", "oc"), "did you mean 'oc-slam'"),
        (("--sequences", "a", "--vary", "tracking.min_inlier=3"), "did you mean 'tracking.min_inliers'"),
        (("--sequences", "a", "--memory-gb", "0"), "above 0"),
        (("no-such.toml",), "no such config file"),
    ],
    ids=str,
)
def test_a_slip_is_one_line_before_anything_runs(arguments: tuple[str, ...], says: str, tmp_path: Path) -> None:
    caught = bench(*arguments, "--out", tmp_path / "new").exception
    assert isinstance(caught, ConfigError)
    assert says in str(caught)
    assert "\n" not in str(caught)
    assert not (tmp_path / "new").exists()
