"""Warming up: what is compiled, where it is kept, and that a run then compiles nothing."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from stillroom.cli import warmup as command
from stillroom.compiled import kernel_cache
from stillroom.warmup import is_warm, kernels, processes, warm_up
from stillroom.warmup.all_kernels import leave_stamps
from stillroom.warmup.listing import NAME, described, kernel_of, type_of

COLD = """
import importlib, pkgutil
import stillroom, stillroom_scenes
from stillroom.warmup import kernels, warm_up
done = warm_up(renderer=True)
for package in (stillroom, stillroom_scenes):
    for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
        importlib.import_module(module.name)
inlined = {name for name, kernel in kernels().items() if kernel.targetoptions.get("inline") == "always"}
never = {name for name, kernel in kernels().items() if not kernel.signatures} - inlined
print(done.n_compiled, len(kernels()) - len(inlined | never), *sorted(never))
"""
FEW = "links.gather", "links.count_by_keyframe", "links.oldest_rows", "map.keep_others"
"""Small kernels of `stillroom.data.map`."""
PARTLY = """
import sys
from stillroom.compiled import cached_signatures, working_folder
from stillroom.warmup.listing import kernel_of, listed
from stillroom.warmup.processes import compile_in_processes
names = [f"stillroom.data.map.{name}" for name in sys.argv[2:]]
kernels, ready = {name: kernel_of(name) for name in names}, []
if sys.argv[1] == "alone":
    for name in names:
        for signature in listed()[name]:
            kernels[name].compile(signature)
        ready.append(name)
else:
    compile_in_processes(kernels, lambda name, compiled: ready.append(name), 2)
assert sorted(ready) == sorted(names), ready
for name in names:
    assert cached_signatures(kernels[name]) == set(listed()[name]), name
for path in sorted(working_folder().rglob("*.nb?")):
    print(path.relative_to(working_folder()))
"""
RAW: dict[str, list[list[Any]]] = json.loads(Path(processes.__file__).with_name(NAME).read_text(encoding="utf-8"))
UNUSED = {"dense.voxels.hash_kernels.find_rows"}  # what tests ask a voxel map with
"""Kernels that no command needs."""


def answer(code: str, *arguments: str, **variables: str) -> list[str]:
    """Run code in a Python of its own and return the words that it prints."""
    environment = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"} | variables
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments], env=environment, capture_output=True, text=True, check=True
    )
    return done.stdout.split()


@pytest.fixture(scope="module")
def afterwards() -> dict[str, Any]:
    """What a process found that warmed up and then ran everything."""
    program = Path(__file__).with_name("runs_after_warmup.py")
    done = subprocess.run([sys.executable, program], capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


@pytest.mark.slow
def test_after_it_every_kernel_is_ready(afterwards: dict[str, Any]) -> None:
    assert set(afterwards["cold"]) <= UNUSED


@pytest.mark.slow
def test_after_it_runs_pictures_and_exports_compile_nothing(afterwards: dict[str, Any]) -> None:
    assert afterwards["late"] == []
    assert afterwards["n_points"]["oc-slam"] > 10_000


def test_it_reports_each_kernel_and_ends_full(tmp_path: Path) -> None:
    steps: list[tuple[str, int, int]] = []
    done = warm_up(lambda *step: steps.append(step))
    assert steps[-1] == ("", done.n_kernels, done.n_kernels)
    assert done.n_kernels == len(kernels()) > 20
    assert {name for name, _, _ in steps[:-1]} <= set(kernels())
    assert is_warm()


def test_the_stamp_is_of_these_sources(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("numba.config.CACHE_DIR", str(tmp_path))
    assert not is_warm()
    assert not is_warm(renderer=True)
    warm_up()
    assert is_warm()
    assert not is_warm(renderer=True)
    monkeypatch.setattr("numba.__version__", "0")
    assert not is_warm()


def test_the_command_says_where_the_cache_is() -> None:
    app = typer.Typer()
    app.command()(command.warmup)
    result = CliRunner().invoke(app)
    assert result.exit_code == 0, result.output
    lines = result.output.splitlines()
    assert "kernels ready in" in lines[-2]
    assert lines[-1] == f"kept in {kernel_cache()}"


def test_where_kernels_cannot_be_kept_no_stamp_says_that_they_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    folder = tmp_path / "file" / "numba"
    monkeypatch.setattr("numba.config.CACHE_DIR", str(folder))
    leave_stamps(renderer=True)
    assert not is_warm()
    # Another's kernels lie there, of which one folder may not be written.
    monkeypatch.setattr("numba.config.CACHE_DIR", str(tmp_path))
    (tmp_path / "features").mkdir()
    monkeypatch.setattr("os.access", lambda path, _: Path(path).name != "features")
    leave_stamps(renderer=True)
    assert not is_warm()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["features", "file"]


@pytest.mark.slow
def test_from_nothing_it_compiles_every_kernel(tmp_path: Path) -> None:
    compiled, expected, *never = answer(COLD, XDG_CACHE_HOME=str(tmp_path))
    assert set(never) <= UNUSED
    assert compiled == expected
    assert answer(COLD, XDG_CACHE_HOME=str(tmp_path))[0] == "0"


def test_several_processes_leave_the_cache_that_one_does(tmp_path: Path) -> None:
    alone = answer(PARTLY, "alone", *FEW, XDG_CACHE_HOME=str(tmp_path / "alone"))
    together = answer(PARTLY, "together", *FEW, XDG_CACHE_HOME=str(tmp_path / "together"))
    assert together == alone
    assert len(alone) == 2 * len(FEW)


def test_a_process_that_ends_early_leaves_its_kernels_to_others(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "SERVE", "import sys; sys.stdin.readline()")
    ready: list[str] = []
    names = [f"stillroom.data.map.{name}" for name in FEW]
    kernels_to_do = {name: kernel_of(name) for name in names}
    processes.compile_in_processes(kernels_to_do, lambda name, _: ready.append(name), 2)
    assert ready == []


def test_callees_come_before_their_callers() -> None:
    chain = {name: kernel_of(name) for name in RAW}
    queue, done = processes._Queue(chain), list[str]()
    calls = queue._calls
    assert sum(map(len, calls.values())) > 20
    while (name := queue.take()) is not None:
        assert calls[name] <= set(done)
        queue.finish(name)
        done.append(name)
    assert sorted(done) == sorted(chain)


def test_what_is_listed_is_there() -> None:
    """After kernels were renamed, or given other named tuples: `python -m stillroom.warmup`."""
    assert [name for name in RAW if kernel_of(name) is None] == []
    for name, signatures in RAW.items():
        for signature in signatures:
            assert [described(type_of(each)) for each in signature] == signature, name


@pytest.mark.parametrize(
    "description", ["float65", "float64[", "float64[:, x]", {"class": "stillroom.no:No", "of": []}]
)
def test_what_is_no_type_is_refused(description: Any) -> None:
    with pytest.raises((AttributeError, ImportError, ValueError)):
        type_of(description)
