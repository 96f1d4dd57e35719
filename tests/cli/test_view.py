"""`stillroom view`, and the options of `stillroom run` that show it, without a display."""

from pathlib import Path

import pytest

from stillroom.cli.main import main

POSES = "1.000000 0 0 0 0 0 0 1\n1.033333 0.01 0 0 0 0 0 1\n"


@pytest.fixture
def finished(tmp_path: Path) -> Path:
    """The least that a results folder may hold."""
    folder = tmp_path / "results"
    folder.mkdir()
    (folder / "trajectory.tum").write_text(POSES, encoding="utf-8")
    return folder


def test_a_replay_is_written_and_says_what_it_lacks(finished: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("rerun", reason="rerun is not installed: pip install 'stillroom[viewer]'")
    file = finished.parent / "run.rrd"
    with pytest.raises(SystemExit, match="0"):
        main(["view", str(finished), "--rerun", str(file)])
    told = capsys.readouterr().out.splitlines()
    assert told[0] == "2 frames, 0 of them with their image"
    assert [line.split(":")[1].strip() for line in told[1:-1]][:2] == ["states and counts", "configuration"]
    assert told[-1].startswith(f"recording: {file}")
    assert file.stat().st_size > 1000


@pytest.mark.parametrize("command", ["view", "run"])
def test_a_wrong_file_is_refused_at_once(command: str, finished: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("rerun", reason="rerun is not installed: pip install 'stillroom[viewer]'")
    with pytest.raises(SystemExit, match="1"):
        main([command, str(finished), "--rerun", "run.mp4"])
    assert capsys.readouterr().err.startswith("error: run.mp4: rerun knows its files by their suffix")


@pytest.mark.parametrize("arguments", [["view", "{}"], ["run", "synthetic:walking", "--view"]])
def test_without_rerun_the_line_that_installs_it_is_told(
    arguments: list[str], finished: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(SystemExit, match="1"):
        main([word.format(finished) for word in arguments])
    assert "rerun-sdk is not installed: pip install 'stillroom[viewer]'" in capsys.readouterr().err
