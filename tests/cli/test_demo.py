"""`stillroom demo`, short; the whole of it is marked slow."""

import json
import re
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner, Result

from stillroom.cli.demo import demo
from stillroom.pipeline.run import StopRequest

app = typer.Typer()
app.command()(demo)


@pytest.fixture
def bare(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine on which nothing was ever fetched, in an empty folder."""
    monkeypatch.setenv("STILLROOM_MODELS", str(tmp_path / "absent"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)


def invoke(*arguments: str) -> Result:
    return CliRunner().invoke(app, arguments)


def ate_m(result: Result, name: str) -> float:
    """The figure in a row of the table."""
    line = next(line for line in result.stdout.splitlines() if line.strip().startswith(name))
    return float(line.split()[1])


def check_files(result: Result, root: Path) -> None:
    """The table says what the folders say, and every picture that is named is there."""
    named = [Path(line.strip()) for line in result.stdout.splitlines() if line.endswith(".png")]
    assert len(named) == len(set(named)) == 3 + 2 * 4
    assert all(path.is_file() for path in named)
    for name in ("orb-slam2", "stillroom"):
        (folder,) = root.glob(f"*_{name}_synthetic*")
        figures = json.loads((folder / "metrics.json").read_text())
        assert ate_m(result, name) == pytest.approx(figures["as_given"]["ate_se3_m"]["rmse"], abs=1e-4)
        assert any(folder.name in str(path) for path in named)


def test_it_needs_nothing_that_must_be_fetched(bare: None, tmp_path: Path) -> None:
    result = invoke("--frames", "0:30", "--out", "results")
    assert result.exit_code == 0, result.output
    assert "static-pose baseline (a camera that never moved): 0." in result.stdout
    check_files(result, tmp_path / "results")
    (folder,) = (tmp_path / "results").glob("*_stillroom_*")
    assert re.search(r'^kind = "yolo-fastest"', (folder / "config.toml").read_text(), re.MULTILINE)


def test_ctrl_c_ends_it(bare: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(StopRequest, "__enter__", lambda self: setattr(self, "asked", True) or self)
    result = invoke("--frames", "0:5")
    assert result.exit_code == 130
    assert "stopped; the results so far are in" in result.stderr
    assert "stillroom" not in result.stdout


def check_promises(root: Path) -> None:
    """The whole demo, against what is said of it."""
    result = invoke("--out", str(root))
    assert result.exit_code == 0, result.output
    check_files(result, root)
    still_m = float(re.search(r"never moved\): ([0-9.]+) m", result.stdout)[1])
    ours_m, baseline_m = ate_m(result, "stillroom"), ate_m(result, "orb-slam2")
    assert ours_m <= 0.02
    assert ours_m <= baseline_m / 3
    assert ours_m <= still_m / 3
    assert next(line for line in result.stdout.splitlines() if "stillroom " in line).count("100.0 %") == 1


@pytest.mark.slow
def test_the_whole_demo_keeps_its_promise(bare: None, tmp_path: Path) -> None:
    check_promises(tmp_path / "results")
