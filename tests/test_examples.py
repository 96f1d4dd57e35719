"""The examples run at their smallest size, and do what they say."""

import re
import runpy
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from stillroom.data.trajectory import read_tum

EXAMPLES = Path(__file__).parents[1] / "examples"
FRAMES = 12
SMALL = f"synthetic:walking,frames={FRAMES},fps=10"
TESTED = {"own_frames", "own_segmenter", "own_sieve", "masks_for_another_program", "map_and_localize"}

Run = Callable[[str], str]


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Run an example in an empty folder, and return what it prints."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))

    def run_one(name: str) -> str:
        path = EXAMPLES / f"{name}.py"
        monkeypatch.setattr(sys, "argv", [str(path), SMALL])
        runpy.run_path(str(path), run_name="__main__")
        return capsys.readouterr().out

    return run_one


def test_every_example_is_tested_and_says_how_it_is_run() -> None:
    paths = sorted(EXAMPLES.glob("*.py"))
    assert {path.stem for path in paths} == TESTED
    for path in paths:
        text = path.read_text(encoding="utf-8")
        assert f"python examples/{path.name} [SEQUENCE]" in text
        assert len(text.splitlines()) <= 80, f"{path.name} is long for an example"


def test_own_frames(run: Run) -> None:
    said = run("own_frames")
    assert said.count(" s: at ") == FRAMES
    assert len(read_tum(Path("trajectory.tum"))) == FRAMES
    assert Path("room.ply").read_bytes()[:3] == b"ply"


def test_own_segmenter(run: Run) -> None:
    said = run("own_segmenter")
    assert said.count(": ok, ") == FRAMES
    assert re.search(rf"ATE RMSE 0\.0\d+ m over {FRAMES} poses", said)


def test_own_sieve(run: Run) -> None:
    said = run("own_sieve")
    shares = [float(share) for share in re.findall(r"([\d.]+)% of all pixels", said)]
    assert len(shares) == 3
    assert shares[0] == 0.0
    assert min(shares[1:]) > 0.0, "people walk in, and neither sieve finds them"


def test_masks_for_another_program(run: Run) -> None:
    run("masks_for_another_program")
    masks = [cv2.imread(str(path), cv2.IMREAD_UNCHANGED) for path in sorted(Path("masks").glob("*.png"))]
    assert len(masks) == FRAMES
    assert set(np.unique(masks)) == {0, 255}
    for folder in ("rgb_static", "depth_static"):
        last = cv2.imread(str(sorted(Path(folder).glob("*.png"))[-1]), cv2.IMREAD_UNCHANGED)
        assert (last[masks[-1] > 0] == 0).all()
        assert (last[masks[-1] == 0] > 0).any()


def test_map_and_localize(run: Run) -> None:
    said = run("map_and_localize")
    (file,) = Path().glob("stillroom-*/room.stillmap")
    assert file.stat().st_size > 0
    found = re.search(r"(\d+) of (\d+) frames found in the map", said)
    assert found is not None
    assert int(found[1]) >= int(found[2]) - 1, "one frame may go by before the place is recognised"
