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

from stillroom import __version__
from stillroom.cli import warmup as command
from stillroom.warmup import is_warm, kernels, warm_up

ONE_KERNEL = """
import numpy as np
from stillroom.features.matching import _sort_into_cells as kernel
kernel(np.zeros((3, 2), np.float32), np.zeros(2, np.float32), np.array([4, 4], np.int32))
print(sum(kernel.stats.cache_hits.values()), sum(kernel.stats.cache_misses.values()), kernel.stats.cache_path)
"""
COLD = """
import importlib, pkgutil
import stillroom, stillroom_scenes
from stillroom.warmup import warm_up
from stillroom.warmup import kernels
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


def test_kernels_are_kept_in_the_users_cache(tmp_path: Path) -> None:
    first = answer(ONE_KERNEL, XDG_CACHE_HOME=str(tmp_path))
    assert first[:2] == ["0", "1"]
    home = tmp_path / "stillroom" / "numba" / __version__
    assert Path(first[2]).parent == home
    assert list(home.rglob("*.nbc"))
    second = answer(ONE_KERNEL, XDG_CACHE_HOME=str(tmp_path))
    assert second[:2] == ["1", "0"]


def test_a_cache_folder_of_the_users_own_is_kept_to(tmp_path: Path) -> None:
    place = answer(ONE_KERNEL, XDG_CACHE_HOME=str(tmp_path / "cache"), NUMBA_CACHE_DIR=str(tmp_path / "own"))[2]
    assert Path(place).parent == tmp_path / "own"
    assert not (tmp_path / "cache").exists()


def test_a_relative_cache_home_is_ignored_as_the_xdg_rule_says() -> None:
    code = "import stillroom, os; print(os.environ['NUMBA_CACHE_DIR'])"
    assert Path(answer(code, XDG_CACHE_HOME="cache", HOME="/home/of/someone")[0]).is_relative_to("/home/of/someone")


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
    assert lines[-1] == f"kept in {os.environ['NUMBA_CACHE_DIR']}"


@pytest.mark.slow
def test_from_nothing_it_compiles_every_kernel(tmp_path: Path) -> None:
    compiled, expected, *never = answer(COLD, XDG_CACHE_HOME=str(tmp_path))
    assert set(never) <= UNUSED
    assert compiled == expected
    assert answer(COLD, XDG_CACHE_HOME=str(tmp_path))[0] == "0"
