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
from stillroom.warmup import is_warm, kernels, warm_up
from stillroom.warmup.all_kernels import leave_stamps

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
UNUSED = {"dense.voxels.hash_kernels.find_rows"}  # what tests ask a voxel map with
"""Kernels that no command needs."""


def answer(code: str, **variables: str) -> list[str]:
    """Run code in a Python of its own and return the words that it prints."""
    environment = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"} | variables
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
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
